"""`sero-mj structure --sniff PORT`: receives packets of any kind and prints what they may be."""

from __future__ import annotations

import contextlib
import errno
import select
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ...base.errors import SourceError
from ...cli.arguments import print_json
from ...cli.terminal import make_console
from ...data.receive.language import MAX_PACKET_BYTES
from ...data.receive.structure import Rows, Structure
from ...data.receive.tracking import Timing
from ...data.receive.udp_socket import Batch, Datagrams, open_socket, unpack_address
from .guess import Guess, describe_bytes, guess_layouts, is_text

if TYPE_CHECKING:
    from rich.console import RenderableType

    from ...cli.structure import StructureOptions

_PACKETS_FOR_GUESSES = 16  # maximum number of packets per stream
_MAX_STREAMS = 100
_REFRESH = 0.25  # time between updates of a terminal, s
_PRINT_INTERVAL = 2.0  # time between lines about a stream if the output is not a terminal, s
_SHOWN_NUMBERS = 4  # maximum number of printed values of an event


@dataclass
class Stream:
    """The packets of one size from one sender.

    Attributes:
        last: latest packets, which are used for guesses.
    """

    sender: tuple[str, int]
    size: int
    count: int = 0
    timing: Timing = field(default_factory=Timing)
    last: deque[bytes] = field(default_factory=lambda: deque(maxlen=_PACKETS_FOR_GUESSES))

    @property
    def rows(self) -> Rows:
        rows = np.frombuffer(b"".join(self.last), np.uint8)
        return rows.reshape(len(self.last), self.size)

    def guesses(self) -> list[Guess]:
        return guess_layouts(self.rows) if self.is_binary else []

    @property
    def is_binary(self) -> bool:
        return self.size > 0 and not is_text(self.last[-1])

    @property
    def description(self) -> str:
        """Description of packets that are text or only zeros; empty for other packets."""
        return describe_bytes(self.rows)

    def decode(self, guess: Guess) -> dict[str, Any]:
        layout = Structure(
            guess.structure, is_double=guess.is_double, column_major=guess.column_major
        )
        return dict(layout.decode(self.last[-1]))


class Sniffer:
    """A receiver of UDP packets of any size from any sender; raises SourceError.

    Args:
        host: local address, like `host` of `UdpReceiver`.
        port: port to listen on; 0 for a port that the system chooses.
        interface: network interface, like `interface` of `UdpReceiver`.

    Attributes:
        streams: streams by sender and packet size, in the order of their first packets.
        ignored: number of packets of streams beyond the first hundred.
    """

    def __init__(self, host: str, port: int, interface: str = "") -> None:
        try:
            self._socket = open_socket("sniff", host, port, interface, 0)
        except SourceError as error:
            if getattr(error.__cause__, "errno", None) != errno.EADDRINUSE:
                raise
            raise SourceError(
                "sniff",
                f"UDP port {port} on {host} is in use. Close the program that listens on it, "
                "such as a viewer, before using --sniff",
            ) from error
        self._datagrams = Datagrams(self._socket, MAX_PACKET_BYTES)
        self.port = int(self._socket.getsockname()[1])
        self.streams: dict[tuple[bytes, int], Stream] = {}
        self.received = self.ignored = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._socket.close()

    def receive(self, timeout: float, limit: int) -> int:
        """Receives up to `limit` packets within `timeout` s; returns their number."""
        before = self.received
        if select.select([self._socket], [], [], timeout)[0]:
            while self.received - before < limit and (batch := self._datagrams.receive()):
                self._add(batch, limit - (self.received - before))
                if len(batch) < 8:  # the sender is not so fast that more packets are waiting
                    break
        return self.received - before

    def _add(self, batch: Batch, limit: int) -> None:
        count = min(len(batch), limit)
        self.received += count
        lengths = np.minimum(batch.lengths[:count], MAX_PACKET_BYTES)
        keys = [
            (sender.tobytes(), size)
            for sender, size in zip(batch.senders[:count], lengths.tolist(), strict=True)
        ]
        for key in dict.fromkeys(keys):
            places = np.array([i for i, other in enumerate(keys) if other == key])
            stream = self.streams.get(key)
            if stream is None:
                if len(self.streams) >= _MAX_STREAMS:
                    self.ignored += len(places)
                    continue
                stream = self.streams[key] = Stream(unpack_address(key[0]), key[1])
            stream.count += len(places)
            stream.timing.add(batch.arrivals[places])
            stream.last.extend(
                batch.rows[i, : key[1]].tobytes() for i in places[-_PACKETS_FOR_GUESSES:].tolist()
            )


def sniff(port: int, options: StructureOptions, layout: Structure | None) -> int:
    """Prints the packets that arrive at a port until Ctrl+C, `--duration` or `--count`; returns 0.

    Args:
        layout: packet layout; None to print only guesses.
    """
    host, interface = options.host or "127.0.0.1", options.interface or ""
    with Sniffer(host, port, interface) as sniffer:
        place = f"UDP {host}:{sniffer.port}"
        begin = time.monotonic()
        with (
            contextlib.suppress(KeyboardInterrupt),
            _display(options, sniffer, layout, place) as update,
        ):
            _listen(sniffer, options, update)
        seconds = time.monotonic() - begin
        if options.as_json:
            print_json(_as_json(sniffer, layout, seconds))
        else:
            _console().print(_overview(sniffer, layout, _summary(place, sniffer, seconds)))
    return 0


def _console() -> Any:
    return make_console(width=None if sys.stdout.isatty() else 250)


