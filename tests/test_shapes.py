"""Shapes: links generated from any DH table; sizes, files and names of objects."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import pi

import mujoco
import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sero_mj.base import paths
from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.robots.assemble.link_geometry import trim_geoms
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import LinkGeometry
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.scene_file import read_scene_file
from sero_mj.robots.declared.shapes import generate_shapes
from sero_mj.robots.declared.surroundings import FINISHES, Object
from sero_mj.robots.importers.mesh_files import mesh_endings
from sero_mj.robots.kinematics.dh import DhTable

ANGLES = st.sampled_from([0.0, pi / 2, -pi / 2, pi]) | st.floats(-pi, pi)
# From a watch to a crane; steps below 1 um are not drawn, so none are generated here.
LENGTHS = st.just(0.0) | st.floats(1e-4, 100.0) | st.floats(-100.0, -1e-4)
ROWS = st.tuples(ANGLES, LENGTHS, ANGLES, LENGTHS)
TABLES = st.builds(
    lambda convention, joints: DhTable.from_rows(
        [row for row, _ in joints], convention, revolute=[turns for _, turns in joints]
    ),
    st.sampled_from(["craig", "standard"]),
    st.lists(st.tuples(ROWS, st.booleans()), min_size=1, max_size=8),
)
POINTS = st.tuples(LENGTHS, LENGTHS, LENGTHS)


def zeros(n, convention="craig", revolute=True):
    return DhTable.from_rows(np.zeros((n, 4)), convention, revolute=[revolute] * n)


def flange_at(point):
    T = np.eye(4)
    T[:3, 3] = point
    return T


def robot_of(table, flange):
    rows = np.column_stack([table.alpha, table.a, table.theta, table.d])
    return SerialRobot(
        dh_convention=table.convention,
        dh_params=rows,
        joint_types=["revolute" if turns else "prismatic" for turns in table.revolute],
        flange_frame=flange,
    )


def in_world(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


@given(TABLES, POINTS)
@example(zeros(1), (0.0, 0.0, 0.0))
@example(zeros(64, "standard"), (0.0, 0.0, 0.0))
@example(zeros(3, revolute=False), (0.0, 0.0, 0.0))
@settings(max_examples=examples(80), deadline=None)
def test_every_size_is_positive_and_every_link_with_a_joint_is_visible(table, point):
    links = generate_shapes(table, flange_at(point))
    assert len(links) == len(table) + 1
    for i, shapes in enumerate(links):
        assert shapes, f"link {i} is invisible"
        for shape in shapes:
            assert shape.size.shape == ((3,) if shape.kind == "box" else (1,))
            assert (shape.size > 0).all() and np.isfinite(shape.size).all()
            assert np.isfinite(shape.ends).all()
            assert np.linalg.norm(shape.ends[1] - shape.ends[0]) > 0
            assert shape.rgba[3] == 1.0


@given(TABLES, POINTS, st.integers(0, 2**32 - 1))
@settings(max_examples=examples(80), deadline=None)
def test_capsules_connect_the_base_with_every_joint_and_the_flange(table, point, seed):
    # A rotation never opens a gap. A rod slides past the previous frame, which stays on its line.
    q = np.random.default_rng(seed).uniform(-pi, pi, len(table)) * table.revolute
    frames = table.frames(q)
    flange = flange_at(point)
    base, *links = generate_shapes(table, flange)
    # Shapes on the base begin above it by their round end, inside the pedestal.
    base = [
        replace(shape, ends=np.array([np.zeros(3), shape.ends[1]]))
        if np.linalg.norm(shape.ends[0]) <= 1.001 * shape.size[0]
        else shape
        for shape in base
    ]
    rods = [
        in_world(T, shape.ends)
        for T, shapes in zip(frames, [base, *links], strict=True)
        for shape in shapes
        if shape.kind == "capsule"
    ]
    stops = [T[:3, 3] for T in (*frames, frames[-1] @ flange)]
    tolerance = 1e-10 * max(1.0, np.abs(stops).max())
    reached = [np.array([stops[0], stops[0]])]
    left = rods
    while True:  # walk along rods that touch reached points
        touching = [rod for rod in left if min(_gap(rod, at) for at in reached) < tolerance]
        if not touching:
            break
        reached += touching
        left = [rod for rod in left if not any(rod is taken for taken in touching)]
    for i, stop in enumerate(stops):
        gap = min(_gap(np.array([stop, stop]), at) for at in reached)
        assert gap < tolerance, f"nothing leads to frame {i}"
    assert not left, "a rod stands by itself"


def _gap(rod, other):
    """Returns the minimum distance of an end of either rod from the other rod."""
    return min(
        np.linalg.norm(ends[0] + np.clip(share, 0, 1) * along - end)
        for ends, points in ((rod, other), (other, rod))
        for end in points
        for along in [ends[1] - ends[0]]
        for share in [(end - ends[0]) @ along / max(along @ along, 1e-300)]
    )


@given(TABLES)
@settings(max_examples=examples(60), deadline=None)
def test_every_joint_has_a_housing_about_its_axis(table):
    frames = table.frames(np.zeros(len(table)))
    axes, points = table.joint_axes(frames)
    links = generate_shapes(table, np.eye(4))
    housings = housings_by_joint(table, links)
    for i, turns in enumerate(table.revolute):
        carrier, housing = housings[i]
        assert housing.kind == ("cylinder" if turns else "box")
        ends = in_world(frames[carrier], housing.ends)
        scale = max(1.0, np.abs(frames[:, :3, 3]).max())
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        np.testing.assert_allclose(along, axes[i], atol=1e-6)
        off = np.cross(ends.mean(axis=0) - points[i], axes[i])
        np.testing.assert_allclose(off, 0, atol=1e-11 * scale)
        if not turns:
            np.testing.assert_allclose(
                np.linalg.norm(ends[1] - ends[0]), 2 * housing.size[2], rtol=1e-6
            )


def housings_by_joint(table, links):
    """Returns each joint's housing and the link that carries it."""
    found = []
    for i, turns in enumerate(table.revolute):
        carrier = i + 1 if turns else i
        kind = "cylinder" if turns else "box"
        # In link 0 the pedestal, a cylinder, precedes it; in every other link the last joint's
        # housing.
        (housing,) = [s for s in links[carrier] if s.kind == kind and (carrier or kind == "box")]
        found.append((carrier, housing))
    return found


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_rod_of_a_prismatic_joint_stays_in_its_housing_over_its_stroke(convention):
    table = DhTable.from_rows([[0.7, 0.2, 0.3, 0.1]], convention, revolute=[False])
    base, link = generate_shapes(table, np.eye(4), np.array([0.25]))
    (housing,) = [shape for shape in base if shape.kind == "box"]
    centre = housing.ends.mean(axis=0)
    for q in (0.0, 0.25):
        T = table.frames([q])[1]
        ends = in_world(T, link[0].ends)  # the rod comes first, from its hidden end
        along = ends[1] - ends[0]
        share = (centre - ends[0]) @ along / (along @ along)
        np.testing.assert_allclose(ends[0] + share * along, centre, atol=1e-12)
        assert -1e-9 <= share <= 1


