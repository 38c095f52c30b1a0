"""`World`: the model compiled from a scene, its inputs, and the exported MJCF."""

from __future__ import annotations

import importlib.util
import struct

import mujoco
import numpy as np
import PIL.Image
import pytest
from conftest import raises_with

from sero_mj.base import frames
from sero_mj.base.errors import DeclarationError, UnknownName
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Camera, Light, Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.decor.quantities import joint_values

OBJ = mujoco.mjtObj
POSE = frames.frame(frames.rotation_from_rpy(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3]))
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
SNIPPET = (
    '<mujoco><worldbody><body name="jaw" pos="0 0 0.5"><geom name="pad" type="sphere" size="0.1"/>'
    "</body></worldbody></mujoco>"
)
# Declared sizes are radii and full lengths, MuJoCo's are half lengths.
SHAPES = [
    ("box", [0.2, 0.4, 0.6], [0.1, 0.2, 0.3]),
    ("sphere", [0.1], [0.1]),
    ("cylinder", [0.1, 0.6], [0.1, 0.3]),
    ("capsule", [0.1, 0.6], [0.1, 0.3]),
    ("ellipsoid", [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
]


def arm(name="arm", **fields) -> SerialRobot:
    """Returns a robot with two joints and a flange in a general pose."""
    table = [[0.3, 0.1, 0.2, 0.3], [-0.7, 0.4, -0.1, 0.2]]
    flange = {"xyz": [0.1, 0.0, 0.2], "rpy": [0.4, 0.1, 0.0]}
    defaults = {"dh_convention": "craig", "dh_params": table, "flange_frame": flange}
    return SerialRobot(**{"name": name, **defaults, **fields})


def compiled(*robots, **scene):
    world = World(Scene(**{"robots": list(robots), "floor": False, **scene}))
    return world, world.model, world.make_data()


def refusal(*robots, **scene) -> str:
    with pytest.raises(DeclarationError) as caught:
        compiled(*robots, **scene)
    return str(caught.value)


def stl(path, corners=CORNERS):
    """Writes a tetrahedron."""
    triangles = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].astype("<f4")
    records = b"".join(struct.pack("<3f", 0, 0, 0) + t.tobytes() + b"\0\0" for t in triangles)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"test".ljust(80) + struct.pack("<I", 4) + records)


def pose_of(data, kind, name):
    element = getattr(data, kind)(name)
    return frames.frame(element.xmat.reshape(3, 3), element.xpos)


def mesh_corners(model, data, geom):
    """Returns the corners of a mesh geom in the world; MuJoCo moves meshes to inertia frames."""
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    turned = model.mesh_vert[start : start + count] @ data.geom_xmat[geom].reshape(3, 3).T
    return turned + data.geom_xpos[geom]


def assert_same_points(found, expected, tolerance=1e-6):
    assert found.shape == expected.shape
    gaps = np.linalg.norm(found[:, None] - expected[None], axis=-1)
    assert gaps.min(axis=0).max() < tolerance and gaps.min(axis=1).max() < tolerance


def holders(item):
    """Yields world, scope and parent of an object on a flange and of the same one in the scene."""
    world, _, data = compiled(arm(children=[item], joint_angles=[0.5, -1]))
    yield world, data, "arm/", pose_of(data, "body", "arm/flange")
    world, _, data = compiled(objects=[item])
    yield world, data, "", np.eye(4)


@pytest.mark.parametrize(("shape", "size", "halves"), SHAPES)
def test_shape_has_its_size_and_color_at_its_frame(shape, size, halves):
    item = Object(name="it", shape=shape, size=size, frame=POSE, rgba=[0.1, 0.2, 0.3, 0.4])
    for world, data, scope, parent in holders(item):
        geom = world.model.geom(f"{scope}it")
        assert geom.type[0] == getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
        np.testing.assert_allclose(geom.size[: len(halves)], halves)
        np.testing.assert_allclose(geom.rgba, [0.1, 0.2, 0.3, 0.4], rtol=1e-6)
        T = pose_of(data, "geom", f"{scope}it")
        np.testing.assert_allclose(T, parent @ POSE, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "size", "slices"),
    [
        ("sphere", [0.1], 24),
        ("cylinder", [0.1, 3.0], 24),  # long but not wide
        ("cylinder", [0.56, 0.1], 48),
        ("ellipsoid", [0.1, 0.1, 0.56], 48),
        ("sphere", [5.0], 60),
        ("box", [2.0, 2.0, 2.0], 24),
    ],
)
def test_large_round_shapes_are_drawn_finer(shape, size, slices):
    scene = Scene(objects=[Object(name="thing", shape=shape, size=size)])
    quality = World(scene).model.vis.quality
    assert (quality.numslices, quality.numstacks) == (slices, round(10 * slices / 24))


