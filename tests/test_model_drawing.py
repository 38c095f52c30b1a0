"""Drawing of model details: their geoms, surface options, and no cost if they are off."""

from __future__ import annotations

import json
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from decor_tools import view_at
from foreign_models import arm
from page_client import PageClient
from test_web_host import client, page  # noqa: F401 (fixtures)

import sero_mj
from sero_mj import Double, HeadlessRenderer, Mirror, World
from sero_mj.base.errors import UsageError
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import dynamics_of
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import ARROW_SIZE_OF_LENGTH, Kind
from sero_mj.viewer.decor.model_drawing import ModelDrawing
from sero_mj.viewer.decor.part_names import named_parts
from sero_mj.viewer.decor.scene_writer import struct_view
from sero_mj.viewer.decor.toggles import PART_NAMES, Toggles
from sero_mj.viewer.image.switches import apply_switches
from sero_mj.viewer.player.capture import capture_pose
from sero_mj.viewer.player.copied_bodies import CopiedBodies
from sero_mj.viewer.player.encode import encode
from sero_mj.viewer.web.host import WebHost

GEOM, CAT = mujoco.mjtGeom, mujoco.mjtCatBit
TOUCHES = 2.0  # s, in table_contact


@pytest.fixture(scope="module")
def touching() -> Iterator[Mirror]:
    with Mirror(load_scene("table_contact")) as mirror:
        mirror.advance(TOUCHES)
        yield mirror


def rows_of(mirror: Mirror, *names: str) -> np.ndarray:
    toggles = Toggles(mirror.world)
    apply_switches(mirror.world, toggles, dict.fromkeys(names, "1"))
    return ModelDrawing(mirror.world).rows(mirror.data, toggles)


# ---- which geoms


def test_nothing_is_computed_by_mujoco_while_everything_is_off(
    touching: Mirror, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*given: object) -> None:
        raise AssertionError("called")

    for name in ("mjv_addGeoms", "mjv_updateScene", "mj_collision", "mj_forward"):
        monkeypatch.setattr(mujoco, name, refuse)
    assert len(rows_of(touching, "transparent", "wireframe", "part_names")) == 0


def test_contact_is_where_the_probe_touches_the_table(touching: Mirror) -> None:
    # Contact forces are unknown for a model that is only displayed.
    (row,) = rows_of(touching, "contacts")
    assert row["type"] == GEOM.mjGEOM_CYLINDER
    world, data = touching.world, touching.data
    tip = world.model.geom("lwr/probe").id
    end = data.geom_xpos[tip] - [0, 0, world.model.geom_size[tip].sum()]
    np.testing.assert_allclose(row["pos"][:2], end[:2], atol=0.004)
    assert row["pos"][2] == pytest.approx(0.15, abs=0.004)  # the table's top
    np.testing.assert_allclose(np.abs(row["mat"][:, 2]), [0, 0, 1], atol=1e-6)
    assert data.ncon == 0  # the displayed data is not changed


def test_inertias_are_boxes_of_the_simulated_masses(touching: Mirror) -> None:
    rows, world, data = rows_of(touching, "inertias"), touching.world, touching.data
    of = dynamics_of(world.scene)["lwr"]
    assert len(rows) == 8  # neither of doubles nor of the table
    for k, (row, body) in enumerate(zip(rows, world.robots["lwr"].bodies, strict=True)):
        T = data.xmat[body].reshape(3, 3)
        np.testing.assert_allclose(row["pos"], data.xpos[body] + T @ of.centers[k], atol=1e-5)
        a, b, c = row["size"].astype(float) ** 2
        moments = of.masses[k] / 3 * np.diag([b + c, a + c, a + b])  # of a box, half as long
        turn = row["mat"].astype(float)
        inertia = T.T @ turn @ moments @ turn.T @ T
        np.testing.assert_allclose(inertia, of.tensors[k], atol=2e-5)


def test_joint_axes_and_center_of_mass_are_drawn_at_their_positions(touching: Mirror) -> None:
    world, data = touching.world, touching.data
    rows = rows_of(touching, "joint_axes")
    np.testing.assert_allclose(rows["pos"], data.xanchor, atol=1e-6)
    np.testing.assert_allclose(rows["mat"][:, :, 2], data.xaxis, atol=1e-6)
    (row,) = rows_of(touching, "centres_of_mass")
    of, bodies = dynamics_of(world.scene)["lwr"], world.robots["lwr"].bodies
    turns = data.xmat[bodies].reshape(-1, 3, 3)
    centres = data.xpos[bodies] + np.einsum("kij,kj->ki", turns, of.centers)
    np.testing.assert_allclose(row["pos"], of.masses @ centres / of.masses.sum(), atol=1e-6)


