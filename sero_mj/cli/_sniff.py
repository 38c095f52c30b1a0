"""`sero-mj structure --sniff PORT`: what arrives, and which layouts would fit it."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ._layout_table import make_console

if TYPE_CHECKING:
    from rich.console import RenderableType

    from ..receive.sniffer import Guess, Sniffer, Stream
    from ..receive.structure import Structure

_REFRESH = 0.25  # s between two pictures of a terminal
_TELL_EVERY = 2.0  # s between two lines about a stream where there is no terminal
_FIRST_NUMBERS = 4  # of an event


def sniff(options: argparse.Namespace, layout: Structure | None) -> int:
    """Listens until the time is over, the packets have come, or Ctrl-C; returns 0."""
    from ..receive.sniffer import Sniffer

    host, interface = options.host or "127.0.0.1", options.interface or ""
    with Sniffer(host, options.sniff, interface) as sniffer:
        place = f"UDP {host}:{sniffer.port}"
        begin = time.monotonic()
        with (
            contextlib.suppress(KeyboardInterrupt),
            _shown(options, sniffer, layout, place) as show,
        ):
            _listen(sniffer, options, show)
        seconds = time.monotonic() - begin
        if options.json:
            print(json.dumps(_as_json(sniffer, layout, seconds), indent=2))
        else:
            make_console().print(_picture(sniffer, layout, _summary(place, sniffer, seconds)))
    return 0


def _listen(sniffer: Sniffer, options: argparse.Namespace, show: Callable[[], None]) -> None:
    end = np.inf if options.duration is None else time.monotonic() + options.duration
    most = options.count or 10**15
    shown = -np.inf
    while (now := time.monotonic()) < end and sniffer.received < most:
        sniffer.receive(min(_REFRESH, end - now), most - sniffer.received)
        if time.monotonic() - shown >= _REFRESH:
            shown = time.monotonic()
            show()
    show()


@contextlib.contextmanager
def _shown(
    options: argparse.Namespace, sniffer: Sniffer, layout: Structure | None, place: str
) -> Iterator[Callable[[], None]]:
    """A function that shows the current state."""
    if options.json:
        yield lambda: None
    elif not sys.stdout.isatty():
        print(f"listening on {place}; Ctrl-C ends", flush=True)
        yield _Lines(sniffer, layout).tell
    else:
        from rich.live import Live

        title = f"listening on {place}; Ctrl-C ends"
        with Live(console=make_console(), auto_refresh=False, transient=True) as live:
            yield lambda: live.update(_picture(sniffer, layout, title), refresh=True)


class _Lines:
    """Tells of every stream when it begins, and every two seconds."""

    def __init__(self, sniffer: Sniffer, layout: Structure | None) -> None:
        self._sniffer, self._layout = sniffer, layout
        self._told: dict[tuple[bytes, int], tuple[float, int]] = {}

    def tell(self) -> None:
        now = time.monotonic()
        for key, stream in self._sniffer.streams.items():
            when, count = self._told.get(key, (-np.inf, 0))
            if stream.count > count and now - when >= _TELL_EVERY:
                self._told[key] = now, stream.count
                words = _values(stream, self._layout)
                print(f"{_head(stream)}{f': {words}' if words else ''}", flush=True)


def _summary(place: str, sniffer: Sniffer, seconds: float) -> str:
    count = len(sniffer.streams)
    if not count:
        return f"nothing came to {place} within {seconds:.1f} s"
    return (
        f"{sniffer.received} packets in {seconds:.1f} s on {place}, of {count} "
        f"sender{'s and sizes' if count > 1 else ''}"
        + (f"; {sniffer.untold} packets of further ones" if sniffer.untold else "")
    )


def _head(stream: Stream) -> str:
    host, port = stream.sender
    rate = f", {stream.timing.rate:.5g}/s" if stream.timing.rate else ""
    return f"{host}:{port} sends {stream.size} bytes, {stream.count} times{rate}"


def _picture(sniffer: Sniffer, layout: Structure | None, title: str) -> RenderableType:
    """All streams, for a terminal or a file."""
    from rich.console import Group
    from rich.text import Text

    lines = [Text(title, style="bold")]
    for stream in sniffer.streams.values():
        lines.append(Text(_head(stream)))
        if words := stream.description:
            lines.append(Text(f"    {words}", style="yellow"))
        if words := _values(stream, layout):
            lines.append(Text(f"    {words}", style="green" if _fits(stream, layout) else "red"))
        if not _fits(stream, layout):
            lines += [Text(f"    {line}") for line in _guess_lines(stream)]
    return Group(*lines)


def _fits(stream: Stream, layout: Structure | None) -> bool:
    return (
        layout is not None
        and stream.size == layout.size
        and not layout.find_wrong_constants(stream.rows[-1:])[0]
    )


def _values(stream: Stream, layout: Structure | None) -> str:
    """The last packet by the structure that was given, or why it does not fit."""
    if layout is None:
        return ""
    if stream.size != layout.size:
        return f"{stream.size} bytes; '{layout.text}' has {layout.size}"
    if wrong := layout.describe_wrong_constant(stream.rows[-1:]):
        return wrong
    values = layout.decode(stream.last[-1])
    return "  ".join(f"{event} {_first(array)}" for event, array in values.items())


def _first(array: Any) -> str:
    numbers = [f"{number:.4g}" for number in array.ravel()[:_FIRST_NUMBERS]]
    return " ".join(numbers) + (" ..." if array.size > _FIRST_NUMBERS else "")


def _guess_lines(stream: Stream) -> list[str]:
    if not stream.is_binary:
        return []  # its description says what it is
    guesses = stream.guesses()
    if not guesses:
        return ["would fit nothing that is made of numbers of 4 or 8 bytes"]
    width = min(max(len(guess.structure) for guess in guesses), 40)
    return [
        f"{'would fit ' if i == 0 else '':10}{guess.structure:{width}}  {_about(guess)}"
        for i, guess in enumerate(guesses)
    ]


def _about(guess: Guess) -> str:
    likely = f"{guess.plausible:.0%} plausible"
    options = "" if guess.is_double else ", double = false"
    options += "" if guess.column_major else ", column_major = false"
    return f"{guess.about}; {likely}{options}"


def _as_json(sniffer: Sniffer, layout: Structure | None, seconds: float) -> dict[str, Any]:
    streams = []
    for stream in sniffer.streams.values():
        found: dict[str, Any] = {
            "sender": "{}:{}".format(*stream.sender),
            "size": stream.size,
            "packets": stream.count,
            "rate": stream.timing.rate,
            "jitter": stream.timing.jitter,
            "guesses": [asdict(guess) for guess in stream.guesses()],
        }
        if layout is not None and _fits(stream, layout):
            values = layout.decode(stream.last[-1])
            found["values"] = {}
            for event, array in values.items():
                numbers = array.astype(object)
                numbers[~np.isfinite(array)] = None  # JSON has no NaN and no infinity
                found["values"][event] = numbers.tolist()
        streams.append(found)
    return {"seconds": seconds, "packets": sniffer.received, "streams": streams}