def test_arrows_are_at_the_housings_of_a_standard_table():
    # Joint 1 of the Puma rotates at its shoulder, not at the foot of its pedestal.
    puma = SerialRobot.from_model("puma560")
    puma = SerialRobot(name="puma560", dh_params=puma.dh_params, dh_convention="standard")
    world = World(Scene(robots=[puma]))
    data = world.make_data()
    links = generate_shapes(puma.dh, puma.flange_frame)
    frames = puma.dh.frames(puma.home)
    for i, (carrier, housing) in enumerate(housings_by_joint(puma.dh, links)):
        at = data.site(f"puma560/centre{i + 1}").xpos
        centre = in_world(frames[carrier], housing.ends).mean(axis=0)
        np.testing.assert_allclose(at, centre, atol=1e-12)
    np.testing.assert_allclose(data.site("puma560/centre1").xpos, [0, 0, 0.67183], atol=1e-12)


@given(TABLES)
@settings(max_examples=examples(30), deadline=None)
def test_housings_get_thinner_so_that_nested_joints_share_no_surface(table):
    links = generate_shapes(table, np.eye(4))
    radii = [housing.size[0] for _, housing in housings_by_joint(table, links)]
    assert all(thicker > thinner for thicker, thinner in pairwise(radii))
    rods = [shape.size[0] for link in links for shape in link if shape.kind == "capsule"]
    assert not rods or max(rods) < radii[0]


