"""Decor at its limits: frames without a pose, noise, 51 joints with everything on, invalid data."""

import numpy as np
import pytest
from decor_tools import belonging, labels, rectangle, toggles_of, view_at
from source_slots import set_source

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.flange_check import OFF_RGBA
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.smart_arrows import frames_along

JUSTIN = [3, 7, 7, 12, 12, 2, 8]


def draw(scene, edit=None, toggle=None, view=None):
    world = World(scene)
    data = world.make_data()
    if edit:
        edit(world, data)
    Placer(world).place(data)
    toggles = toggles_of(world)
    if toggle:
        toggle(toggles)
    return Decor(world).draw(data, toggles, view or view_at())


def lwr(**fields):
    return SerialRobot.from_model("lwr", **fields)


@pytest.mark.parametrize(
    ("at", "expressed_in"), [("lwr/flange", "s"), ("s", None), ("s", "world"), ("g/flange", None)]
)
def test_arrow_without_a_frame_pose_is_not_drawn(at, expressed_in):
    scene = Scene(
        robots=[lwr()],
        frames=[ReceivedFrame(name="s")],
        doubles=[Double(name="g", of="lwr")],
        arrows=[SmartArrow(name="a", at=at, expressed_in=expressed_in, vector=[20, 0, 0])],
        floor=False,
    )
    assert draw(scene).count == 0


def test_frame_that_became_nan_has_no_axes_and_no_name():
    def nan(world, data):
        world.set_input(data, "s.frame", np.eye(4))
        data.userdata[world.slots["s.frame"]] = np.nan

    assert draw(Scene(frames=[ReceivedFrame(name="s")], floor=False), nan).count == 0


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1, -1])
def test_noise_does_not_rotate_a_round_arrow(axis, sign):
    rng = np.random.default_rng(0)
    d = sign * np.eye(3)[axis] + 1e-3 * rng.normal(size=(100, 3))
    R = frames_along(d / np.linalg.norm(d, axis=1, keepdims=True))
    assert np.abs(R - R[0]).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lines", "own"),
    [
        (2, {}),
        (3, {}),
        (1, {"show_arrows": True}),
        (1, {"show_billboards": True}),
        (1, {"show_axes": True}),
        (1, {"show_arrows": True, "show_billboards": True, "show_axes": True}),
    ],
)
def test_billboards_of_51_joints_fit_the_image(lines, own):
    rng = np.random.default_rng(1)
    robots, doubles = [], []
    for i, n in enumerate(JUSTIN):
        q = rng.uniform(-1, 1, n)
        robots.append(
            SerialRobot(
                name=f"r{i}",
                dh_convention="craig",
                dh_params=np.resize(lwr().dh_params, (n, 4)),
                base_frame={"xyz": [0, 0.6 * i, 0]},
                torque_limits=np.full(n, 40.0),
                joint_angles=q,
                torques=np.full(n, 9.0),
                show_arrows=True,
                show_billboards=True,
                show_axes=True,
                billboard_lines=["torques", "joint_angles", "torque_error"][:lines],
            )
        )
        doubles.append(
            Double(name=f"d{i}", of=f"r{i}", joint_angles=q + 0.5, torques=np.full(n, 9.0), **own)
        )
    buffer = draw(Scene(robots=robots, doubles=doubles), view=view_at(0.0, 12, 3840, 2160))
    assert buffer.dropped == 0


def test_precise_values_of_51_joints_fit_the_image():
    robots = [
        SerialRobot(
            name=f"r{i}",
            dh_convention="craig",
            dh_params=np.resize(lwr().dh_params, (n, 4)),
            base_frame={"xyz": [0, 0.6 * i, 0]},
            torque_limits=np.full(n, 40.0),
            torques=np.full(n, 9.0),
            show_arrows=True,
            show_axes=True,
        )
        for i, n in enumerate(JUSTIN)
    ]

    def details(t):
        t.details[:] = True

    buffer = draw(Scene(robots=robots), toggle=details, view=view_at(0.0, 12, 3840, 2160))
    assert buffer.dropped == 0


def test_scale_is_shown_for_two_quantities():
    arrows = [SmartArrow(name="contact", at="lwr/flange", vector=[9, 0, 0])]

    def two(t):
        t.legend, t.arrow_quantity[3:] = True, 1

    for size in ((1280, 800), (640, 480)):
        scene = Scene(
            robots=[lwr(torques=np.ones(7), show_arrows=True)], arrows=arrows, floor=False
        )
        buffer = draw(scene, toggle=two, view=view_at(0.7, 2.5, *size))
        assert any("contact" in text for text in labels(buffer.rows[: buffer.count])), size


def test_hidden_double_is_not_reported_as_stale():
    def never(world, data):
        set_source(data, world, "udp", size=56)

    scene = Scene(
        robots=[lwr()],
        doubles=[Double(name="g", of="lwr", visible=False)],
        floor=False,
        sources={"udp": {"kind": "udp", "port": 1, "structure": "7F"}},
        routes={"g.joint_angles": "udp.values0"},
    )
    buffer = draw(scene, never)
    said = labels(buffer.rows[: buffer.count])
    assert said[0] == "no packet yet on UDP 127.0.0.1:1"
    assert not any(text.startswith("g:") for text in said)


@pytest.mark.parametrize("value", [1e30, 1e200])
def test_absurd_vector_counts_as_no_data(value):
    def absurd(world, data):
        data.userdata[world.slots["a.vector"]] = (value, 0, 0)
        data.userdata[world.flags["a.vector"]] = 1

    def card(t):
        t.cards[:] = True

    arrows = [SmartArrow(name="a", at="lwr/flange")]
    buffer = draw(Scene(robots=[lwr()], arrows=arrows, floor=False), absurd, card)
    (panel,) = belonging(buffer, Kind.CARD)
    low, high = rectangle(view_at(), panel)
    assert high[0] - low[0] < 400


def test_large_flange_error_outside_the_image_is_shown_in_the_corner():
    def off(world, data):
        T = world.scene.robots["lwr"].fwd_kin_base_to_flange()
        T[:3, 3] += [0.0, 0.0, 50.0]
        world.set_input(data, "lwr.flange_check", T)

    view = view_at()
    buffer = draw(Scene(robots=[lwr()], floor=False), off, view=view)
    rows = buffer.rows[: buffer.count]
    (label,) = labels(rows)
    assert label == "lwr flange is off 50000.00 mm    0.00 deg"
    panel = rows[np.isclose(rows["rgba"], OFF_RGBA).all(axis=1)]
    ((x, y),), _ = view.project(panel["pos"].astype(float))
    assert x > view.width / 2 and y > 0.9 * view.height
