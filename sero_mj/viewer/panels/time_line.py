"""The time line: pause, start, steps, speed, and where in time what is shown is."""

from __future__ import annotations

from collections.abc import Sequence

from ..session.clock import SPEEDS, Clock, Tick, time_text
from ..session.status_line import Mood
from ..session.widgets import Widgets

# Widths, of the text's height.
_PAUSE, _SPEED = 3.4, 4.6
_NARROW = 30.0  # in what is narrower there is no choice of the speed


def build_time_line(ui: Widgets, clock: Clock, ticks: Sequence[Tick]) -> None:
    """Builds the time line in one line."""
    is_wide = ui.room()[0] >= _NARROW
    stands = clock.is_paused or clock.is_at_end
    if ui.button(f"{'play' if stands else 'pause'}###pause", _PAUSE):
        clock.pause()
    for label, tip, act in (
        ("|<", "to the start", clock.reset),
        ("<", "a step back", lambda: clock.step(-1)),
        (">", "a step on", clock.step),
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
            (tick.time, "title" if tick.is_mark else "bad", _told(clock, tick)) for tick in ticks
        ]
        text = _text(clock, clock.end)
        moved, wanted = ui.slide("##time", clock.time, clock.begin, clock.end, text, marked)
        if moved:
            clock.seek(wanted)
            # Who goes to what happened wants to see it, as by the keys for that.
            clock.is_paused |= any(wanted == tick.time for tick in ticks)


def _told(clock: Clock, tick: Tick) -> str:
    return tick.text if clock.is_live else f"{time_text(tick.time)}: {tick.text}"


def _text(clock: Clock, end: float) -> str:
    if not clock.is_live:
        return f"{time_text(clock.time)} / {time_text(end)}"
    return f"{time_text(end - clock.time)} ago; End is live" if clock.is_past else "live"
