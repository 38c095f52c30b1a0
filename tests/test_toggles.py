"""Toggles: declared by a scene, set by packets, and changed by gestures."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from decor_tools import belonging, labels, rectangle, toggles_of, view_at

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene, SceneToggles
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.host.pointer import ClickDetector
from sero_mj.viewer.image.clicks import (
    CLICKS,
    KEYS,
    click,
    hover,
)
from sero_mj.viewer.image.picking import Picked, pick
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.session.input import DOUBLE_CLICK_TIME

Q = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
HERE = (100.0, 100.0)


@pytest.fixture(scope="module")
def world() -> World:
    return World(
        Scene(
            robots=[SerialRobot.from_model("lwr", joint_angles=Q, torques=np.full(7, 20.0))],
            doubles=[Double(name="goal", of="lwr", joint_angles=Q + 0.6)],
            arrows=[SmartArrow(name="push", at="lwr/flange", vector=[0, 0, 50])],
            frames=[ReceivedFrame(name="seen", frame=np.eye(4))],
            floor=False,
        )
    )


def placed(world: World) -> mujoco.MjData:
    data = world.make_data()
    Placer(world).place(data)
    return data


def picked(kind: str, index: int = 0, owner: str = "lwr") -> Picked:
    return Picked(kind, f"{owner}/x", owner, index, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("target", "read"),
    [
        ("lwr.show_arrows", lambda t: t.arrows[:7]),
        ("goal.show_arrows", lambda t: t.arrows[7:]),
        ("lwr.show_billboards", lambda t: t.billboards[:7]),
        ("goal.show_axes", lambda t: t.axes[9:17]),
        ("goal.visible", lambda t: t.doubles),
        ("push.show", lambda t: t.vectors),
        ("seen.show_axes", lambda t: t.axes[17:]),
        ("toggles.legend", lambda t: np.array([t.legend])),
        ("toggles.status", lambda t: np.array([t.status])),
        ("toggles.flange_checks", lambda t: np.array([t.flange_checks])),
        ("toggles.frame_names", lambda t: t.frame_names),
    ],
)
def test_input_switches_its_feature_and_no_other(world, target, read) -> None:
    data, toggles = placed(world), Toggles(world)
    assert world.frames.names[9] == "goal/link1"
    declared = toggles.snapshot()
    for value in (1.0, 0.0, 0.7):
        world.set_input(data, target, value)
        toggles.apply_inputs(data)
        assert (read(toggles) == (value > 0.5)).all()
    now = toggles.snapshot()
    others = [key for key, before in declared.items() if np.array_equal(before, now[key])]
    assert len(others) >= len(declared) - 1


def test_input_acts_when_its_value_changes_so_that_clicks_persist(world) -> None:
    data, toggles = placed(world), Toggles(world)
    world.set_input(data, "lwr.show_arrows", 1.0)
    toggles.apply_inputs(data)
    KEYS["a"][1](toggles)
    for _ in range(3):
        toggles.apply_inputs(data)
    assert not toggles.arrows[:7].any()
    data.userdata[world.slots["lwr.show_arrows"]] = np.nan
    toggles.apply_inputs(data)
    assert not toggles.arrows[:7].any()
    world.set_input(data, "lwr.show_arrows", 0.0)
    toggles.apply_inputs(data)
    world.set_input(data, "lwr.show_arrows", 1.0)
    toggles.apply_inputs(data)
    assert toggles.arrows[:7].all()


def test_packet_selects_the_quantity_and_invalid_values_are_ignored(world) -> None:
    data, toggles = placed(world), Toggles(world)
    for value, expected in ((2.0, 2), (3.0, 3), (9.0, 3), (-1.0, 3)):
        world.set_input(data, "lwr.arrow_quantity", value)
        toggles.apply_inputs(data)
        assert (toggles.arrow_quantity[:7] == expected).all()
    assert (toggles.arrow_quantity[7:] == 0).all()


def test_scene_declares_its_toggles() -> None:
    off = SceneToggles(legend=False, status=False, frame_names=True, flange_checks=False)
    toggles = Toggles(World(Scene(robots=[SerialRobot.from_model("lwr")], toggles=off)))
    assert not (toggles.legend or toggles.status or toggles.flange_checks)
    assert toggles.frame_names.all()
    toggles.legend = True
    toggles.frame_names[:] = False
    toggles.reset()
    assert toggles.frame_names.all() and not toggles.legend


@pytest.mark.parametrize(
    ("gesture", "kind", "field", "where"),
    [
        ("click", "link", "billboards", [2]),
        ("shift", "link", "billboards", range(7)),
        ("double", "link", "axes", range(9)),
        ("click", "arrow", "details", [2]),
        ("shift", "arrow", "details", range(7)),
        ("click", "axes", "frame_names", [2]),
        ("shift", "axes", "frame_names", range(9)),
    ],
)
def test_gestures_switch_on_and_off_again(world, gesture, kind, field, where) -> None:
    toggles = Toggles(world)
    toggles.axes[:] = False
    for shown in (True, False):
        assert click(world, toggles, picked(kind, 2), gesture)
        on = getattr(toggles, field).nonzero()[0].tolist()
        assert on == (list(where) if shown else [])


def test_double_can_be_clicked_like_a_robot(world) -> None:
    toggles = Toggles(world)
    assert click(world, toggles, picked("double", 9, "goal"))
    assert toggles.billboards.nonzero()[0].tolist() == [9]
    assert click(world, toggles, picked("double", 9, "goal"), "double")
    assert toggles.axes.nonzero()[0].tolist() == [*range(9, 17), 17]  # `seen` is on anyway
    assert not click(world, toggles, picked("double", -1, "path"))


def test_other_clicks_follow_the_click_table(world) -> None:
    toggles = Toggles(world)
    click(world, toggles, picked("vector", 0, ""))
    assert toggles.cards.all()
    click(world, toggles, picked("card", 0, ""))
    assert not toggles.cards.any()
    click(world, toggles, picked("arrow", 3), "double")
    assert toggles.arrow_quantity.tolist() == [1] * 7 + [0] * 7
    toggles.billboards[:] = toggles.details[:] = True
    click(world, toggles, picked("billboard", 4))
    assert not toggles.billboards[4] and not toggles.details[4] and toggles.billboards.sum() == 13
    click(world, toggles, picked("billboard", 4), "shift")
    assert toggles.billboards.nonzero()[0].tolist() == list(range(7, 14))
    toggles.axes[:] = True
    click(world, toggles, picked("axes", 3), "double")
    assert not toggles.axes[3] and toggles.axes.sum() == 17
    click(world, toggles, picked("check", 0))
    assert not toggles.flange_checks
    assert not click(world, toggles, picked("object", -1, ""))
    assert not click(world, toggles, None)
    assert click(world, toggles, None, "double")  # as declared by the scene
    assert toggles.flange_checks and not toggles.billboards.any()


def test_every_entry_of_the_click_table_changes_a_toggle(world) -> None:
    for gesture, kind in itertools.product(
        ("click", "shift", "double"), {kind for _, kind in CLICKS}
    ):
        toggles = Toggles(world)
        toggles.billboards[:] = toggles.details[:] = toggles.frame_names[:] = True
        toggles.axes[:] = toggles.cards[:] = True
        before = toggles.snapshot()
        did = click(world, toggles, picked(kind), gesture)
        after = toggles.snapshot()
        changed = any(not np.array_equal(before[key], after[key]) for key in before)
        # The viewer moves its view to an object; no toggle changes.
        moves_view = (gesture, kind) == ("double", "object")
        assert did == ((gesture, kind) in CLICKS), (gesture, kind)
        assert changed == (did and not moves_view), (gesture, kind)
    for key, (_, act) in KEYS.items():
        toggles = Toggles(world)
        toggles.billboards[0] = True
        before = toggles.snapshot()
        act(toggles)
        after = toggles.snapshot()
        assert any(not np.array_equal(before[k], after[k]) for k in before), key


def test_double_click_leaves_the_billboard_unchanged(world) -> None:
    toggles = Toggles(world)
    detector = ClickDetector(world, toggles)
    link = picked("link", 2)
    assert detector.press(link, HERE, 10.0) == "click"
    assert toggles.billboards[2]
    assert detector.press(link, HERE, 10.0 + 0.9 * DOUBLE_CLICK_TIME) == "double"
    assert not toggles.billboards.any() and toggles.axes[:9].all()
    # A third press begins a new click.
    assert detector.press(link, HERE, 10.0 + 1.5 * DOUBLE_CLICK_TIME) == "click"


@pytest.mark.parametrize(
    ("second", "time", "kind"),
    [
        (HERE, 1.1 * DOUBLE_CLICK_TIME, "link"),  # too late
        ((120.0, 100.0), 0.1, "link"),  # too far
        (HERE, 0.1, "vector"),  # which has no double click
    ],
)
def test_slow_or_distant_presses_are_two_clicks(world, second, time, kind) -> None:
    toggles = Toggles(world)
    before = toggles.snapshot()
    detector = ClickDetector(world, toggles)
    assert detector.press(picked(kind), HERE, 5.0) == "click"
    assert detector.press(picked(kind), second, 5.0 + time) == "click"
    after = toggles.snapshot()
    assert all(np.array_equal(before[key], after[key]) for key in before)  # on, and off again


def test_shift_never_begins_a_double_click(world) -> None:
    detector = ClickDetector(world, Toggles(world))
    assert detector.press(picked("link"), HERE, 1.0, shift=True) == "shift"
    assert detector.press(picked("link"), HERE, 1.1) == "click"
    assert detector.press(None, HERE, 2.0) == "click"
    assert detector.press(None, HERE, 2.1) == "double"


def test_hovering_shows_the_link_name_of_the_robot_file(world) -> None:
    toggles = Toggles(world)
    hover(toggles, Picked("link", "human/link20", "human", 19, 1.0, "human/left_hand"), HERE)
    assert toggles.hover == ("human/left_hand", HERE)


def test_hover_name_is_inside_the_image(world) -> None:
    toggles, view, decor = toggles_of(world), view_at(), Decor(world)
    data = placed(world)
    for x, y in itertools.product((0.0, view.width), (0.0, view.height)):
        hover(toggles, picked("link"), (x, y))
        buffer = decor.draw(data, toggles, view)
        rows = buffer.rows[: buffer.count]
        (label,) = rows[rows["label"] != b""]
        assert label["label"] == b"lwr/x"
        panel = rows[buffer.kinds[: buffer.count] == Kind.NONE]
        panel = panel[panel["type"] == int(mujoco.mjtGeom.mjGEOM_BOX)][-1]
        (centre, depth) = view.project(panel["pos"].astype(float))
        half = panel["size"][:2] / view.pixel_size(float(depth))
        assert (centre - half > -1).all()
        assert (centre + half < [view.width + 1, view.height + 1]).all()
    for nothing in (None, picked("billboard")):  # which shows its name already
        toggles.hover = ("something", HERE)
        hover(toggles, nothing, HERE)
        assert toggles.hover is None


@pytest.mark.gl
def test_hidden_double_is_neither_rendered_nor_picked(world) -> None:
    data = placed(world)
    plain = World(Scene(robots=[SerialRobot.from_model("lwr", joint_angles=Q)], floor=False))
    with HeadlessRenderer(world, 320, 240) as renderer, HeadlessRenderer(plain, 320, 240) as bare:
        toggles = renderer.toggles
        toggles.vectors[:] = toggles.axes[:] = False
        bare.camera = renderer.camera
        with_double = renderer.render(data).copy()
        picks = [renderer.pick(data, x, 120) for x in range(0, 320, 4)]
        assert any(found is not None and found.kind == "double" for found in picks)
        toggles.doubles[:] = False
        without = renderer.render(data)
        assert (np.abs(with_double.astype(int) - without).max(axis=2) > 20).sum() > 300
        expected = bare.render(plain.make_data())
        assert (np.abs(expected.astype(int) - without).max(axis=2) > 8).mean() < 0.002
        view = renderer.decor.view
        assert view is not None
        for x in range(0, 320, 4):  # the ray passes to the item behind
            found = renderer.pick(data, x, 120)
            behind = bare.pick(plain.make_data(), x, 120)
            assert (found is None) == (behind is None)
            if found is not None and behind is not None:
                assert (found.kind, found.name) == (behind.kind, behind.name)


def test_tolerance_does_not_override_an_exact_hit(world) -> None:
    data, toggles, view = placed(world), toggles_of(world), view_at()
    toggles.arrows[:] = toggles.billboards[:] = toggles.axes[:] = True
    buffer = Decor(world).draw(data, toggles, view)
    rng = np.random.default_rng(3)
    for pixel in rng.uniform((0, 0), (view.width, view.height), (400, 2)):
        exact = pick(world, data, buffer, view, tuple(pixel))
        if exact is not None and exact.kind not in ("link", "double", "object"):
            assert pick(world, data, buffer, view, tuple(pixel), 12.0) == exact


def test_hover_name_covers_no_values(world) -> None:
    toggles, view, decor = toggles_of(world), view_at(), Decor(world)
    data = placed(world)
    toggles.billboards[:] = True
    buffer = decor.draw(data, toggles, view)
    written = set(labels(buffer.rows[: buffer.count]))
    for joint in range(7):
        low, high = rectangle(view, belonging(buffer, Kind.BILLBOARD, joint)[0])
        for at in ((low[0] - 4, high[1] + 4), (high[0] + 4, low[1] - 4)):
            toggles.hover = ("lwr/link", at)
            there = decor.draw(data, toggles, view)
            assert set(labels(there.rows[: there.count])) == written | {"lwr/link"}
            toggles.hover = None
            buffer = decor.draw(data, toggles, view)