def test_axes_are_a_frame_that_is_always_shown():
    item = Object(name="it", shape="axes", size=[0.3], frame=POSE)
    for world, data, scope, parent in holders(item):
        row = world.frames.names.index(f"{scope}it")
        assert (world.frames.owner[row], world.frames.size[row]) == (-1, 0.3)
        assert world.frames.alpha[row] == 1
        site = world.frames.site[row]
        np.testing.assert_allclose(data.site_xpos[site], (parent @ POSE)[:3, 3], atol=1e-12)
        np.testing.assert_allclose(
            data.site_xmat[site].reshape(3, 3), (parent @ POSE)[:3, :3], atol=1e-12
        )


def test_mesh_is_at_its_frame_in_meters(tmp_path):
    stl(tmp_path / "part.stl", 1000 * CORNERS)
    item = Object(name="it", mesh="part.stl", mesh_scale=0.001, frame=POSE, directory=str(tmp_path))
    for world, data, scope, parent in holders(item):
        T = parent @ POSE
        found = mesh_corners(world.model, data, world.model.geom(f"{scope}it").id)
        assert_same_points(found, CORNERS @ T[:3, :3].T + T[:3, 3])


@pytest.mark.parametrize("as_file", [False, True])
def test_mjcf_object_is_at_its_frame(tmp_path, as_file):
    (tmp_path / "tool.xml").write_text(SNIPPET)
    piece = "tool.xml" if as_file else f"\n  {SNIPPET}"
    item = Object(name="it", mjcf=piece, frame=POSE, directory=str(tmp_path))
    for world, data, scope, parent in holders(item):
        assert world.model.geom(f"{scope}it/pad").size[0] == 0.1
        T = pose_of(data, "body", f"{scope}it/jaw")
        np.testing.assert_allclose(T[:3, 3], (parent @ POSE @ [0, 0, 0.5, 1])[:3], atol=1e-12)
        np.testing.assert_allclose(T[:3, :3], (parent @ POSE)[:3, :3], atol=1e-12)


@pytest.mark.parametrize("compiler", ["", '<compiler angle="degree"/>'])
def test_angles_in_mjcf_are_degrees_by_default(compiler):
    # MuJoCo's default, so that the text means the same as in a separate file.
    text = (
        f'<mujoco>{compiler}<worldbody><geom name="g" type="box" size="1 2 3" euler="0 0 30"/>'
        "</worldbody></mujoco>"
    )
    _, _, data = compiled(objects=[Object(name="it", mjcf=text)])
    turned = frames.rotation_about(2, np.pi / 6)
    np.testing.assert_allclose(pose_of(data, "geom", "it/g")[:3, :3], turned, atol=1e-12)


def test_angles_in_mjcf_with_angle_radian_are_radians():
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><geom name="g" type="box" size="1 2 3"'
        ' euler="0 0 0.5"/></worldbody></mujoco>'
    )
    _, _, data = compiled(objects=[Object(name="it", mjcf=text)])
    turned = frames.rotation_about(2, 0.5)
    np.testing.assert_allclose(pose_of(data, "geom", "it/g")[:3, :3], turned, atol=1e-12)


TEXTURED = """
<mujoco>
  <compiler meshdir="parts" texturedir="looks"/>
  <asset>
    <mesh name="m" file="m.stl"/>
    <texture name="t" type="2d" file="t.png"/>
    <material name="t" texture="t"/>
  </asset>
  <worldbody><geom name="part" type="mesh" mesh="m" material="t"/></worldbody>
</mujoco>
"""


