"""The status line, the timeline, and the panel section that lists sources and their counters."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from typing import Any

from ...data.receive.report import describe, error_text, report
from ...data.receive.source import Source
from ..session.clock import SPEEDS, Clock, Tick, time_text
from ..session.status_line import Mood, Piece, clock_text, source_text
from ..session.widgets import Widgets

_GAP = 1.4  # gap between texts, in text heights
_READABLE = 0.25  # minimum time for which a counter is shown, s


def build_status_line(ui: Widgets, pieces: Sequence[Piece], hint: str) -> None:
    """Builds the status line from the texts that fit into it, the most important first."""
    width, _ = ui.room()
    end = 0.0  # right edge of the last text
    for words, mood in pieces:
        start, wide = end + (_GAP if end else 0.0), ui.wide(words)
        if start + wide > width:
            break
        if end:
            ui.same_line(gap=_GAP)
        ui.text(words, mood)
        end = start + wide
    left = width - ui.wide(hint)
    if end and end + _GAP <= left:
        ui.same_line(gap=left - end)
        ui.text(hint, "dim")


class SourcesPanel:
    """The section of a panel that shows the clock, and errors and counters of all sources."""

    def __init__(self) -> None:
        self._reports: dict[str, tuple[float, dict[str, Any]]] = {}  # time and contents of reports

    def build(
        self, ui: Widgets, clock: Clock, sources: Collection[Source], *, is_open: bool
    ) -> None:
        if not ui.header("Sources", is_open=is_open):
            return
        ui.text(*clock_text(clock))
        for source in sources:
            self._source(ui, source)
        if not sources:
            ui.text("no sources: the pose is declared or set by a program", "dim")

    def _source(self, ui: Widgets, source: Source) -> None:
        if error := error_text(source):
            ui.text(f"{source.name}: {error}", "bad")
            if not source.is_live:
                return
        found = self._report(source)
        ui.text(*source_text(found, is_live=source.is_live))
        if found["trouble"]:
            ui.text(f"  {found['trouble']}", "bad")
        if source.is_live and ui.tree(f"counters of {source.name}"):
            for what, count, meaning in describe(found):
                ui.text(f"{what}: {count or meaning}")
                if meaning:
                    ui.tip(meaning)
            ui.end_tree()

    def _report(self, source: Source) -> dict[str, Any]:
        now = time.monotonic()
        when, found = self._reports.get(source.name, (float("-inf"), {}))
        if now - when >= _READABLE:
            found = report(source)
            self._reports[source.name] = now, found
        return found


# Widths in text heights.
_PAUSE, _SPEED = 3.4, 4.6
_NARROW = 30.0  # minimum width of a timeline with a list of speeds


def build_timeline(ui: Widgets, clock: Clock, ticks: Sequence[Tick]) -> None:
    """Builds the timeline of a clock with marks (`ticks`), and its buttons, in one line."""
    is_wide = ui.room()[0] >= _NARROW
    is_still = clock.is_paused or clock.is_at_end
    if ui.button(f"{'play' if is_still else 'pause'}###pause", _PAUSE):
        clock.pause()
    for label, tip, act in (
        ("|<", "go to the start", clock.reset),
        ("<", "step back", lambda: clock.step(-1)),
        (">", "step forward", clock.step),
    ):
        ui.same_line()
        if ui.button(label):
            act()
        ui.tip(tip)
    if is_wide:
        ui.same_line()
        ui.width(_SPEED)
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - clock.speed))
        changed, chosen = ui.choose("##speed", nearest, [f"x {speed:g}" for speed in SPEEDS])
        if changed:
            clock.faster(chosen - nearest)
    if clock.end:
        ui.same_line()
        ui.width(0.0)
        marked: list[tuple[float, Mood, str]] = [
            (tick.time, "title" if tick.is_mark else "bad", _tick_text(clock, tick))
            for tick in ticks
        ]
        text = _text(clock, clock.end)
        moved, wanted = ui.slide("##time", clock.time, clock.begin, clock.end, text, marked)
        if moved:
            clock.seek(wanted)
            # A click on a mark pauses the clock at this mark, as the keys for marks do.
            clock.is_paused |= any(wanted == tick.time for tick in ticks)


def _tick_text(clock: Clock, tick: Tick) -> str:
    return tick.text if clock.is_live else f"{time_text(tick.time)}: {tick.text}"


def _text(clock: Clock, end: float) -> str:
    if not clock.is_live:
        return f"{time_text(clock.time)} / {time_text(end)}"
    return f"{time_text(end - clock.time)} ago; End shows live data" if clock.is_past else "live"
