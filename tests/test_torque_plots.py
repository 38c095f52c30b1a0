"""Live plots: their data and their gaps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_widgets import ScriptedWidgets
from source_slots import set_source

from sero_mj import Scene, SerialRobot, World
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.mailbox import Packets
from sero_mj.load import load_scene
from sero_mj.viewer.decor.quantities import joint_name
from sero_mj.viewer.panels.torque_plots import TorquePlots, y_range
from sero_mj.viewer.session.binned_history import SPAN
from sero_mj.viewer.session.torque_history import TorqueHistory, split_at_gaps


@pytest.fixture(scope="module")
def world(lwr_world: World) -> World:
    return lwr_world


def test_history_is_a_moving_window(world: World) -> None:
    history, data = TorqueHistory(world), world.make_data()
    for k in range(1500):
        data.time = k * 0.01
        world.set_input(data, "lwr.torques", np.full(7, float(k)))
        history.add(data)
    times, values = history.of(2)
    assert times[-1] == 0.0
    assert times[0] == pytest.approx(-SPAN, abs=0.02)
    assert values[0, -1] == 1499.0
    assert values[0] == pytest.approx(1499 + times * 100)
    assert np.isnan(values[1]).all()  # nothing was commanded
    data.time = 3.0  # back in time
    history.add(data)
    assert len(history.of(2)[0]) == 1


def test_plots_are_in_the_unit_of_the_robot() -> None:
    table = {"dh_convention": "craig", "dh_params": np.zeros((2, 4)), "torque_limits": [4e-3, 1e-3]}
    world = World(Scene(robots=[SerialRobot(name="r", **table)]))
    history, data = TorqueHistory(world), world.make_data()
    world.set_input(data, "r.torques", [2e-3, 1e-4])
    history.add(data)
    torques, error = TorquePlots(world, 100).plots(history, 1)
    assert (torques.y_label, error.y_label) == ("torque [mNm]", "error [mNm]")
    assert torques.limits == pytest.approx((1.0, -1.0))
    assert torques.lines[0].y[-1] == pytest.approx(0.1)


def test_every_packet_is_plotted_at_any_frame_rate() -> None:
    """At 1 kHz, 13 spikes of 5 ms; frames at 15 Hz."""
    scene = load_scene("lwr_udp")
    fed, routes = World(scene), wire(scene).check(scene).routes
    (events,) = {o.key for r in routes for o in r.value.origins if "torques" in r.to.key}
    history, data = TorqueHistory(fed, routes), fed.make_data()
    fed.set_input(data, "lwr.commanded_torques", np.full(7, 1.0))
    spikes = np.linspace(0.5, 7.5, 13)
    arrivals = 100.0 + np.arange(0.0, 8.0, 0.001)
    torques = np.full((len(arrivals), 7), 2.0)
    for k, spike in enumerate(spikes):
        torques[(arrivals >= 100 + spike) & (arrivals < 100.005 + spike)] = 30.0 + k
    shape = (7,)
    for begin, end in itertools.pairwise(np.arange(0.0, 8.05, 1 / 15)):
        rows = (arrivals >= 100 + begin) & (arrivals < 100 + end)
        data.time = end
        set_source(data, fed, "udp", age=0.001)
        if rows.any():
            values = np.zeros((rows.sum(), *shape))
            values.reshape(rows.sum(), -1)[:, :7] = torques[rows]
            packets = Packets({events: values}, arrivals[rows], 1)
            history.add_packets(data, "udp", packets, now=100 + end)
        history.add(data)
    times, (measured, _, error) = history.of(3)
    assert {30.0 + k for k in range(13)} <= set(measured.tolist())
    assert times[measured == 36.0] == pytest.approx(spikes[6] - times[-1] - data.time, abs=0.006)
    assert np.nanmin(error) == 1.0 - 42.0
    for points in (980, 320):  # for windows and pages
        torques, below = TorquePlots(fed, points).plots(history, 3)
        shown = torques.lines[0].y
        assert {30.0 + k for k in range(13)} <= set(shown.tolist())
        assert below.lines[0].y.min() == -41.0
        assert len(shown) < 1.5 * points


def test_plots_contain_both_lines_their_error_and_the_limit(world: World) -> None:
    history, plots, data = TorqueHistory(world), TorquePlots(world, 980), world.make_data()
    limit = float(world.joints.torque_limit[1])
    for k in range(50):
        data.time = k * 0.02
        world.set_input(data, "lwr.torques", np.full(7, 0.9 * limit))
        if k >= 20:
            world.set_input(data, "lwr.commanded_torques", np.full(7, 0.8 * limit))
        history.add(data)
    torques, error = plots.plots(history, 1)
    assert (torques.y_label, error.y_label) == ("torque [Nm]", "error [Nm]")
    assert torques.x_range == error.x_range == (-SPAN, 0.0)
    assert [line.name for line in torques.lines] == ["measured", "commanded"]
    assert [line.name for line in error.lines] == ["commanded - measured"]
    assert [len(line.x) for line in (*torques.lines, *error.lines)] == [50, 30, 30]
    assert torques.lines[1].y == pytest.approx(np.full(30, 0.8 * limit), rel=1e-6)
    assert error.lines[0].y == pytest.approx(np.full(30, -0.1 * limit), rel=1e-4)
    assert torques.limits == (limit, -limit)
    assert torques.y_range[1] > limit
    assert joint_name(world, 6) == "lwr/A6"


def history_of(world: World, *received: str) -> TorqueHistory:
    """Returns a second of data of a robot that sends these signals."""
    history, data = TorqueHistory(world), world.make_data()
    for k in range(50):
        data.time = k * 0.02
        for key in received:
            world.set_input(data, f"lwr.{key}", np.full(7, 5.0))
        history.add(data)
    return history


@pytest.mark.parametrize(("height", "labels"), [
    (40.0, ["torque [Nm]", "error [Nm]"]), (12.0, ["torque [Nm]"]), (1.0, []),
])  # fmt: skip
def test_joint_is_selected_and_plotted_if_there_is_space(
    world: World, height: float, labels: list[str]
) -> None:
    ui = ScriptedWidgets({"##joint": "lwr/A3"}, size=(30.0, height))
    history = history_of(world, "torques", "commanded_torques")
    joint = TorquePlots(world, 320).build(ui, history, 1)
    assert joint == 3  # E1 is the third joint
    assert ui.texts() == [f"limit {world.joints.torque_limit[3]:g} Nm"]
    assert [label for kind, label in ui.built if kind == "plot"] == labels


def test_largest_torque_of_all_packets_replaces_a_missing_limit() -> None:
    scene = load_scene("lwr_udp", overrides={"lwr.torque_limits": "largest"})
    fed, routes = World(scene), wire(scene).check(scene).routes
    history, data = TorqueHistory(fed, routes), fed.make_data()
    torques = np.full((20, 7), 2.0)
    torques[7, 3] = -31.0  # which no frame contains
    torques[9, 4] = np.nan
    packets = Packets({"values1": torques}, np.linspace(100.0, 100.02, 20), 1)
    data.time = 0.1
    history.add_packets(data, "udp", packets, now=100.03)
    floor = World(scene).joints.torque_limit
    expected = np.maximum(floor, [2.0, 2.0, 2.0, 31.0, 2.0, 2.0, 2.0])
    assert fed.joints.torque_limit == pytest.approx(expected)
    ui = ScriptedWidgets({"##joint": "lwr/A3"}, size=(30.0, 40.0))
    plots = TorquePlots(fed, 320)
    plots.build(ui, history, 3)
    assert ui.texts()[0] == "largest so far 31 Nm"
    assert not np.isfinite(plots.plots(history, 3)[0].limits).any()  # there is no line for it


@pytest.mark.parametrize(("received", "which"), [
    (["torques"], "commanded "), (["commanded_torques"], "measured "), ([], ""),
])  # fmt: skip
def test_missing_error_plot_is_explained(world: World, received: list[str], which: str) -> None:
    ui = ScriptedWidgets(size=(30.0, 40.0))
    TorquePlots(world, 320).build(ui, history_of(world, *received), 1)
    assert ui.texts()[-1].startswith(f"no {which}torques are received")
    assert [label for kind, label in ui.built if kind == "plot"] == ["torque [Nm]"]


def test_plot_has_a_gap_while_there_is_no_fresh_data() -> None:
    scene = load_scene("lwr_udp")
    fed = World(scene)
    history, plots, data = TorqueHistory(fed), TorquePlots(fed, 980), fed.make_data()
    fed.set_input(data, "lwr.torques", np.full(7, 5.0))
    for k in range(400):
        data.time = 0.01 * k
        # The last packet is sample 149. Its silence is detected half a second later.
        set_source(data, fed, "udp", age=0.01 * (k - 149) if 150 <= k < 250 else 0.001)
        history.add(data)
    times, values = history.of(2)
    assert np.isnan(values[0]).sum() == 100
    pieces = split_at_gaps(times, values[0])
    assert [len(piece) for piece in pieces] == [150, 150]
    line = plots.plots(history, 2)[0].lines[0]
    assert np.isnan(line.y).sum() == 1
    assert times[pieces[0][-1]] < line.x[np.isnan(line.y)][0] <= times[pieces[1][0]]
    short = np.where((times > -1.0) & (times < -0.9), np.nan, 1.0)
    assert len(split_at_gaps(times, short)) == 1  # too short to be visible


def test_plot_range_contains_the_values_and_near_limits() -> None:
    low, high = y_range(np.full(3, np.nan), 10.0, 0.5)
    assert low < 0 < high
    low, high = y_range(np.array([2.0, np.nan, 6.0]), np.inf, 0.5)
    assert (low, high) == (1.5, 6.5)  # round numbers
    low, high = y_range(np.array([-95.0, 20.0]), 100.0, 0.5)
    assert low < -100.0
    assert high > 20.0


@given(st.floats(-500, 500), st.floats(1e-3, 1000), st.sampled_from([20.0, 176.0, np.inf]))
def test_plot_range_has_round_ends(low: float, span: float, limit: float) -> None:
    bottom, top = y_range(np.array([low, low + span]), limit, 1e-9)
    assert bottom <= low and low + span <= top
    step = 10.0 ** np.floor(np.log10(top - bottom)) / 20
    for end in (bottom, top):
        assert end / step == pytest.approx(round(end / step), abs=1e-6)
