"""`TorquePlot`: plots the torques of the selected joint over the last seconds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import ClassVar

from ...data.receive.mailbox import Packets
from ..panels.torque_plots import TorquePlots
from ..panels.widgets import Widgets
from ..session import live_history
from ..session.interaction import Key
from ..session.tool import Action, Shown, Tool
from ..session.torque_history import SPAN, TorqueHistory


class TorquePlot(Tool):
    """The key p.

    Args:
        shown: where it works.

    Attributes:
        history: the torques.
    """

    order: ClassVar[int] = 15
    keys: ClassVar[Mapping[str, Key]] = {"p": Key("plot", "torques of the selected joint")}

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror, clock = shown.mirror, shown.clock
        self.area = "Torques" if shown.world.joints.names else ""
        # Live sources receive packets between frames; otherwise the clock provides samples.
        kept = SPAN + live_history.SPAN if clock.is_live and clock.can_go_back else SPAN
        routes = mirror.routes if mirror.is_live else ()
        self.history = TorqueHistory(shown.world, routes, kept)
        if mirror.is_live:
            mirror.listen(self._hear, to_all=True)
        self._plots: TorquePlots | None = None

    def actions(self) -> Mapping[str, Action]:
        """See `Tool`."""
        return {"plot": self._toggle}

    def _toggle(self) -> str:
        self.shows_area = not self.shows_area
        return "" if self.area else "no joint to plot"

    @property
    def active(self) -> Collection[str]:
        """See `Tool`."""
        return ["plot"] if self.shows_area else []

    @property
    def watches_closely(self) -> bool:
        """See `Tool`: while something is plotted."""
        return bool(self.area and self.shows_area)

    def watch(self) -> None:
        """Adds the torques of a new state."""
        self.history.add(self.shown.data)

    def _hear(self, source: str, packets: Packets) -> None:
        now = self.shown.mirror.sources[source].now()
        self.history.add_packets(self.shown.data, source, packets, now)

    def build_area(self, ui: Widgets) -> None:
        """See `Tool`."""
        shown, clock = self.shown, self.shown.clock
        if self._plots is None:
            self._plots = TorquePlots(shown.world, ui.points, ui.interval)
        self.history.until = clock.time if clock.is_past else None
        joint = self._plots.build(ui, self.history, shown.joint)
        if joint != shown.joint:
            shown.select(joint)
