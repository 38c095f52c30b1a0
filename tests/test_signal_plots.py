"""Plots of signals: of sources and runs, of joints, and of a program."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polling import until
from scripted_widgets import ScriptedWidgets
from shown import Shown
from source_slots import set_source
from window_tools import MISSING as NO_WINDOW
from window_tools import screen

import sero_mj
from sero_mj import Mirror, Scene, SerialRobot
from sero_mj.base.errors import UsageError
from sero_mj.data.receive.mailbox import Packets
from sero_mj.load import load_scene
from sero_mj.viewer.panels.signal_plots import MAX_LINES, MAX_PLOTS
from sero_mj.viewer.program.outbox import Outbox, UserSignals
from sero_mj.viewer.session.binned_history import SPAN, BinnedHistory
from sero_mj.viewer.session.signals import PROGRAM, PlotSignal
from sero_mj.viewer.tools.plots import Plots


def make_tool(scene: Scene | None = None) -> tuple[Plots, Shown]:
    shown = Shown(Mirror(scene or Scene(robots=[SerialRobot.from_model("lwr")])))
    shown.joint = 0  # type: ignore[attr-defined]
    return Plots(shown), shown


def choose(tool: Plots, plot: str, group: str, signal: str) -> ScriptedWidgets:
    """Returns the panel after the user has chosen a signal."""
    tool.build_area(ScriptedWidgets({"##plot": plot, "##group": group, "##signal": signal}))
    ui = ScriptedWidgets()
    tool.build_area(ui)
    return ui


def samples(values: Any, ages: Any) -> np.ndarray:
    """Returns samples of a program."""
    return np.column_stack([time.monotonic() - np.asarray(ages), values])


def test_program_signals_are_plotted_separately_with_peaks_and_gaps() -> None:
    tool, shown = make_tool()
    shown.data.time = 100.0
    tool.watch()
    ages = np.arange(4.0, 0.0, -0.001)  # s
    values = np.sin(ages)
    values[2000] = 50.0  # one sample
    values[1000:1400] = np.nan
    values[10] = np.inf
    tool.receive({"error": samples(values, ages), "speed": samples([3.0], [0.1])})
    assert tool.shows_area and tool.area == "Plots"
    ui = ScriptedWidgets()
    tool.build_area(ui)
    torque, error, speed = ui.plots
    assert torque.y_label == "torque [Nm]"
    assert [line.name for line in (*error.lines, *speed.lines)] == ["error", "speed"]
    assert error.x_range == (-SPAN, 0.0)
    (line,) = error.lines
    assert line.x[np.nanargmax(line.y)] == pytest.approx(-2.0, abs=0.01)
    assert np.nanmax(line.y) == 50.0 and error.y_range[1] >= 50.0
    assert np.isnan(line.y).sum() == 1  # of the gap
    assert line.x[np.isnan(line.y)] == pytest.approx(-3.0, abs=0.5)
    assert speed.y_range[0] < 3.0 < speed.y_range[1] < 3.1
    assert len(line.x) < 1.5 * ui.points
    # Samples for a paused view would have no time.
    shown.clock.is_paused = True
    tool.receive({"later": samples([1.0], [0.0])})
    assert "later" not in tool.signals.groups[PROGRAM]


def test_signals_are_added_to_plots_and_removed() -> None:
    tool, _ = make_tool()
    ui = choose(tool, "new plot", "lwr", "A1.joint_angles")
    ui = choose(tool, "plot 1", "lwr", "A2.joint_angles")
    assert [[line.name for line in plot.lines] for plot in ui.plots[1:]] == [
        ["A1.joint_angles", "A2.joint_angles"]
    ]
    before = tool.state
    ui = choose(tool, "new plot", "lwr", "A1.torque_error")
    assert [plot.y_label for plot in ui.plots[1:]] == ["plot 1", "plot 2"]
    choose(tool, "plot 1", "lwr", "A1.joint_angles (shown)")
    ui = choose(tool, "plot 1", "lwr", "A2.joint_angles (shown)")
    assert [[line.name for line in plot.lines] for plot in ui.plots[1:]] == [["A1.torque_error"]]
    tool.plots.toggle(0, PlotSignal(PROGRAM, "A1.torque_error"))
    ui = choose(tool, "plot 1", "lwr", "A2.torques")
    names = ["lwr A1.torque_error", "program A1.torque_error", "A2.torques"]
    assert [line.name for line in ui.plots[1].lines] == names
    tool.restore(before)  # undo
    assert tool.state == before
    ui = ScriptedWidgets({"torques of the joint": False})
    tool.build_area(ui)
    assert [plot.y_label for plot in ui.plots] == ["plot 1"]
    for k in range(20):
        tool.plots.toggle(0, PlotSignal(PROGRAM, f"{k}"))
    assert len(tool.plots.shown[0]) == MAX_LINES
    for k in range(20):
        tool.plots.add(PlotSignal(PROGRAM, f"more {k}"))
    assert len(tool.plots.shown) == MAX_PLOTS
    choose(tool, "new plot", "lwr", "A6.torques")
    assert tool.shown.said[-1] == ("at most 8 plots can be shown", True)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_signal_of_a_run_shows_the_past_once_selected() -> None:
    scene = load_scene("impedance_push")
    with Mirror(scene) as mirror:
        shown = Shown(mirror)
        shown.joint = 1  # type: ignore[attr-defined]
        tool, clock = Plots(shown), shown.clock
        while clock.time < 2.0:
            clock.advance(0.02)
        clock.is_paused = True
        clock.on_state = tool.watch
        clock.advance(0.02)
        choose(tool, "new plot", "simulation", "lwr_torques[1]")
        choose(tool, "plot 1", "lwr", "A2.joint_angles")
        assert clock.advance(0.02)
        ui = ScriptedWidgets()
        tool.build_area(ui)
        torque, angle = ui.plots[-1].lines
        (source,) = mirror.sources.values()
        rows, columns = source.run.rows, source.run.layout.columns  # type: ignore[attr-defined]
        rows = rows[(rows[:, 0] <= clock.time) & (rows[:, 0] > clock.time - SPAN)]
        wanted = rows[:, columns["lwr_torques"].start + 1]
        assert torque.x[0] == pytest.approx(-clock.time, abs=0.02)
        assert torque.y.max() == pytest.approx(wanted.max(), rel=1e-6)
        assert torque.y.min() == pytest.approx(wanted.min(), rel=1e-6)
        assert angle.y[-1] == pytest.approx(rows[-1, columns["lwr_joint_angles"].start + 1])
        assert len(angle.x) >= 100
        clock.seek(1.0)  # later values are no longer there
        clock.advance(0.0)
        ui = ScriptedWidgets()
        tool.build_area(ui)
        for line in ui.plots[-1].lines:
            assert line.x[-1] == pytest.approx(0.0, abs=0.01)
            assert line.x[0] == pytest.approx(-1.0, abs=0.02)


def test_every_packet_of_a_live_source_counts_and_silence_is_a_gap() -> None:
    tool, shown = make_tool(load_scene("lwr_udp"))
    (event,) = [name for name in tool.signals.groups["udp"] if name.endswith("[3]")][:1]
    signal = PlotSignal("udp", event)
    ui = choose(tool, "new plot", "udp", event)
    assert ui.plots[-1].lines[0].name == event
    choose(tool, "plot 1", "lwr", "A1.joint_angles")
    source, key = shown.mirror.sources["udp"], event.partition("[")[0]
    shape = source.events[key]
    data, world = shown.data, shown.world
    for k in range(300):  # at 20 Hz, with 50 packets each
        data.time = 1000.0 + 0.05 * k
        is_silent = 200 <= k < 240
        set_source(data, world, "udp", age=0.001 if not is_silent else 0.05 * (k - 199))
        if not is_silent:
            values = np.zeros((50, *shape))
            values.reshape(50, -1)[25, 3] = 7.0 if k == 250 else 0.0
            arrivals = source.now() - np.arange(0.05, 0.0, -0.001)
            tool.signals._on_packets("udp", Packets({key: values}, arrivals, 1))
        tool.watch()
    times, values = tool.signals.of(signal, data.time, 980)
    assert values.max() == 7.0
    assert times[values.argmax()] == pytest.approx(0.05 * (250 - 299) - 0.025, abs=0.02)
    assert np.diff(times).max() == pytest.approx(2.0, abs=0.06)
    times, values = tool.signals.of(PlotSignal("lwr", "A1.joint_angles"), data.time, 980)
    assert np.isnan(values).sum() >= 28  # from half a second after the last packet on
    assert BinnedHistory().until(None)[0].shape == (0,)


def test_plots_are_saved_for_their_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool, _ = make_tool()
    assert tool.saved_state is None
    for signal in (PlotSignal("lwr", "A3.torques"), PlotSignal(PROGRAM, "error")):
        tool.plots.add(signal)
    tool.shows_torques = False
    kept = tool.saved_state
    again, _ = make_tool()
    again.restore_saved(kept)
    assert again.state == tool.state
    kept["plots"].append([["lwr", "A99.torques"], ["gone", "values0[1]"]])
    again.restore_saved(kept)
    assert again.state == tool.state
    again.receive({"error": samples([1.0], [0.0])})  # it has a plot
    assert again.state == tool.state


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("error", "much", "plot 'error': found 'much'; expected a number"),
        ("error", [1, 2], "plot 'error': found [1, 2]; expected a number"),
        ("", 1.0, "plot: found ''; expected a text without '##'"),
        ("a##b", 1.0, "plot: found 'a##b'; expected a text without '##'"),
        (5, 1.0, "plot: found 5; expected a text without '##'"),
        ("more", 1.0, "plot 'more': found 101 signals; expected at most 100"),
    ],
)
def test_invalid_signals_are_rejected(name: Any, value: Any, message: str) -> None:
    outbox = Outbox(lambda tool, message: True)
    outbox.add = lambda tool, take: None  # type: ignore[method-assign]
    signals = UserSignals(outbox)
    for k in range(100 if name == "more" else 0):
        signals.add(f"{k}", k)
    with pytest.raises(UsageError) as caught:
        signals.add(name, value)
    assert message in str(caught.value)


def test_samples_that_are_not_fetched_are_limited() -> None:
    taken = []
    outbox = Outbox(lambda tool, message: True)
    outbox.add = lambda tool, take: taken.append(take)  # type: ignore[method-assign]
    signals = UserSignals(outbox)
    for k in range(30_000):
        signals.add("error", np.float32(k))
    (take,) = taken
    assert take()["error"][:, 1].tolist() == [*range(10_000, 30_000)]
    assert take() is None


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(NO_WINDOW), reason=f"needs {', '.join(NO_WINDOW)}")
def test_window_opens_plots_for_signals_of_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    with screen() as display:
        monkeypatch.setenv("DISPLAY", display)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        scene = Scene(robots=[SerialRobot.from_model("lwr")], name="plots")
        with sero_mj.view(scene, size=(800, 400)) as viewer:
            height = viewer.image().shape[0]
            viewer.plot("error", 0.1)
            assert until(lambda: viewer.image().shape[0] < height - 100, 60)  # for a strip below
            os.kill(viewer._process._process.pid, 9)
            assert until(lambda: not viewer.sync(), 60)
            viewer.plot("error", 0.1)
            viewer.plot("another", 0.1)
