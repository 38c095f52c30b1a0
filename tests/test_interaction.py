"""Picking and clicks, against a rendered segmentation."""

import mujoco
import numpy as np
import pytest
from conftest import examples
from decor_tools import belonging, of_kind, toggles_of, vertices_of, view_at, world_of
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.image.clicks import KEYS, click
from sero_mj.viewer.image.picking import (
    Picked,
    pick,
    ray_boxes,
    ray_triangles,
)
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.image.scene_decor import SceneDecor

POSE = np.deg2rad([30, 60, -40, 90, 50, -80, 20])
SIZE = (640, 480)


@pytest.fixture(scope="module")
def world() -> World:
    return world_of(
        joint_angles=POSE,
        torques=[120, -60, 30, -20, 14, -9, 4],
        show_arrows=True,
        show_billboards=True,
        show_axes=True,
        children=[Object(name="tool", shape="box", size=[0.03, 0.03, 0.1])],
    )


def label_at(renderer: HeadlessRenderer, data, pixels) -> dict[tuple[int, int], tuple[str, int]]:
    """Renders every geom in its own flat color and reads the colors back, as the oracle."""
    inner = renderer._renderer
    renderer.render(data)
    scene, buffer = inner.scene, renderer.decor.buffer
    first = scene.ngeom - buffer.count
    owners: list[tuple[str, int]] = [("", -1)]
    for i in range(scene.ngeom):
        geom = scene.geoms[i]
        if i >= first:
            kind = Kind(int(buffer.kinds[i - first]))
            owner = (kind.name, int(buffer.items[i - first])) if kind else ("", -1)
        elif geom.objtype == int(mujoco.mjtObj.mjOBJ_GEOM):
            owner = ("geom", int(geom.objid))
        else:
            owner = ("", -1)
        geom.segid = len(owners) - 1
        geom.transparent = 0
        owners.append(owner)
    # Leaders are between eye and robot and are not clickable, so the oracle must not see them.
    for i in range(first, scene.ngeom):
        if scene.geoms[i].type == mujoco.mjtGeom.mjGEOM_TRIANGLE and not buffer.kinds[i - first]:
            scene.geoms[i].segid = -1
    flags = scene.flags.copy()
    scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 1
    scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
    image = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    inner._gl_context.make_current()
    mujoco.mjr_render(inner._rect, scene, inner._mjr_context)
    mujoco.mjr_readPixels(image, None, inner._rect, inner._mjr_context)
    scene.flags[:] = flags
    ids = np.flipud(image).astype(int) @ [1, 256, 65536]
    return {(x, y): owners[ids[y, x]] for x, y in pixels}, ids


