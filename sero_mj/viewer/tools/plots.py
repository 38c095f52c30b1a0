"""`Plots`: plots the recent torques of the selected joint, and other signals."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, ClassVar

from ...base.frames import Array
from ...data.receive.mailbox import Packets
from ..panels.signal_plots import SignalPlots
from ..panels.torque_plots import TorquePlots
from ..session.binned_history import SPAN
from ..session.clock import HISTORY_SPAN
from ..session.keys import Key
from ..session.signals import PlotSignal, PlotSignals
from ..session.tool import Action, Shown, Tool
from ..session.torque_history import TorqueHistory
from ..session.widgets import Widgets

_AREA = "Plots"
_MIN_TORQUES = 12.0  # minimum height of the torque plots above other plots, in text heights
_SHARE = 0.4  # fraction of the height for the torque plots above other plots


class Plots(Tool):
    """Tool that shows and hides the plots with the key p."""

    order: ClassVar[int] = 15
    keys: ClassVar[Mapping[str, Key]] = {
        "p": Key("plot", "plots of the selected joint and of signals")
    }

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror, clock = shown.mirror, shown.clock
        # Live sources provide samples in packets between frames. For all other sources, the clock
        # provides samples.
        span = SPAN + HISTORY_SPAN if clock.is_live and clock.can_go_back else SPAN
        routes = mirror.routes if mirror.is_live else ()
        self.history = TorqueHistory(shown.world, routes, span)
        self.signals = PlotSignals(mirror, self.history)
        self.plots = SignalPlots(self.signals)
        self._has_joints = self.shows_torques = bool(shown.world.joints.names)
        self.area = _AREA if self.signals.groups else ""
        if mirror.is_live:
            mirror.listen(self._on_packets, to_all=True)
        self._torques: TorquePlots | None = None

    def actions(self) -> Mapping[str, Action]:
        return {"plot": self._toggle}

    def _toggle(self) -> str:
        self.shows_area = not self.shows_area
        return "" if self.area else "this scene has no signals to plot"

    @property
    def active(self) -> Collection[str]:
        return ["plot"] if self.shows_area else []

    @property
    def needs_every_state(self) -> bool:
        return bool(self.area and self.shows_area)

    def watch(self) -> None:
        self.history.add(self.shown.data)
        self.signals.watch()

    def _on_packets(self, source: str, packets: Packets) -> None:
        now = self.shown.mirror.sources[source].now()
        self.history.add_packets(self.shown.data, source, packets, now)

    def receive(self, message: Mapping[str, Array]) -> None:
        if not self.shown.clock.is_live and self.shown.clock.is_paused:
            return  # There is no displayed time for new samples.
        new = self.signals.add_program(message)
        if new:
            self.area, self.shows_area = _AREA, True
        for signal in new:
            self.plots.add(signal)

    def build_area(self, ui: Widgets) -> None:
        message = self.plots.build_choice(ui)
        if message:
            self.shown.say(message, is_bad=True)
        if self._has_joints and self.plots.shown:
            _, self.shows_torques = ui.check("torques of the joint", self.shows_torques)
        if self.signals.follow(self.plots.wanted):
            self.shown.clock.replay_past()
        clock = self.shown.clock
        self.history.until = clock.time if clock.is_past else None
        if self._has_joints and (self.shows_torques or not self.plots.shown):
            self._build_torques(ui)
        self.plots.build(ui, clock.time if clock.is_past else self.shown.data.time)

    def _build_torques(self, ui: Widgets) -> None:
        shown = self.shown
        if self._torques is None:
            self._torques = TorquePlots(shown.world, ui.points, ui.interval)
        height = float("inf")
        if self.plots.shown:
            height = max(_SHARE * ui.room()[1], _MIN_TORQUES)
        joint = self._torques.build(ui, self.history, shown.joint, height)
        if joint != shown.joint:
            shown.select(joint)

    @property
    def state(self) -> tuple[bool, tuple[tuple[PlotSignal, ...], ...]]:
        return self.shows_torques, tuple(tuple(lines) for lines in self.plots.shown)

    def restore(self, state: tuple[bool, tuple[tuple[PlotSignal, ...], ...]]) -> None:
        self.shows_torques = state[0]
        self.plots.shown = [[*lines] for lines in state[1]]

    @property
    def saved_state(self) -> Any:
        if not self.plots.shown:
            return None
        plots = [[[*signal] for signal in lines] for lines in self.plots.shown]
        return {"torques": self.shows_torques, "plots": plots}

    def restore_saved(self, state: Any) -> None:
        plots = [[PlotSignal(*map(str, signal)) for signal in lines] for lines in state["plots"]]
        known = [[each for each in lines if self.signals.may_have(each)] for lines in plots]
        self.plots.shown = [lines for lines in known if lines]
        self.shows_torques = bool(state["torques"])