@pytest.mark.parametrize("as_file", [False, True])
def test_files_of_an_mjcf_object_are_found_and_exported_with_unique_names(tmp_path, as_file):
    # Two objects use the same file names; each has its own files.
    objects = []
    for k in (1, 2):
        folder = tmp_path / f"tool{k}"
        (folder / "parts").mkdir(parents=True)
        (folder / "looks").mkdir()
        stl(folder / "parts" / "m.stl", k * CORNERS)
        PIL.Image.new("RGB", (k, k)).save(folder / "looks" / "t.png")
        (folder / "tool.xml").write_text(TEXTURED)
        source = "tool.xml" if as_file else TEXTURED
        objects.append(Object(name=f"tool{k}", mjcf=source, directory=str(folder)))
    world, model, _ = compiled(objects=objects)
    written = world.export(tmp_path / "out" / "scene.xml")
    assert len(written) == 5
    again = mujoco.MjModel.from_xml_path(str(written[0]))
    for loaded in (model, again):
        assert loaded.tex_width[-2:].tolist() == [1, 2]
        state = mujoco.MjData(loaded)
        mujoco.mj_kinematics(loaded, state)
        for k in (1, 2):
            found = mesh_corners(loaded, state, loaded.geom(f"tool{k}/part").id)
            assert_same_points(found, k * CORNERS)


def test_mjcf_text_can_include_files_of_its_folder(tmp_path):
    (tmp_path / "outer.xml").write_text('<mujocoinclude><include file="in.xml"/></mujocoinclude>')
    (tmp_path / "in.xml").write_text('<mujocoinclude><geom name="g" size=".3"/></mujocoinclude>')
    text = '<mujoco><worldbody><include file="outer.xml"/></worldbody></mujoco>'
    _, model, _ = compiled(objects=[Object(name="it", mjcf=text, directory=str(tmp_path))])
    assert model.geom("it/g").size[0] == 0.3


def mjcf_objects():
    """Returns the same MJCF as an `MjSpec`, and as PyMJCF and composer objects if installed."""
    held = {"MjSpec": mujoco.MjSpec.from_string(SNIPPET)}
    if importlib.util.find_spec("dm_control"):
        from dm_control import composer, mjcf

        class Tool(composer.Entity):
            def _build(self):
                self._root = mjcf.from_xml_string(SNIPPET)

            @property
            def mjcf_model(self):
                return self._root

        held |= {"PyMJCF": mjcf.from_xml_string(SNIPPET), "composer": Tool()}
    return held


def test_mjcf_objects_are_accepted_like_text():
    _, wanted, _ = compiled(objects=[Object(name="it", mjcf=SNIPPET, frame=POSE)])
    for kind, held in mjcf_objects().items():
        item = Object(name="it", mjcf=held, frame=POSE)
        for _ in range(2):  # a second time: the argument is not changed
            _, model, _ = compiled(objects=[item])
            names = [model.geom(i).name for i in range(model.ngeom)]
            assert "it/pad" in names, kind
            np.testing.assert_allclose(model.geom_pos, wanted.geom_pos, atol=1e-12)
            np.testing.assert_allclose(model.geom_quat, wanted.geom_quat, atol=1e-12)


def test_invalid_mjcf_argument_is_rejected_with_its_type():
    with raises_with(
        key="mjcf",
        reason=(
            "found dict; expected a file name, MJCF text, a mujoco.MjSpec, a PyMJCF "
            "RootElement or a composer entity"
        ),
    ):
        Object(name="it", mjcf={})