def compare(world: World, camera: str) -> tuple[int, int, set[str]]:
    """Picks random pixels of random poses from random directions.

    Returns the number of picks, the number of differences from the oracle, and the kinds that were
    picked.
    """
    rng = np.random.default_rng(0)
    data, placer = world.make_data(), Placer(world)
    asked = wrong = 0
    seen: set[str] = set()
    with HeadlessRenderer(world, *SIZE, camera) as renderer:
        shape = renderer.decor.first_shape
        renderer.decor = SceneDecor(world)  # with panels in the scene, where the oracle sees them
        renderer.decor.first_shape = shape
        renderer.toggles.legend = False
        renderer.toggles.cards[:] = True
        for _ in range(examples(12)):
            for name in world.owners:
                world.set_input(data, f"{name}.joint_angles", rng.uniform(-1.8, 1.8, 7))
            placer.place(data)
            look = renderer.camera
            look.azimuth, look.elevation = rng.uniform(0, 360), rng.uniform(-40, 10)
            pixels = [(int(x), int(y)) for x, y in rng.uniform(0.15, 0.85, (300, 2)) * SIZE]
            expected, ids = label_at(renderer, data, pixels)
            for (x, y), (kind, item) in expected.items():
                around = ids[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
                if (around != around[0, 0]).any():
                    continue  # on an edge both answers are right
                picked = renderer.pick(data, x, y)
                asked += 1
                wrong += not is_right(world, picked, kind, item)
                seen.add("DOUBLE" if picked is not None and picked.kind == "double" else kind)
    return asked, wrong, seen


def is_right(world: World, picked: Picked | None, kind: str, item: int) -> bool:
    """Returns whether the picked item equals the oracle's."""
    if not kind or picked is None:
        return not kind and picked is None
    if kind != "geom":
        return picked.kind.upper() == kind and picked.index == item
    body = int(world.model.geom_bodyid[item])
    for name, part in world.doubles.items():
        if (part.bodies == body).any():
            link = int((part.bodies == body).nonzero()[1][0])
            return picked.kind == "double" and picked.name == f"{name}/link{link}"
    link = (world.robots["lwr"].bodies == body).nonzero()[0]
    index = max(int(link[0]) - 1, 0) if len(link) else picked.index
    return picked.kind in ("link", "object") and picked.index == index


@pytest.mark.thorough
@pytest.mark.gl
def test_picking_agrees_with_a_rendered_segmentation(world) -> None:
    asked, wrong, seen = compare(world, "150,-15,2.0")
    assert {"geom", "ARROW", "BILLBOARD", "AXES"} <= seen
    assert asked > 200 * examples(12)
    assert wrong / asked < 0.005  # between two surfaces a pixel apart


@pytest.mark.thorough
@pytest.mark.gl
def test_picking_agrees_for_doubles_smart_arrows_and_received_frames() -> None:
    shown = {"show_arrows": True, "show_axes": True, "torques": [90, -60, 30, -20, 14, -9, 4]}
    scene = Scene(
        robots=[SerialRobot.from_model("lwr", **shown)],
        doubles=[Double(name="goal", of="lwr", show_billboards=True, **shown)],
        arrows=[
            SmartArrow(name="push", at="lwr/flange", vector=[10, 60, 50]),
            SmartArrow(name="turn", kind="torque", at="lwr/link4", vector=[5, 10, 8]),
            SmartArrow(name="wind", kind="velocity", at=[0.3, 0.3, 0.6], vector=[0.4, 0.2, 0]),
        ],
        frames=[ReceivedFrame(name="seen", relative_to="lwr/link4", frame=np.eye(4))],
        floor=False,
    )
    asked, wrong, seen = compare(World(scene), "150,-15,2.4")
    assert {"geom", "DOUBLE", "ARROW", "BILLBOARD", "AXES", "VECTOR", "CARD"} <= seen
    assert asked > 200 * examples(12)
    assert wrong / asked < 0.001


@given(st.integers(0, 2**31))
def test_rays_hit_boxes_where_mujoco_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, half = rng.uniform(-1, 1, 3), rng.uniform(0.05, 0.6, 3)
    quat = rng.normal(size=4)
    mat = np.empty(9)
    mujoco.mju_quat2Mat(mat, quat / np.linalg.norm(quat))
    origin = rng.uniform(-3, 3, 3)
    direction = centre + rng.uniform(-0.8, 0.8, 3) - origin
    direction /= np.linalg.norm(direction)
    got = ray_boxes(origin, direction, centre[None], mat.reshape(1, 3, 3), half[None])[0]
    box = int(mujoco.mjtGeom.mjGEOM_BOX)
    expected = mujoco.mju_rayGeom(centre, mat, half, origin, direction, box, None)
    inside = (np.abs(mat.reshape(3, 3).T @ (origin - centre)) <= half).all()
    if inside:
        assert got == 0.0  # MuJoCo returns where the ray leaves
    elif expected < 0:
        assert got == np.inf
    else:
        assert got == pytest.approx(expected, abs=1e-9)


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.05, 0.3]))
def test_rays_hit_triangles_or_pass_within_the_margin(seed, margin) -> None:
    rng = np.random.default_rng(seed)
    corner, edges, origin = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, (3, 2)), rng.uniform(-3, 3, 3)
    direction = corner + edges @ rng.uniform(-0.3, 0.9, 2) - origin
    direction /= np.linalg.norm(direction)
    (got,) = ray_triangles(origin, direction, corner[None], edges[None], np.array([margin]))
    u, v, expected = np.linalg.solve(np.column_stack([edges, -direction]), origin - corner)
    if u > 1e-9 and v > 1e-9 and u + v < 1 - 1e-9 and expected > 1e-9 and not margin:
        assert got == pytest.approx(expected, abs=1e-6)
    if min(u, v, 1 - u - v) < -1e-9 and not margin:
        assert got == np.inf
    # Sampled points: the one nearest to the ray is within the margin, or none is.
    steps = np.linspace(0, 1, 60)
    points = corner + [edges @ (a, b) for a in steps for b in steps if a + b <= 1 + 1e-9]
    along = (points - origin) @ direction
    beside = np.linalg.norm(points - origin - along[:, None] * direction, axis=1)
    gap, between = beside.min(), np.linalg.norm(edges, axis=0).sum() / 59
    if margin and along.min() > 0 and abs(gap - margin) > between:
        assert (got < np.inf) == (gap < margin)