def test_sizes_are_proportional_to_the_reach():
    def sizes(scale):
        rows = np.array([[0, 0.3, 0, 0.1], [pi / 2, 0, 0, 0.4]]) * [1, scale, 1, scale]
        links = generate_shapes(DhTable.from_rows(rows, "craig"), np.eye(4))
        return np.array([shape.size[0] for link in links for shape in link])

    np.testing.assert_allclose(sizes(100.0), 100 * sizes(1.0), rtol=1e-12)


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_capsule_before_a_revolute_joint_ends_at_its_anchor(convention):
    # By hand: a link of 0.5 m along the joint axis, in the frame in which it is fixed.
    table = DhTable.from_rows([[pi / 2, 0, 0.3, 0.5]], convention)
    (rod,) = [shape for shape in generate_shapes(table, np.eye(4))[0] if shape.kind == "capsule"]
    end = np.array([0, -0.5, 0] if convention == "craig" else [0, 0, 0.5])
    # Its round end is on the ground.
    np.testing.assert_allclose(rod.ends, [rod.size[0] / 0.5 * end, end], atol=1e-15)


@given(TABLES, POINTS)
@example(zeros(64), (0.0, 0.0, 0.0))
@example(zeros(2, "standard", revolute=False), (0.0, 0.0, 0.0))
@settings(max_examples=examples(20), deadline=None)
def test_any_table_compiles_into_geoms_at_its_shapes(table, point):
    robot = robot_of(table, flange_at(point))
    world = World(Scene(robots=[robot], floor=False))
    model, data = world.model, world.make_data()
    links = generate_shapes(robot.dh, robot.flange_frame)
    drawn_only = trim_geoms(robot)
    assert model.ngeom == sum(map(len, [*links, *drawn_only]))
    assert not any(geom["mass"] for link in drawn_only for geom in link)
    assert any(drawn_only) == (len(table) <= 16)
    assert (model.geom_size[:, 0] > 0).all()
    frames = table.frames(np.zeros(len(table)))
    scale = max(1.0, np.abs(frames[:, :3, 3]).max())
    for body, T, shapes in zip(world.robots["robot"].bodies, frames, links, strict=True):
        first = model.body_geomadr[body]
        for geom, shape in enumerate(shapes, start=first):
            kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
            assert model.geom_type[geom] == kind
            assert not model.geom_contype[geom] and not model.geom_conaffinity[geom]
            centre = in_world(T, shape.ends).mean(axis=0)
            np.testing.assert_allclose(data.geom_xpos[geom], centre, atol=1e-10 * scale)
            axis = in_world(T, shape.ends)
            along = data.geom_xmat[geom].reshape(3, 3)[:, 2]
            length = np.linalg.norm(axis[1] - axis[0])
            assert abs(along @ (axis[1] - axis[0])) == pytest.approx(length, rel=1e-9)
            if shape.kind == "box":
                np.testing.assert_allclose(model.geom_size[geom], shape.size)
            else:
                np.testing.assert_allclose(model.geom_size[geom, :2], [shape.size[0], length / 2])