def test_link_meshes_are_in_their_dh_frames_with_their_colors(tmp_path):
    files = ["", {"file": "a.stl", "color": "red"}, ["b.stl", "a.stl"]]
    for i, name in enumerate("ab"):
        stl(tmp_path / f"{name}.stl", CORNERS * (i + 1) * 1000)
    robot = arm(directory=str(tmp_path), filenames=files, mesh_scale=0.001,
                colors={"red": [1, 0, 0, 0.5]}, joint_angles=[0.3, 0.4])  # fmt: skip
    world, model, data = compiled(robot)
    assert model.ngeom == 3
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    np.testing.assert_allclose(model.geom_rgba[0], [1, 0, 0, 0.5])
    poses = robot.dh.frames(robot.home)
    for geom, (link, size) in enumerate([(1, 1), (2, 2), (2, 1)]):
        assert model.geom_bodyid[geom] == world.robots["arm"].bodies[link]
        T = poses[link]
        expected = size * CORNERS @ T[:3, :3].T + T[:3, 3]
        assert_same_points(mesh_corners(model, data, geom), expected)


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_arrows_are_at_the_declared_offsets_with_z_along_the_joint(convention):
    offsets = np.array([[0.1, 0.2, 0.3], [0, 0, -0.2]])
    robot = arm(dh_convention=convention, offsets_to_center_of_joints=offsets,
                base_frame=POSE)  # fmt: skip
    world, _, data = compiled(robot)
    axes, points = robot.dh.joint_axes(robot.dh.frames(robot.home, POSE))
    turned = data.site_xmat[world.joints.centre_site].reshape(-1, 3, 3)
    np.testing.assert_allclose(turned[:, :, 2], axes, atol=1e-12)
    away = (turned @ offsets[..., None])[..., 0]
    np.testing.assert_allclose(data.site_xpos[world.joints.centre_site], points + away, atol=1e-12)


def test_base_is_a_mocap_body_at_its_frame_with_the_declared_limits():
    limited = arm("a", base_frame=POSE, position_limits=[[-1, 2], [-0.5, 0.25]])
    world, model, data = compiled(arm("b"), limited)
    part = world.robots["a"]
    np.testing.assert_allclose(data.mocap_pos[part.mocap], POSE[:3, 3])
    np.testing.assert_allclose(pose_of(data, "body", "a/"), POSE, atol=1e-12)
    assert model.body_mocapid[part.bodies[0]] == part.mocap
    assert model.jnt_limited.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(model.jnt_range[2:], [[-1, 2], [-0.5, 0.25]])


def test_tables_list_the_joints_and_frames_of_all_robots_in_order():
    left = arm("left", torque_limits=[5, 6], arrow_radius=0.2, axes_transparency=0.25,
               axes_size=0.3, joint_types=["revolute", "prismatic"])  # fmt: skip
    right = arm(
        "right", joint_names=["x", "y"], arrow_width_scale=0.02, arrow_radius=0.1, axes_size=0.2
    )
    world, model, _ = compiled(left, right, sources={"udp": {}})
    joints = world.joints
    assert joints.names == ["J1", "J2", "x", "y"]
    assert joints.owner.tolist() == [0, 0, 1, 1]
    assert joints.revolute.tolist() == [True, False, True, True]
    assert joints.torque_limit.tolist() == [5, 6, np.inf, np.inf]
    assert joints.arrow_radius.tolist() == [0.2, 0.2, 0.1, 0.1]
    assert joints.arrow_width_scale.tolist() == [0.01, 0.01, 0.02, 0.02]
    assert [part.joints for part in world.robots.values()] == [slice(0, 2), slice(2, 4)]
    names = [mujoco.mj_id2name(model, OBJ.mjOBJ_JOINT, i) for i in joints.qpos]
    assert names == ["left/J1", "left/J2", "right/x", "right/y"]
    taken = [i for slot in world.slots.values() for i in range(slot.start, slot.stop)]
    taken += world.flags.values()
    assert sorted(taken) == list(range(model.nuserdata))  # slots do not overlap
    slots = np.r_[world.slots["left.torques"], world.slots["right.torques"]]
    assert joints.slots["torques"].tolist() == slots.tolist()
    flags = [world.flags[f"{name}.torques"] for name in ("left", "left", "right", "right")]
    assert joints.has["torques"].tolist() == flags
    assert world.frames.names == [
        f"{name}/{frame}" for name in ("left", "right")
        for frame in ("base", "link1", "link2", "flange")
    ]  # fmt: skip
    assert world.frames.owner.tolist() == [0] * 4 + [1] * 4
    assert world.frames.size.tolist() == [0.3] * 4 + [0.2] * 4
    assert world.frames.alpha.tolist() == [0.75] * 4 + [1] * 4


