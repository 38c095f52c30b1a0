"""The plots of live hosts: what they hold, and where they have gaps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from source_slots import set_source

from sero_mj import World
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.mailbox import Packets
from sero_mj.load import load_scene
from sero_mj.viewer.session.torque_history import SPAN, TorqueHistory, joint_name, split_at_gaps
from sero_mj.viewer.web.torque_plots import decimate
from sero_mj.viewer.window.plots import TorquePlot, y_range


@pytest.fixture(scope="module")
def world(lwr_world: World) -> World:
    return lwr_world


def test_the_history_is_a_window_that_moves(world: World) -> None:
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


def test_every_packet_counts_at_any_frame_rate() -> None:
    """At 1 kHz 13 spikes of 5 ms; frames at 15 Hz."""
    scene = load_scene("lwr_udp")
    fed, routes = World(scene), wire(scene).check(scene).routes
    (events,) = {o.key for r in routes for o in r.value.origins if "torques" in r.to.key}
    history, plot, data = TorqueHistory(fed, routes), TorquePlot(fed), fed.make_data()
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
    figure, below = (each.figure for each in plot.fill(history, 3))
    shown = figure.linedata[0][1 : 2 * figure.linepnt[0] : 2]
    assert {30.0 + k for k in range(13)} <= set(shown.tolist())
    assert below.linedata[0][1 : 2 * below.linepnt[0] : 2].min() == -41.0
    x, y = decimate(times, measured)
    assert {30.0 + k for k in range(13)} <= set(y.tolist())
    assert len(x) < 700


def test_the_figure_holds_both_lines_and_the_limit(world: World) -> None:
    history, plot, data = TorqueHistory(world), TorquePlot(world), world.make_data()
    limit = float(world.joints.torque_limit[1])
    for k in range(50):
        data.time = k * 0.02
        world.set_input(data, "lwr.torques", np.full(7, 0.9 * limit))
        if k >= 20:
            world.set_input(data, "lwr.commanded_torques", np.full(7, 0.8 * limit))
        history.add(data)
    plots = plot.fill(history, 1)
    figure, error = (each.figure for each in plots)
    assert plots[0].title == "lwr/A2: torque [Nm], limit 176"
    assert [name for name, _ in plots[0].names] == ["measured", "commanded"]
    for each in plots:
        numbers = np.array(each.numbers, float)
        assert numbers[[0, -1]] == pytest.approx(each.figure.range[1])
        assert np.diff(numbers) == pytest.approx(np.diff(numbers)[0])
        assert len(numbers) == each.figure.gridsize[1]
    assert figure.linepnt[:4].tolist() == [50, 30, 2, 0]
    assert figure.linedata[1][1:60:2] == pytest.approx(np.full(30, 0.8 * limit), rel=1e-6)
    assert figure.range[1][1] > limit
    assert error.linepnt[:4].tolist() == [30, 0, 0, 0]
    assert error.linedata[0][1:60:2] == pytest.approx(np.full(30, -0.1 * limit), rel=1e-4)
    assert joint_name(world, 6) == "lwr/A6"


def test_a_plot_has_a_gap_while_there_is_no_fresh_data() -> None:
    scene = load_scene("lwr_udp")
    fed = World(scene)
    history, plot, data = TorqueHistory(fed), TorquePlot(fed), fed.make_data()
    fed.set_input(data, "lwr.torques", np.full(7, 5.0))
    for k in range(400):
        data.time = 0.01 * k
        # The last packet came with sample 149; that it is quiet is noticed half a second later.
        set_source(data, fed, "udp", age=0.01 * (k - 149) if 150 <= k < 250 else 0.001)
        history.add(data)
    times, values = history.of(2)
    assert np.isnan(values[0]).sum() == 100
    pieces = split_at_gaps(times, values[0])
    assert [len(piece) for piece in pieces] == [150, 150]
    figure = plot.fill(history, 2)[0].figure
    assert figure.linepnt[[0, 4]].tolist() == [150, 150]
    assert figure.linergb[4].tolist() == figure.linergb[0].tolist()
    newest, oldest = figure.linedata[0][0:300:2], figure.linedata[4][0:300:2]
    assert newest.min() > oldest.max() + 0.9
    x, y = decimate(times, values[0])
    assert np.isnan(y).sum() == 1
    assert times[pieces[0][-1]] < x[np.isnan(y)][0] <= times[pieces[1][0]]
    short = np.where((times > -1.0) & (times < -0.9), np.nan, 1.0)
    assert len(split_at_gaps(times, short)) == 1  # nobody would see it


def test_the_range_of_a_plot_holds_what_is_in_it() -> None:
    none = np.full(3, np.nan)
    low, high, _ = y_range(none, 10.0)
    assert low < 0
    assert high > 0
    low, high, _ = y_range(np.array([2.0, np.nan, 6.0]), np.inf)
    assert low < 2.0
    assert high > 6.0
    assert (low, high) == (1.0, 7.0)  # round numbers
    low, high, _ = y_range(np.array([-95.0, 20.0]), 100.0)
    assert low < -100.0
    assert high > 20.0


def test_thinned_lines_keep_every_peak() -> None:
    times = np.linspace(-8, 0, 1000)
    values = np.sin(times)
    values[[123, 777]] = 9.0, -9.0
    values[500:520] = np.nan
    x, y = decimate(times, values, 200)
    assert len(x) <= 210
    assert (np.diff(x) > 0).all()
    assert {9.0, -9.0} <= set(y.tolist())
    assert np.isin(x, times).all()
    few = decimate(times[:50], values[:50], 200)
    assert few[0].tolist() == times[:50].tolist()


@given(st.floats(-500, 500), st.floats(1e-3, 1000), st.sampled_from([20.0, 176.0, np.inf]))
def test_the_grid_of_a_plot_has_round_numbers(low: float, span: float, limit: float) -> None:
    bottom, top, steps = y_range(np.array([low, low + span]), limit)
    assert bottom <= low and low + span <= top
    assert 3 <= steps <= 8
    step = (top - bottom) / steps
    assert f"{step:.6e}"[:8] in ("1.000000", "2.000000", "5.000000")
    assert bottom / step == pytest.approx(round(bottom / step), abs=1e-6)  # so that 0 is among them