def scene_of_frame(world: World, toggles, view, data):
    decor = Decor(world)
    return decor.draw(data, toggles, view)


def test_touch_picks_near_items_and_a_mouse_does_not(world) -> None:
    data, view = world.make_data(), view_at()
    toggles = toggles_of(world)
    toggles.billboards[:] = toggles.arrows[:] = False
    buffer = scene_of_frame(world, toggles, view, data)
    frame = world.frames.names.index("lwr/base")
    bars = (buffer.items[: buffer.count] == frame).nonzero()[0]
    bar = buffer.rows[bars[0]]
    tip = bar["pos"] + bar["mat"][:, 2] * bar["size"][2]
    (x, y), _ = view.project(tip.astype(float))
    beside = (x + 8.0 * np.sign(x - view.width / 2), y)
    assert pick(world, data, buffer, view, beside) is None
    found = pick(world, data, buffer, view, beside, tolerance=12.0)
    assert found is not None
    assert found.kind == "axes"


def picked(world: World, kind: str, joint: int) -> Picked:
    return Picked(kind, "", "lwr", joint, 1.0)  # type: ignore[arg-type]


def test_click_on_a_link_toggles_its_billboard_and_with_shift_all(world) -> None:
    toggles = toggles_of(world)
    toggles.billboards[:] = False
    click(world, toggles, picked(world, "link", 3))
    assert toggles.billboards.nonzero()[0].tolist() == [3]
    click(world, toggles, picked(world, "link", 3), "shift")
    assert not toggles.billboards.any()
    click(world, toggles, picked(world, "link", 3), "shift")
    assert toggles.billboards.all()


def test_click_on_a_billboard_hides_it_with_its_details(world) -> None:
    toggles = toggles_of(world)
    toggles.details[2] = True
    click(world, toggles, picked(world, "billboard", 2))
    assert not toggles.billboards[2] and not toggles.details[2]
    assert toggles.billboards.sum() == 6


def test_robot_without_touch_sensor_ignores_clicks_except_on_arrows() -> None:
    world = world_of(enable_touch_sensor=False, torques=np.full(7, 9.0), show_arrows=True)
    toggles = toggles_of(world)
    click(world, toggles, picked(world, "link", 3))
    assert not toggles.billboards.any()
    click(world, toggles, picked(world, "arrow", 3))
    assert toggles.details[3]