def _listen(sniffer: Sniffer, options: StructureOptions, update: Callable[[], None]) -> None:
    end = np.inf if options.duration is None else time.monotonic() + options.duration
    limit = options.count or 10**15
    updated = -np.inf
    while (now := time.monotonic()) < end and sniffer.received < limit:
        sniffer.receive(min(_REFRESH, end - now), limit - sniffer.received)
        if time.monotonic() - updated >= _REFRESH:
            updated = time.monotonic()
            update()
    update()


@contextlib.contextmanager
def _display(
    options: StructureOptions, sniffer: Sniffer, layout: Structure | None, place: str
) -> Iterator[Callable[[], None]]:
    title = f"listening on {place}; press Ctrl+C to stop"
    if options.as_json:
        yield lambda: None
    elif not sys.stdout.isatty():
        print(title, flush=True)
        yield _line_printer(sniffer, layout)
    else:
        from rich.live import Live

        with Live(console=_console(), auto_refresh=False, transient=True) as live:
            yield lambda: live.update(_overview(sniffer, layout, title), refresh=True)


def _line_printer(sniffer: Sniffer, layout: Structure | None) -> Callable[[], None]:
    printed: dict[tuple[bytes, int], tuple[float, int]] = {}

    def update() -> None:
        now = time.monotonic()
        for key, stream in sniffer.streams.items():
            when, count = printed.get(key, (-np.inf, 0))
            if stream.count > count and now - when >= _PRINT_INTERVAL:
                printed[key] = now, stream.count
                values = _values(stream, layout)
                print(f"{_head(stream)}{f': {values}' if values else ''}", flush=True)

    return update


def _summary(place: str, sniffer: Sniffer, seconds: float) -> str:
    count = len(sniffer.streams)
    if not count:
        return f"no packets received on {place} in {seconds:.1f} s"
    ignored = f"; ignored {sniffer.ignored} packets of other senders" if sniffer.ignored else ""
    streams = f"{count} different senders or sizes" if count > 1 else "one sender"
    return f"{sniffer.received} packets in {seconds:.1f} s on {place} from {streams}{ignored}"


def _head(stream: Stream) -> str:
    host, port = stream.sender
    rate = f", {stream.timing.rate:.5g}/s" if stream.timing.rate else ""
    return f"{host}:{port} sends {stream.size} bytes, {stream.count} times{rate}"


def _overview(sniffer: Sniffer, layout: Structure | None, title: str) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    lines = [Text(title, style="bold")]
    for stream in sniffer.streams.values():
        fits = layout is not None and _fits(stream, layout)
        lines.append(Text(_head(stream)))
        if words := stream.description:
            lines.append(Text(f"    {words}", style="yellow"))
        if words := _values(stream, layout):
            lines.append(Text(f"    {words}", style="green" if fits else "red"))
        if not fits:
            lines += [Text(f"    {line}") for line in _guess_lines(stream)]
    return Group(*lines)


def _fits(stream: Stream, layout: Structure) -> bool:
    return (
        stream.size == layout.size
        and not layout.find_wrong_constants(stream.rows[-1:])[0]
        and not layout.find_wrong_checksums(stream.rows[-1:])[0]
    )


def _values(stream: Stream, layout: Structure | None) -> str:
    if layout is None:
        return ""
    if stream.size != layout.size:
        hint = layout.explain_size(stream.size)
        return f"{stream.size} bytes; '{layout.text}' has {layout.size}{hint and f'; {hint}'}"
    row = stream.rows[-1:]
    if wrong := layout.describe_wrong_constant(row) or layout.describe_wrong_checksum(row):
        return wrong
    return _numbers(layout.decode(stream.last[-1]))


def _numbers(values: Mapping[str, Any]) -> str:
    texts = []
    for event, array in values.items():
        numbers = [f"{number:.4g}" for number in array.ravel()[:_SHOWN_NUMBERS]]
        more = " ..." if array.size > _SHOWN_NUMBERS else ""
        texts.append(f"{event} {' '.join(numbers)}{more}")
    return "  ".join(texts)


def _guess_lines(stream: Stream) -> list[str]:
    if not stream.is_binary:
        return []
    guesses = stream.guesses()
    if not guesses:
        return ["no structure of numbers, counters, flags and padding fits"]
    width = min(max(len(guess.structure) for guess in guesses), 40)
    lines = []
    for i, guess in enumerate(guesses):
        begin = "would fit " if i == 0 else ""
        options = "" if guess.is_double else ", double = false"
        options += "" if guess.column_major else ", column_major = false"
        about = f"{guess.about}; {guess.plausible:.0%} plausible{options}"
        lines.append(f"{begin:10}{guess.structure:{width}}  {about}")
        lines.append(f"{'':12}{_numbers(stream.decode(guess))}")
    return lines


def _as_json(sniffer: Sniffer, layout: Structure | None, seconds: float) -> dict[str, Any]:
    streams = []
    for stream in sniffer.streams.values():
        found: dict[str, Any] = {
            "sender": "{}:{}".format(*stream.sender),
            "size": stream.size,
            "packets": stream.count,
            "rate": stream.timing.rate,
            "jitter": stream.timing.jitter,
            "guesses": [
                asdict(guess)
                | {"values": {k: each.tolist() for k, each in stream.decode(guess).items()}}
                for guess in stream.guesses()
            ],
        }
        if layout is not None and _fits(stream, layout):
            values = layout.decode(stream.last[-1])
            found["values"] = {event: array.tolist() for event, array in values.items()}
        streams.append(found)
    return {"seconds": seconds, "packets": sniffer.received, "streams": streams}