def came(world, data) -> set[str]:
    """Returns the inputs that have been set or received."""
    return {target for target, flag in world.flags.items() if data.userdata[flag]}


def test_data_starts_at_the_declared_values_and_reset_returns_there():
    robot = arm(joint_angles=[0.1, 0.2], torques=[3, 4])
    world, _, data = compiled(robot)
    start = data.qpos.tolist(), data.userdata.tolist()
    assert start[0] == [0.1, 0.2]
    assert data.userdata[world.slots["arm.torques"]].tolist() == [3, 4]
    assert came(world, data) == {"arm.torques"}
    expected = robot.dh.frames([0.1, 0.2])[-1] @ robot.flange_frame
    np.testing.assert_allclose(pose_of(data, "body", "arm/flange"), expected, atol=1e-12)
    for key in ("joint_angles", "torques", "billboard_values"):
        world.set_input(data, f"arm.{key}", [7, 8])
    assert data.qpos.tolist() == [7, 8]
    assert data.userdata[world.slots["arm.billboard_values"]].tolist() == [7, 8]
    assert came(world, data) == {"arm.joint_angles", "arm.torques", "arm.billboard_values"}
    world.reset(data)
    assert (data.qpos.tolist(), data.userdata.tolist()) == start


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([1], "arm.torques: found [1.0]; expected 2 finite numbers"),
        ([[1, 2]], "arm.torques: found [[1.0, 2.0]]; expected 2 finite numbers"),
        (["a", "b"], "arm.torques: found ['a', 'b']; expected 2 finite numbers"),
    ],
)
def test_invalid_values_are_rejected_and_change_nothing(values, text):
    world, _, data = compiled(arm())
    with pytest.raises(ValueError) as caught:
        world.set_input(data, "arm.torques", values)
    assert str(caught.value) == text
    assert not data.userdata.any()


def test_nan_counts_as_no_data_and_moves_nothing():
    world, _, data = compiled(arm())
    world.set_input(data, "arm.torques", [np.inf, 5.0])
    np.testing.assert_array_equal(joint_values(world, data)["torques"], [np.nan, 5.0])
    with raises_with(
        key="arm.joint_angles", reason="found [1.0, nan]", expected="2 finite numbers"
    ):
        world.set_input(data, "arm.joint_angles", [1, np.nan])
    assert not data.qpos.any()


def test_reset_accepts_data_of_the_model_without_visual_geometry():
    world = World(Scene(robots=[SerialRobot.from_model("lwr")]), dynamic=True)
    model = world.physics_model()
    assert 0 < model.ngeom < world.model.ngeom
    data, expected = mujoco.MjData(model), mujoco.MjData(model)
    world.reset(data)
    expected.qpos[:] = data.qpos
    expected.mocap_pos[:], expected.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    mujoco.mj_forward(model, expected)
    np.testing.assert_array_equal(data.geom_xpos, expected.geom_xpos)


def test_unknown_inputs_and_robots_are_rejected_with_the_nearest_name():
    world, _, data = compiled(arm())
    for target, text in [
        ("arm.torque", "no input 'torque' of arm; did you mean 'torques'?"),
        (
            "arm",
            "no input '' of arm; available: arrow_quantity, base_frame, billboard_values, "
            "commanded_torques, flange_check, joint_accelerations, joint_angles, show_arrows, "
            "show_axes, show_billboards, torques",
        ),
        ("amr.torques", "no robot 'amr'; did you mean 'arm'?"),
    ]:
        with pytest.raises(UnknownName) as caught:
            world.set_input(data, target, [1, 2])
        assert str(caught.value) == text
    with pytest.raises(UnknownName) as caught:
        world.fwd_kin_base_to_flange(data, "amr")
    assert str(caught.value) == "no robot 'amr'; did you mean 'arm'?"


