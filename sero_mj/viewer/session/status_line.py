"""The text of the status line (sources, time and frame rate), and messages to the user."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from ...data.receive.report import error_text, report
from ...data.receive.source import Source
from ..decor.status import SHOWN_FOR
from .clock import Clock, time_text

Mood = Literal["good", "quiet", "bad", "plain", "dim", "title"]
Piece = tuple[str, Mood]


class Message(NamedTuple):
    """A message to the user, which is shown up to a time `until` of `time.monotonic` in seconds."""

    text: str = ""
    is_bad: bool = False
    until: float = float("-inf")

    @property
    def is_shown(self) -> bool:
        return time.monotonic() < self.until

    @property
    def piece(self) -> Piece:
        return self.text, "bad" if self.is_bad else "plain"


_MIN_OFFSET = 0.1  # s; smaller clock offsets may be network delays
_MIN_LOSS = 0.0005  # minimum fraction of lost packets that is shown in percent
_SLOW = 0.85  # fraction of the selected speed below which the actual speed is shown


def source_text(found: dict[str, Any], *, is_live: bool) -> Piece:
    """Returns the status text for the `report` of a source, and the mood (color) of the text."""
    name = found["source"]
    if not is_live:
        return str(found["about"]), "plain"
    if found["age"] is None:
        malformed = f", {found['malformed']} not applied" if found["malformed"] else ""
        return f"{name}: no data yet{malformed}", "bad" if malformed else "quiet"
    fault_age = found["fault_age"]
    is_faulty = fault_age is not None and fault_age < SHOWN_FOR
    if not found["receiving"]:
        what = "no valid packet" if is_faulty else "no packet"
        return f"{name}: {what} for {found['age']:.1f} s{_loss(found)}", "bad"
    text = f"{name}: {found['rate']:.0f}/s, {1e3 * found['age']:.0f} ms old{_loss(found)}"
    if found["clock"] is not None and abs(found["clock"]) > _MIN_OFFSET:
        side = "slow" if found["clock"] > 0.0 else "fast"
        text += f", its clock is {abs(found['clock']):.1f} s {side}"
    return text, "bad" if is_faulty else "good"


def _loss(found: dict[str, Any]) -> str:
    lost = found["lost"] + found["dropped"]
    text = ""
    if lost:
        share = lost / max(found["received"] + lost, 1)
        text = f", {lost} lost" if share < _MIN_LOSS else f", {100 * share:.1f} % lost"
    return text + (f", {found['malformed']} not applied" if found["malformed"] else "")


def clock_text(clock: Clock) -> Piece:
    """Returns the time, speed and state of a clock as text, and the mood (color) of the text."""
    if clock.is_live:
        ago = (clock.end or 0.0) - clock.time
        when = f"{time_text(ago)} ago" if clock.is_past else ""
        if clock.is_paused:
            return f"PAUSED  {when}".rstrip(), "bad"
        return (
            (f"NOT LIVE  {when}  x{clock.speed:g}", "quiet") if clock.is_past else ("live", "plain")
        )
    if not clock.is_playing:
        text = time_text(clock.time)
        return (f"{text}  PAUSED", "bad") if clock.is_paused else (text, "plain")
    end = f" / {time_text(clock.end)}" if clock.end is not None else ""
    text = f"{time_text(clock.time)}{end}  x{clock.speed:g}"
    if clock.real_speed < _SLOW * clock.speed:
        text += f" (actual {clock.real_speed:.2g})"
    if clock.is_at_end:
        return f"{text}  end", "quiet"
    return (f"{text}  PAUSED", "bad") if clock.is_paused else (text, "plain")


def status_pieces(sources: Iterable[Source], clock: Clock, frame_rate: float) -> list[Piece]:
    """Returns all parts of the status line, with the most important part first."""
    pieces = [clock_text(clock)]
    for source in sources:
        if error := error_text(source):
            pieces.append((f"{source.name}: {error}", "bad"))
        else:
            pieces.append(source_text(report(source), is_live=source.is_live))
    pieces.append((f"{frame_rate:.0f} frames/s", "plain"))
    return pieces