def test_contact_forces_of_a_user_model_hold_its_weight() -> None:
    model, data = arm()
    for _ in range(1500):
        mujoco.mj_step(model, data)
    overlay = sero_mj.overlay(model, data)
    overlay.toggles.contacts = True
    before = data.contact.pos.copy(), data.efc_force.copy(), data.qacc.copy()
    drawing = ModelDrawing(overlay.world)
    rows = drawing.rows(data, overlay.toggles)
    forces = rows[rows["type"] == GEOM.mjGEOM_ARROW]
    cube = np.linalg.norm(forces["pos"] - data.body("cube").xpos, axis=1).argmin()
    length = forces["size"][cube, 2] / ARROW_SIZE_OF_LENGTH
    share = model.body("cube").mass[0] / model.body_subtreemass[0]
    assert length == pytest.approx(0.25 * model.stat.extent * share, rel=0.05)
    np.testing.assert_allclose(np.abs(forces["mat"][cube][:, 2]), [0, 0, 1], atol=0.05)
    for was, now in zip(before, (data.contact.pos, data.efc_force, data.qacc), strict=True):
        np.testing.assert_array_equal(was, now)
    assert model.vis.map.force == np.float32(0.005)  # the user's model is not changed


# ---- surfaces


def test_moving_links_are_transparent_and_pages_agree_with_mujoco(touching: Mirror) -> None:
    world, data, toggles = touching.world, touching.data, Toggles(touching.world)
    scene = mujoco.MjvScene(world.model, maxgeom=2000)
    rows = {}
    for on in (False, True):
        toggles.transparent = toggles.wireframe = on
        ModelDrawing(world).fill(data, toggles, mujoco.MjvCamera(), scene)
        found = struct_view(scene)
        assert found is not None
        rows[on] = found[: scene.ngeom].copy()
        assert scene.flags[mujoco.mjtRndFlag.mjRND_WIREFRAME] == on
    moves = rows[True]["category"] == CAT.mjCAT_DYNAMIC
    share = rows[True]["rgba"][:, 3] / rows[False]["rgba"][:, 3]
    np.testing.assert_allclose(share, np.where(moves, world.model.vis.map.alpha, 1.0), rtol=1e-6)
    run = encode(capture_pose(world, data, mujoco.MjvCamera()), "")
    head = json.loads(run[4 : 4 + int.from_bytes(run[:4], "little")])
    of_page = {body["name"]: body["moves"] for body in head["bodies"]}
    for row, is_moving in zip(rows[True], moves, strict=True):
        name = world.model.body(world.model.geom_bodyid[row["objid"]]).name
        assert of_page.get(name, is_moving) == is_moving, name
    assert {of_page["world"], of_page["lwr/link3"]} == {False, True}


# ---- names


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("none", []),
        ("bodies", ["lwr", *(f"lwr/link{k}" for k in range(1, 8)), "lwr/flange"]),
        ("joints", [f"lwr/{name}" for name in ("A1", "A2", "E1", "A3", "A4", "A5", "A6")]),
        ("geoms", ["floor", "table", "lwr/probe"]),
    ],
)
def test_names_are_drawn_at_the_parts_of_the_model(
    touching: Mirror, what: str, expected: list[str]
) -> None:
    world, data = touching.world, touching.data
    names, places = named_parts(world, data, PART_NAMES.index(what))
    assert names == expected
    if what == "joints":
        np.testing.assert_allclose(places, data.xanchor, atol=1e-9)
    if what == "geoms":
        ids = [world.model.geom(name).id for name in names]
        np.testing.assert_allclose(places, data.geom_xpos[ids], atol=1e-9)
    toggles = Toggles(world)
    toggles.part_names = PART_NAMES.index(what)
    decor = Decor(world)
    view = view_at(azimuth=1.4, distance=2.2)
    decor.draw(data, toggles, view)
    labels = [each for each in decor.panels if each.kind == Kind.PART]
    texts = [lines[0].decode() for each in labels for lines in each.texts]
    assert set(texts) <= set(expected) and len(texts) >= 0.6 * len(expected)
    for each in labels:  # in crowded places some are omitted, and none is far away
        pixels, _ = view.project(places[[names.index(text) for text in texts]])
        assert np.abs(each.centres - pixels)[:, 1].max() < 6 * each.sizes[0, 1]
        apart = np.abs(each.centres[:, None] - each.centres)
        clear = apart >= (each.sizes[:, None] + each.sizes) / 2 - 0.1
        assert (clear.any(axis=2) | np.eye(len(texts), dtype=bool)).all()


# ---- commands, windows and pages


def test_command_line_switches_are_applied_and_invalid_ones_rejected(touching: Mirror) -> None:
    toggles = Toggles(touching.world)
    apply_switches(touching.world, toggles, {"contacts": "1", "part_names": "3"})
    assert (toggles.contacts, toggles.part_names) == (True, 3)
    for name, digits, found in (("part_names", "4", "from 0 to 3"), ("inertias", "10", "2 digits")):
        with pytest.raises(UsageError, match=found):
            apply_switches(touching.world, toggles, {name: digits})
    with pytest.raises(UsageError, match="no switch 'contact'; did you mean 'contacts'"):
        apply_switches(touching.world, toggles, {"contact": "1"})
    toggles.reset()
    assert (toggles.contacts, toggles.part_names) == (False, 0)