def test_object_fields_are_checked():
    with pytest.raises(DeclarationError) as caught:
        Object(name="a", shape="box", size=[1, 2], rgba=[0, 0, 0, 2], mesh_scale=0)
    assert caught.value.problems == [
        Problem("mesh_scale", found=0, expected="greater than 0"),
        Problem("rgba", found=[0.0, 0.0, 0.0, 2.0], expected="four numbers from 0 to 1"),
    ]


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, Problem(reason="found none of them; expected exactly one of shape, mesh, mjcf, urdf")),
        (
            {"mesh": "a.stl", "mjcf": "a.xml"},
            Problem(reason="found mesh and mjcf; expected exactly one of shape, mesh, mjcf, urdf"),
        ),
        (
            {"shape": "box"},
            Problem(
                reason="size of a box: found none; expected positive length x, length y, "
                "length z in m"
            ),
        ),
        (
            {"shape": "box", "size": [1, 2]},
            Problem(
                reason="size of a box: found [1.0, 2.0]; expected positive length x, length "
                "y, length z in m"
            ),
        ),
        (
            {"shape": "sphere", "size": [0]},
            Problem(reason="size of a sphere: found [0.0]; expected positive radius in m"),
        ),
        (
            {"shape": "capsule", "size": [1]},
            Problem(
                reason="size of a capsule: found [1.0]; expected positive radius, length "
                "between the centers of the half spheres in m"
            ),
        ),
        (
            {"mesh": "../a.stl"},
            Problem("mesh", found="../a.stl", expected="a file inside the directory, without '..'"),
        ),
        (
            {"mesh": "/a.stl"},
            Problem("mesh", found="/a.stl", expected="a file inside the directory, without '..'"),
        ),
        (
            {"mesh": "a.doc"},
            Problem(
                "mesh",
                found="a.doc",
                expected=f"a mesh file ({', '.join(mesh_endings())})",
            ),
        ),
    ],
)
def test_object_has_exactly_one_kind_and_a_valid_size(fields, problem):
    with pytest.raises(DeclarationError) as caught:
        Object(name="a", **fields)
    assert caught.value.problems == [problem]


def test_axes_have_the_length_of_the_proto_by_default():
    assert Object(name="a", shape="axes").size.tolist() == [0.2]


SNIPPET = '<mujoco><worldbody><geom name="g" size="1"/></worldbody></mujoco>'
ARM = '[robots.arm]\ndh_convention = "craig"\n'
NO_FILE = "No such file or directory"
# Messages of MuJoCo and of the XML parser are theirs, so texts are compared up to them.
UNREADABLE = [
    (
        f'{ARM}filenames = ["a.stl",\n "text.stl"]\ndirectory = "."',
        [
            f"s.toml:3: robots.arm.filenames.0: mesh a.stl: {NO_FILE}",
            "s.toml:4: robots.arm.filenames.1: mesh text.stl has no triangles",
        ],
    ),
    (
        f'{ARM}directory = "."\nfilenames = ["text.stl", "text.stl"]',
        [f"s.toml:4: robots.arm.filenames.{i}: mesh text.stl has no tri" for i in (0, 1)],
    ),
    (
        '[objects.a]\n\nmesh = "a.stl"\n[objects.b]\nmesh = "b.stl"',
        [
            f"s.toml:{3 + 2 * i}: objects.{name}.mesh: mesh {name}.stl: {NO_FILE}"
            for i, name in enumerate("ab")
        ],
    ),
    (
        '[objects.a]\n\nmesh = "text.stl"\n[objects.b]\nmesh = "text.obj"',
        [
            "s.toml:3: objects.a.mesh: mesh text.stl has no triangles",
            "s.toml:5: objects.b.mesh: mesh text.obj has no triangles",
        ],
    ),
    (
        '[objects.a]\nmjcf = "a.xml"\n[objects.b]\nmjcf = "<mujoco"\n'
        '[objects.c]\nmjcf = "<mujoco><blah/></mujoco>"',
        [f"s.toml:{2 + 2 * i}: objects.{name}.mjcf cannot be" for i, name in enumerate("abc")],
    ),
    (
        f'{ARM}[[robots.arm.children]]\nname = "t"\nmesh = "a.stl"\n'
        '[[robots.arm.children]]\nname = "u"\nmjcf = "a.xml"',
        ["s.toml:5: robots.arm.children.0.mesh: ", "s.toml:8: robots.arm.children.1.mjcf cannot"],
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), UNREADABLE)
def test_unusable_files_are_reported_at_once_with_key_and_line(tmp_path, text, expected):
    for name in ("text.stl", "text.obj"):
        (tmp_path / name).write_bytes(b"This is not a mesh at all.\n")
    (tmp_path / "s.toml").write_text(text)
    scene, problems = read_scene_file(tmp_path / "s.toml")
    assert problems == []
    with pytest.raises(DeclarationError) as caught:
        World(scene)
    found = str(caught.value).replace(f"{tmp_path}/", "").splitlines()
    assert len(found) == len(expected)
    for line, start in zip(found, expected, strict=True):
        assert line.startswith(start)