def test_cameras_look_at_their_targets_with_the_sky_above():
    rng = np.random.default_rng(4)
    spots = [(p, t) for p, t in rng.uniform(-2, 2, (20, 2, 3))]
    spots += [([0, 0, 2], [0, 0, 0]), ([1, 1, -1], [1, 1, 5]), ([3, 0, 1], [0, 0, 1])]
    cameras = {
        f"camera {i}": Camera(position=p, look_at=t, fovy_deg=30 + i)
        for i, (p, t) in enumerate(spots)
    }
    _, model, data = compiled(cameras=cameras)
    assert model.ncam == len(spots)
    for i, (position, target) in enumerate(spots):
        camera = model.camera(f"camera {i}").id
        rotation = data.cam_xmat[camera].reshape(3, 3)
        sight = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
        np.testing.assert_allclose(data.cam_xpos[camera], position, atol=1e-12)
        np.testing.assert_allclose(-rotation[:, 2], sight, atol=1e-9)
        assert model.cam_fovy[camera] == 30 + i
        assert abs(rotation[2, 0]) < 1e-9  # the horizon is level
        assert rotation[2, 1] >= -1e-12  # and up is up


def test_declared_lights_are_used_or_one_default_light():
    lights = {
        "sun": Light(position=[1, 2, 3], direction=[0, 3, -4], diffuse=[0.1, 0.2, 0.3]),
        "spot": Light(position=[0, 0, 1], directional=False, cast_shadow=False),
    }
    _, model, data = compiled(lights=lights)
    sun, spot = model.light("sun").id, model.light("spot").id
    assert model.nlight == 2
    np.testing.assert_allclose(data.light_xpos[[sun, spot]], [[1, 2, 3], [0, 0, 1]])
    np.testing.assert_allclose(data.light_xdir[[sun, spot]], [[0, 0.6, -0.8], [0, 0, -1]])
    np.testing.assert_allclose(model.light_diffuse[[sun, spot]], [[0.1, 0.2, 0.3], [0.7] * 3])
    assert model.light_castshadow[[sun, spot]].tolist() == [1, 0]
    kind = mujoco.mjtLightType
    assert model.light_type[[sun, spot]].tolist() == [kind.mjLIGHT_DIRECTIONAL, kind.mjLIGHT_SPOT]
    assert compiled()[1].nlight == 1


def test_default_light_points_at_the_middle_of_the_robots():
    robots = [
        SerialRobot.from_model("lwr", name=name, base_frame={"xyz": [x, 2.0, 0.0]})
        for name, x in (("left", -1.0), ("right", 3.0))
    ]
    model = World(Scene(robots=robots)).model
    light = model.light("key")
    middle = np.array([1.0, 2.0, light.pos[2] - 4.0])
    between = middle - light.pos
    assert np.linalg.norm(np.cross(between, light.dir)) < 1e-6
    assert 0.5 < middle[2] < 0.8  # half of the height of an upright LWR


def test_floor_is_at_height_zero_unless_omitted():
    _, model, data = compiled(floor=True)
    assert model.geom("floor").type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    np.testing.assert_array_equal(pose_of(data, "geom", "floor"), np.eye(4))
    assert compiled(floor=False)[1].ngeom == 0


def test_single_robot_is_on_the_floor_as_when_its_file_is_opened():
    def height(**scene) -> float:
        declared = {"robots": [SerialRobot.from_model("biped_leg")], **scene}
        return float(World(Scene(**declared)).model.geom("floor").pos[2])

    opened = float(World(load_scene("biped_leg")).model.geom("floor").pos[2])
    assert height(floor=None) == opened < -0.8
    two = [SerialRobot.from_model(name) for name in ("biped_leg", "lwr")]
    table = Object(name="table", shape="box", size=[1, 1, 1])
    assert height(floor=True) == height(floor=None, robots=two) == 0.0
    assert height(floor=None, objects=[table]) == 0.0


def test_only_the_floor_casts_no_shadow():
    # Not even if an object of that name is in a scene without a floor.
    ball = Object(name="floor", shape="sphere", size=[1])
    assert compiled(floor=True, objects=[])[1].geom_castshadow.tolist() == [False]
    assert compiled(floor=False, objects=[ball])[1].geom_castshadow.tolist() == [True]