def test_click_on_an_arrow_shows_its_precise_values() -> None:
    world = world_of(
        torques=[0, 0, 30.0, 0, 0, 0, 0], commanded_torques=np.full(7, 28.0), show_arrows=True
    )
    toggles = toggles_of(world)
    data, view = world.make_data(), view_at()
    decor = Decor(world)
    buffer = decor.draw(data, toggles, view)
    (arrow,) = belonging(buffer, Kind.ARROW)
    vertices = vertices_of(arrow)
    depth = (vertices - view.position) @ view.forward
    (x, y), _ = view.project(vertices[np.argmin(depth)])
    found = pick(world, data, buffer, view, (float(x), float(y)))
    assert found is not None
    assert (found.kind, found.name, found.index) == ("arrow", "lwr/E1", 2)
    click(world, toggles, found)
    rows = decor.draw(data, toggles, view).rows[: decor.buffer.count]
    labels = [row["label"].decode() for row in of_kind(rows, mujoco.mjtGeom.mjGEOM_LABEL)]
    assert labels == [
        "E1  cmd    28.0 Nm",
        "    msr    30.0 Nm",
        "    err    -2.00 Nm",
        "    limit   100.0 Nm",
        "    share    30.0 %",
        "z",  # of the axis
    ]


def test_details_of_a_joint_without_limit_show_none() -> None:
    robot = SerialRobot(dh_convention="craig", torques=[1.0])
    world = World(Scene(robots=[robot], floor=False))
    toggles = toggles_of(world)
    toggles.details[0] = True
    buffer = Decor(world).draw(world.make_data(), toggles, view_at(distance=20))
    rows = of_kind(buffer.rows[: buffer.count], mujoco.mjtGeom.mjGEOM_LABEL)
    labels = [row["label"].decode() for row in rows]
    assert labels[0] == "J1  cmd  no data"
    assert labels[3] == "    limit  none"


def test_click_on_axes_shows_their_name_and_a_second_one_hides_it(world) -> None:
    toggles = toggles_of(world)
    toggles.billboards[:] = toggles.arrows[:] = False
    frame = world.frames.names.index("lwr/link6")
    click(world, toggles, picked(world, "axes", frame))
    buffer = Decor(world).draw(world.make_data(), toggles, view_at())
    rows = of_kind(buffer.rows[: buffer.count], mujoco.mjtGeom.mjGEOM_LABEL)
    assert [row["label"] for row in rows] == [b"lwr/link6"]
    click(world, toggles, picked(world, "name", frame))
    assert not toggles.frame_names.any()


def test_names_of_coincident_frames_are_stacked(world) -> None:
    toggles = toggles_of(world)
    toggles.billboards[:] = toggles.arrows[:] = False
    for name in ("lwr/link5", "lwr/link6", "lwr/link7"):  # the wrist
        toggles.frame_names[world.frames.names.index(name)] = True
    view = view_at()
    buffer = Decor(world).draw(world.make_data(), toggles, view)
    named = buffer.rows[: buffer.count][buffer.kinds[: buffer.count] == Kind.NAME]
    _, heights = view.project(named["pos"].astype(float))[0].T
    assert (np.diff(np.sort(heights)) > view.font.height).all()


def test_every_key_does_what_the_key_table_describes(world) -> None:
    toggles = toggles_of(world)
    for key, field in (("a", "arrows"), ("b", "billboards"), ("x", "axes"), ("n", "frame_names")):
        before = getattr(toggles, field).any()
        KEYS[key][1](toggles)
        assert getattr(toggles, field).all() == (not before)
    KEYS["q"][1](toggles)
    assert (toggles.arrow_quantity == 1).all()
    KEYS["l"][1](toggles)
    assert toggles.legend
    assert set(KEYS) == set("abxnqdvclsr")


@pytest.mark.gl
def test_objects_are_picked_and_floor_and_sky_are_not() -> None:
    ball = Object(name="ball", shape="sphere", size=[0.2], frame={"xyz": [0, 0, 0.5]})
    world = World(Scene(objects=[ball]))
    data = world.make_data()
    with HeadlessRenderer(world, 200, 200, "90,-10,2") as renderer:
        found = renderer.pick(data, 100, 100)
        assert found is not None
        assert (found.kind, found.name) == ("object", "ball")
        assert found.distance == pytest.approx(1.8, abs=0.02)
        assert renderer.pick(data, 5, 195) is None  # floor
        assert renderer.pick(data, 5, 5) is None  # sky
        assert renderer.click(data, 100, 100) == found  # and nothing happens