BALL = {"shape": "sphere", "size": [1]}
PIECE = {"mjcf": SNIPPET}


@pytest.mark.parametrize(
    ("items", "key"),
    [
        ([("a", BALL), ("a", BALL)], "objects.a"),
        ([("a", PIECE), ("a", PIECE)], "objects.a"),
        ([("floor", BALL)], "objects.floor"),  # the floor is a geom of that name
        ([("arm", PIECE)], "objects.arm"),  # a robot and an MJCF object share the namespace
    ],
)
def test_two_items_with_one_name_are_rejected_by_that_name(items, key):
    objects = [Object(name=name, **fields) for name, fields in items]
    robot = SerialRobot(name="arm", dh_convention="craig")
    with pytest.raises(DeclarationError) as caught:
        World(Scene(robots=[robot], objects=objects))
    assert str(caught.value).startswith(f"{key}: ")
    assert "name" in caught.value.problems[0].message


def test_robot_has_its_name_and_bodies_beside_an_object_of_that_name():
    # A geom and a robot do not share a namespace, so there is no conflict.
    robot = SerialRobot(name="arm", dh_convention="craig")
    world = World(Scene(robots=[robot], objects=[Object(name="arm", **BALL)]))
    assert world.robots["arm"].bodies.tolist() == [1, 2]


def test_child_can_have_the_name_of_a_link_mesh():
    meshes = paths.models_dir() / "lwr" / "meshes"
    child = Object(name="link0_0", mesh="base_white.stl", directory=str(meshes))
    world = World(Scene(robots=[SerialRobot.from_model("lwr", children=[child])]))
    assert world.model.geom("lwr/link0_0").type[0] == mujoco.mjtGeom.mjGEOM_MESH


def test_finish_is_a_material_of_links_and_objects_but_not_doubles() -> None:
    ball = Object(name="ball", **BALL, finish="rubber")
    robot = SerialRobot.from_model("lwr")
    double = Double(name="wanted", of="lwr")
    model = World(Scene(robots=[robot], doubles=[double], objects=[ball])).model
    of = {}
    for i in range(model.ngeom):
        material = model.geom_matid[i]
        of.setdefault(model.mat(material).name if material >= 0 else "", []).append(i)
    names = {name.rpartition("/")[2] for name in of}
    assert names == {"", "floor", "metal", "rubber"}
    assert of["rubber"] == [model.geom("ball").id]
    metal = next(geoms for name, geoms in of.items() if name.endswith("metal"))
    assert len(metal) == 2  # base and flange of the robot, but not of the double
    look = FINISHES["metal"]
    material = model.geom_matid[metal[0]]
    assert model.mat_metallic[material] == pytest.approx(look.metallic)
    assert model.mat_roughness[material] == pytest.approx(look.roughness)
    np.testing.assert_allclose(model.geom_rgba[metal], [robot.colors["steel"]] * 2, rtol=1e-6)
    assert model.geom_rgba[of["rubber"][0]] == pytest.approx(ball.rgba)


def test_unknown_finish_is_rejected_with_the_nearest() -> None:
    with raises_with(key="finish", found="metall"):
        LinkGeometry(shape="sphere", size=[1], finish="metall")
    with pytest.raises(DeclarationError, match="did you mean 'metal'"):
        LinkGeometry(shape="sphere", size=[1], finish="metall")


@pytest.mark.parametrize("what", [{"shape": "axes"}, PIECE])
def test_objects_without_our_surface_reject_a_finish(what) -> None:
    with pytest.raises(DeclarationError, match="finish: found 'metal' for"):
        Object(name="a", **what, finish="metal")
