"""What all sources share: packets, counters, and the interface by which they are used.

A source reads off the render thread. What is malformed is counted and never handed on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..declaration import kind_of
from ..errors import DeclarationError, PluginError, Problem
from ..plugins import SOURCES, load_plugin, plugins
from ._timing import Timing
from .structure import Structure

Array = NDArray[np.float64]

# Events of every source that come without a packet, and change when none comes: 1 while packets
# come, else 0; and 1 in a tick in which new ones were applied, else 0.
SIGNALS: dict[str, tuple[int, ...]] = {"receiving": (1,), "receive_trigger": (1,)}
QUIET_AFTER = 0.5  # s without a packet until a source counts as silent


@dataclass(frozen=True, eq=False)
class Packet:
    """One good packet.

    Attributes:
        values: event name to its array, float64, in the source's shapes. Finite, but for the
            events in which NaN is allowed; matrices are rigid frames.
        arrival: when it arrived, on the clock of `Source.now`, s.
        number: 1 for the first good packet of the source.
    """

    values: Mapping[str, Array]
    arrival: float
    number: int


@dataclass(frozen=True, eq=False)
class Packets:
    """Good packets, one after the other.

    Attributes:
        values: event name to its arrays, (n, ...), float64, n >= 1.
        arrivals: when they arrived, (n,), s, on the clock of `Source.now`.
        number: of the last one.
    """

    values: Mapping[str, Array]
    arrivals: Array
    number: int

    def __len__(self) -> int:
        return len(self.arrivals)

    @cached_property
    def last(self) -> Packet:
        """The newest one."""
        values = {event: array[-1] for event, array in self.values.items()}
        return Packet(values, float(self.arrivals[-1]), self.number)


@dataclass
class Counters:
    """What came in since the source was opened.

    Attributes:
        received: packets of any kind.
        wrong_size: malformed ones: not as long as the structure says.
        wrong_constant: malformed ones: another number where the structure demands one.
        not_finite: malformed ones: with NaN or infinity where these are not allowed.
        not_frames: malformed ones: with a matrix that is not a rigid frame.
        foreign: from others than the `sender` that was named; not looked at.
        lost: sequence numbers that never came.
        late: came after one with a higher number; applied only when none may be lost.
        duplicates: came before with the same number; not applied.
        restarts: how often the sender restarted: with its numbers, or from another port.
        torn: reads of shared memory given up because the writer was always in between.
        senders: how many send at once, in turns, within the last 2 s.
        blanked: good ones with NaN or infinity where these are allowed.
        superseded: good ones that a later packet replaced before they were used, as intended
            when a robot sends faster than pictures are made.
        dropped: packets that the kernel threw away because its buffer was full.
        last_fault: what was wrong with the last malformed packet.
        last_size: bytes of the last packet of a wrong size.
        last_fault_time: when the last malformed packet came, on the clock of `Source.now`.
    """

    received: int = 0
    wrong_size: int = 0
    wrong_constant: int = 0
    not_finite: int = 0
    not_frames: int = 0
    foreign: int = 0
    lost: int = 0
    late: int = 0
    duplicates: int = 0
    restarts: int = 0
    torn: int = 0
    senders: int = 0
    blanked: int = 0
    superseded: int = 0
    dropped: int = 0
    last_fault: str = ""
    last_size: int = 0
    last_fault_time: float = 0.0

    @property
    def malformed(self) -> int:
        """Packets that were counted and not applied."""
        return self.wrong_size + self.wrong_constant + self.not_finite + self.not_frames


# Gets packets as they came: rows (n, bytes), lengths (n,) bytes, arrivals (n,) s.
Tap = Callable[[NDArray[np.uint8], NDArray[np.intp], Array], None]


class Source(Protocol):
    """Where packets come from; `Receiver` is the base of all that sero-mj has.

    A source of another package is a subclass of `Receiver`, too, and hands its packets to
    `Receiver.accept`.
    """

    @property
    def counters(self) -> Counters:
        """What came in since it was opened."""

    @property
    def timing(self) -> Timing:
        """Rate, jitter and delay since it was opened."""

    @property
    def name(self) -> str:
        """The source's name in routes."""

    @property
    def kind(self) -> str:
        """The name of its kind in files."""

    @property
    def about(self) -> str:
        """Kind and address, as shown to the user."""

    @property
    def trouble(self) -> str:
        """Why no packets arrive, as shown to the user; empty when unknown."""

    @property
    def error(self) -> Exception | None:
        """Why it cannot go on, where it has failed since it was opened; else None."""

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        """Event name to its shape: (n,) values, (n, 3) vectors, (n, 4, 4) matrices."""

    @property
    def layout(self) -> Structure:
        """The decoder."""

    @property
    def size(self) -> int:
        """Bytes of a packet."""

    @property
    def sequence(self) -> str:
        """Event that numbers the packets; empty for none."""

    @property
    def time(self) -> str:
        """Event that says when a packet was sent; empty for none."""

    @property
    def time_scale(self) -> float:
        """Seconds per unit of `time`."""

    @property
    def only_latest_packet(self) -> bool:
        """Whether the newest packet wins; else every packet is handed on in order."""

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """What a packet says of the robot's controller and of the quality of the link to it.

        Args:
            values: event name to its array, of one packet.

        Returns:
            state and quality, as numbers that the kind of source defines; -1 where it says nothing.
        """

    def decoding_fields(self) -> dict[str, Any]:
        """The fields of which a replay makes a decoder, as JSON's types; for recordings."""

    def decode(self, packet: bytes) -> Mapping[str, Array] | None:
        """Decodes one packet by itself; None for one that would not be applied. Counts nothing."""

    def record_to(self, tap: Tap | None) -> None:
        """Hands all packets, the malformed too, to `tap` as they come; None ends that."""

    def allow_nan(self, events: Collection[str]) -> None:
        """Lets NaN and infinity mean `no data` in these events, and in no others.

        There they are handed on as NaN, a matrix as a whole, and the rest of the packet is applied;
        anywhere else they make it malformed. Raises UnknownName.
        """

    def open(self) -> None:
        """Starts receiving; raises SourceError."""

    def close(self) -> None:
        """Stops receiving and frees what was opened."""

    def latest(self) -> Packet | None:
        """Returns the newest good packet, or None when there was none yet."""

    def take(self) -> Packets | None:
        """Returns the good packets since the last call, or None when there is none.

        Only the newest one, unless the source loses none.
        """

    def wait(self, timeout: float) -> bool:
        """Waits until a good packet has come; returns whether one has."""

    @property
    def is_live(self) -> bool:
        """Whether packets arrive in real time; those of a recording come as `advance_to` asks."""

    @property
    def end(self) -> float | None:
        """Until when there are packets, s on the clock of `advance_to`; None where nothing ends."""

    @property
    def step(self) -> float | None:
        """Time step of a simulation, whose `advance_to` takes long, s; None for all others."""

    @property
    def receiving(self) -> bool:
        """Whether a good packet came within the last half second."""

    @property
    def receive_trigger(self) -> int:
        """How many good packets have come: it changes with every one."""

    def now(self) -> float:
        """The time on the clock of arrivals, s: that of `time.monotonic`, or of a recording."""

    def advance_to(self, time: float) -> None:
        """Advances to a time, s, where the source does not follow the real time."""

    def on_receive(self, callback: Callable[[], None]) -> None:
        """Calls back, on the source's thread, whenever good packets have come."""


def age(packet: Packet | None, now: float) -> float:
    """Seconds since the packet arrived, `now` being `Source.now()`.

    Infinite without a packet, 0 when it came after `now`.
    """
    return float("inf") if packet is None else max(now - packet.arrival, 0.0)


def make_source(name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Builds a source from a scene's table; a source object is returned as it is.

    Args:
        name: the source's name in routes.
        declared: its fields, with `kind`.

    Raises:
        DeclarationError: no such kind, one that cannot be loaded, or wrong fields.
    """
    if not isinstance(declared, Mapping):
        if hasattr(declared, "events"):
            return declared
        message = f"found {declared!r}; expected a table with kind, or a source"
        raise DeclarationError([Problem("", message)])
    if "name" in declared:
        raise DeclarationError([Problem("name", "belongs in the header; leave it out")])
    kind = kind_of(declared, plugins(SOURCES))
    fields = {key: value for key, value in declared.items() if key != "kind"}
    try:
        source: Source = load_plugin(SOURCES, kind)(**fields, name=name)
    except PluginError as error:
        raise DeclarationError([Problem("kind", str(error))]) from error
    return source