@pytest.mark.gl
def test_images_show_red_inertias_in_a_transparent_arm(touching: Mirror) -> None:
    with HeadlessRenderer(touching.world, 320, 240, quality="draft") as renderer:
        renderer.toggles.arrows[:] = renderer.toggles.vectors[:] = False
        renderer.toggles.doubles[:] = False
        counts = []
        for name in ("legend", "inertias", "transparent"):
            setattr(renderer.toggles, name, name != "legend")
            red, green, blue = np.moveaxis(renderer.render(touching.data).astype(int), 2, 0)
            counts.append(int(((red > green + 20) & (red > blue + 20)).sum()))
    few, some, many = counts
    assert some > few + 100 and many > 1.5 * some


@pytest.mark.slow
def test_check_boxes_of_a_page_can_be_undone(page: WebHost, client: PageClient) -> None:  # noqa: F811
    assert client.state["shading"] == {"transparent": False, "wireframe": False}
    page.clock.pause()
    client.say("fold", tree="panel", id="Model", open=True)
    client.until(lambda: client.widget("panel", "Model").get("open"))
    few = np.frombuffer(client.state["items"][:4], "<u4")[0]
    for words in ("inertias", "wireframe"):
        client.say("widget", tree="panel", id=client.widget("panel", words)["id"], value=True)
    client.until(lambda: client.state["shading"] == {"transparent": False, "wireframe": True})
    count = client.until(lambda: int(np.frombuffer(client.state["items"][:4], "<u4")[0] - few))
    assert count == 8
    names = client.widget("panel", "displayed names")["id"]
    client.say("widget", tree="panel", id=names, value=PART_NAMES.index("joints"))
    client.until(lambda: [each for each in client.state["labels"] if each[0] == "lwr/A3"])
    words = page.render_words()
    assert {"inertias=1", "wireframe=1", "part_names=2"} <= set(words)
    client.until(lambda: page.tools["undo"].undo.is_settled and page.tools["undo"].undo.count)
    for _ in range(4):
        page.actions.press("ctrl+z")
    assert not page.toggles.inertias and page.toggles.part_names == 0


def test_program_opens_the_panel_of_a_page(page: WebHost, client: PageClient) -> None:  # noqa: F811
    page.toggle("shows_panel")
    client.until(lambda: client.state["panel"] is None)
    page.shows_panel = True
    client.until(lambda: client.state["panel"])


def test_doubles_of_an_overlay_are_additional_bodies_of_a_page() -> None:
    model, data = arm()
    ends = [[0.5, 0.4, 0.3, 0.02], [1.0, 0.8, 0.6, 0.04]]
    doubles = [Double(name="goal", of="arm"), Double(name="way", of="arm", path=ends)]
    overlay = sero_mj.overlay(model, data, doubles=doubles)
    world = overlay.world
    copies, path = CopiedBodies(world), world.doubles["way"].path
    assert path is not None
    links = ["arm", "upper", "fore", "gripper"]
    assert [each.name for each in copies.each] == [
        f"{name}/{link}" for name in ("goal", *["way"] * len(path)) for link in links
    ]
    shown = Toggles(world).doubles
    assert not copies.poses([])[2].any()
    overlay.set("goal.joint_angles", [1.5, 0.8, 0.5, 0.0])
    drawn = world.drawn_doubles(world.state(data), shown)
    places, turns, opacity = copies.poses(drawn)
    other = mujoco.MjData(model)
    for row, angles in enumerate([[1.5, 0.8, 0.5, 0.0], *path]):
        other.qpos[:] = data.qpos
        other.qpos[:4] = angles
        mujoco.mj_kinematics(model, other)
        for k, link in enumerate(links):
            np.testing.assert_allclose(places[4 * row + k], other.body(link).xpos, atol=1e-9)
            np.testing.assert_allclose(turns[4 * row + k], other.body(link).xquat, atol=1e-9)
    assert opacity[0] == 0  # it coincides with the arm
    assert (opacity[[1, 2, 3]] > 0.5).all()
    run = encode(capture_pose(world, data, mujoco.MjvCamera()), "")
    head = json.loads(run[4 : 4 + int.from_bytes(run[:4], "little")])
    first = len(head["bodies"]) - 4 * (1 + len(path))
    assert [body["double"] for body in head["bodies"][first:]] == [0] * 4 + [1] * 4 * len(path)
    copied = [geom for geom in head["geoms"] if geom["body"] >= first]
    assert [geom["body"] for geom in copied] == list(range(first, first + 4 * (1 + len(path))))
    assert {tuple(geom["rgba"]) for geom in copied if geom["body"] < first + 4} == {
        tuple(np.round(np.array(world.doubles["goal"].double.rgba) * 255).astype(int))
    }


def test_world_with_masses_is_drawn_without_a_copy() -> None:
    world = World(Scene(robots=[sero_mj.SerialRobot.from_model("lwr")]), dynamic=True)
    assert world.weighed() is world.model
