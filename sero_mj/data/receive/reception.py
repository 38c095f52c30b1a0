"""`Reception`: checks the packets of a source, counts them, and hands on the good ones."""

from __future__ import annotations

import logging
import threading
import time as clock
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress

import numpy as np
from pydantic import Field, PrivateAttr

from ...base.errors import SourceError, UnknownName
from ...base.frames import Array, Ints
from ...base.once import Once
from .intake import Counters, Intake, pad_packets
from .mailbox import Mailbox, Packet, Packets
from .packet_declaration import PacketDeclaration
from .receiving_thread import LONGEST, Disconnected
from .structure import Rows
from .tracking import Timing

log = logging.getLogger("sero_mj.data.receive.source")

QUIET_AFTER = 0.5  # s without a packet until a source counts as silent
_WARN_INTERVAL = 10.0  # s
_ERROR_SHOWN_FOR = 2 * LONGEST  # s after the last failure, if no packets arrive
# Receives raw packets: rows (n, bytes), lengths (n,) bytes, arrivals (n,) s.
Tap = Callable[[Rows, Ints, Array], object]


class Timeline:
    """When packets come, in real time by default; recordings and runs override all of it."""

    def now(self) -> float:
        """The time on the clock of arrivals, s: that of `time.monotonic`, or of a recording."""
        return clock.monotonic()

    @property
    def is_live(self) -> bool:
        """Whether packets arrive in real time; those of a recording follow `advance_to`."""
        return True

    @property
    def end(self) -> float | None:
        """Time of the last packet, s on the clock of `advance_to`; None for endless sources."""
        return None

    @property
    def begin(self) -> float:
        """Time of the first packet, s on the clock of `advance_to`."""
        return 0.0

    @property
    def newest(self) -> float | None:
        """Time of the newest packet, s, for endless sources with a visible past."""
        return None

    @property
    def step(self) -> float | None:
        """Time step of a simulation, whose `advance_to` is slow, s; None for all others."""
        return None

    def advance_to(self, time: float) -> None:
        """Advances to a time, s, if the source does not run in real time."""


class Reception(PacketDeclaration, Timeline):
    """Takes in packets of one structure; malformed ones are counted and never handed on.

    Attributes:
        name: the source's name in routes.
        only_latest_packet: the newest packet wins; when false every packet is handed on in order.
        debug_level: what is logged: 0 nothing, 1 faults, 2 restarts and loss too, 3 every batch.
    """

    name: str = "source"
    only_latest_packet: bool = True
    debug_level: int = Field(1, ge=0, le=3)

    _intake: Intake | None = PrivateAttr(None)
    _kept: Mailbox | None = PrivateAttr(None)
    _limits: Mapping[str, Array] = PrivateAttr(default_factory=dict)
    _callbacks: list[Callable[[], None]] = PrivateAttr(default_factory=list)
    _tap: Tap | None = PrivateAttr(None)
    _trouble: str = PrivateAttr("")
    _failure: SourceError | None = PrivateAttr(None)
    _failed_at: float = PrivateAttr(-np.inf)  # s, of `time.monotonic`
    _warned: float = PrivateAttr(-np.inf)
    _logged_failure: float = PrivateAttr(-np.inf)
    _is_new: Once = PrivateAttr(default_factory=Once)

    @property
    def intake(self) -> Intake:
        """Checks and counts the packets; recreated by every `open`."""
        if self._intake is None:
            self._intake = self._new_intake()
        return self._intake

    def _new_intake(self) -> Intake:
        return Intake(
            self.layout,
            sequence=self.sequence,
            time=self.time,
            time_scale=self.time_scale,
            lossless=not self.only_latest_packet,
            nan_allowed=self._nan_allowed,
            limits=self._limits,
            on_fault=self._warn,
        )

    @property
    def counters(self) -> Counters:
        """Counts of packets since it was opened."""
        return self.intake.counters

    @property
    def timing(self) -> Timing:
        """Rate, jitter and delay since it was opened."""
        return self.intake.timing

    @property
    def receiving(self) -> bool:
        """Whether a good packet arrived within the last half second."""
        last = self._mail.last_arrival
        return last is not None and self.now() - last < QUIET_AFTER

    @property
    def receive_trigger(self) -> int:
        """Number of good packets, which changes with every one."""
        return self._mail.number

    def allow_nan(self, events: Collection[str]) -> None:
        """Treats NaN and infinity as `no data` in these events, and in no others.

        They are passed on as NaN, a matrix as a whole, and the rest of the packet is applied
        (counted as `blanked`); anywhere else they make it malformed. Takes effect with the next
        packet.

        Raises:
            UnknownName: an event that the structure does not have.
        """
        for event in events:
            if event not in self.events:
                raise UnknownName("event", event, self.events)
        self._nan_allowed = frozenset(events)
        self.intake.nan_allowed = self._nan_allowed

    def limit(self, limits: Mapping[str, Array]) -> None:
        """Sets the largest magnitudes of numbers; a packet with a larger one is malformed.

        It is counted as `implausible`. Takes effect with the next packet.

        Args:
            limits: event name to the limit of each of its numbers, flat, (k,).
        """
        self._limits = dict(limits)
        self.intake.limits = self._limits

    def on_receive(self, callback: Callable[[], None]) -> None:
        """Registers a callback, on the source's thread, for the arrival of good packets.

        An exception in it becomes the source's `error`; reception continues.
        """
        self._callbacks.append(callback)

    def remove_callback(self, callback: Callable[[], None]) -> None:
        """Removes a callback of `on_receive`, if it is registered."""
        with suppress(ValueError):
            self._callbacks.remove(callback)

    def record_to(self, tap: Tap | None) -> None:
        """Passes all packets, malformed ones included, to `tap` as they arrive; None ends that."""
        self._tap = tap

    @property
    def closing(self) -> threading.Event:
        """Set while it is being closed, so that `accept` does not wait for room."""
        return self._mail.closing

    @property
    def _mail(self) -> Mailbox:
        if self._kept is None:
            self._kept = Mailbox(
                self._decode_rows,
                self._note_superseded,
                is_lossless=not self.only_latest_packet,
            )
        return self._kept

    def _decode_rows(self, rows: Rows) -> Mapping[str, Array]:
        return self.intake.decode(rows)

    def _note_superseded(self, count: int) -> None:
        self.counters.superseded += count

    def reset(self) -> None:
        """Discards all packets and counters, and applies a changed declaration."""
        self.__dict__.pop("layout", None)
        self._intake = self._new_intake()
        self._mail.is_lossless = not self.only_latest_packet
        self._mail.empty()
        self._trouble, self._failure, self._is_new = "", None, Once()
        self._warned = self._logged_failure = -np.inf

    def latest(self) -> Packet | None:
        """Returns the newest good packet, or None when there was none yet."""
        packets = self._mail.newest()
        return None if packets is None else packets.last

    def take(self) -> Packets | None:
        """Returns the good packets since the last call, or None when there is none.

        Only the newest one, unless `only_latest_packet` is false.
        """
        return self._mail.take()

    def keep_all(self) -> None:
        """Starts to keep all good packets for `take_all`, independent of `take`."""
        self._mail.keep_all()

    def keep_none(self) -> None:
        """Ends `keep_all`, and drops the packets that nobody has taken."""
        self._mail.keep_none()

    def take_all(self) -> Packets | None:
        """Returns all good packets since the last call, or None when there is none.

        After `keep_all`. They are kept up to 16 MB, then the oldest are dropped.
        """
        return self._mail.take_all()

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` s for a good packet; returns whether one has arrived."""
        return self._mail.wait(timeout)

    def accept(
        self,
        packets: Sequence[bytes],
        arrivals: Sequence[float] | None = None,
        senders: Rows | None = None,
    ) -> None:
        """Accepts raw packets, malformed ones included; only for the source's own thread.

        Args:
            packets: bytes of each, n.
            arrivals: of each, n, s on the clock of `now`; now when None.
            senders: what tells their senders apart, (n, any number of bytes); one when None.

        Raises:
            ValueError: the numbers of arrivals and packets differ.
        """
        times = np.full(len(packets), self.now()) if arrivals is None else np.array(arrivals, float)
        if len(times) != len(packets):
            raise ValueError(f"found {len(times)} arrivals for {len(packets)} packets")
        if len(packets):
            self._accept(*pad_packets(packets, self.size), times, senders)

    def _accept(
        self, rows: Rows, lengths: Ints, arrivals: Array, senders: Rows | None = None
    ) -> None:
        """Accepts packets in rows; only for the source's own thread."""
        if (tap := self._tap) is not None:
            tap(rows, lengths, arrivals)
        intake = self._intake or self.intake
        before = (intake.counters.restarts, intake.counters.lost)
        rows, arrivals = intake.take(rows, lengths, arrivals, senders)
        if len(rows):
            self._mail.put(rows, arrivals)
        intake.count()
        if self.debug_level >= 2:
            self._log_batch(before, len(rows))
        if len(rows):
            self._call_back()

    def _call_back(self) -> None:
        failure: Exception | None = None
        for callback in (*self._callbacks,):
            try:
                callback()
            except Exception as error:  # others are to hear of the packets all the same
                failure = error
        if failure is not None:
            self.note_failure(failure, "a callback of on_receive failed")
        elif self._failure is not None:
            self._failure = None

    def _warn(self, fault: str) -> None:
        now = clock.monotonic()
        if self.debug_level >= 1 and now - self._warned > _WARN_INTERVAL:
            self._warned = now
            log.warning("source '%s': a packet is not applied: %s", self.name, fault)

    def _log_batch(self, before: tuple[int, int], good: int) -> None:
        counters = self.counters
        if counters.restarts > before[0]:
            log.info("source '%s': its sender restarted", self.name)
        if counters.lost > before[1]:
            log.info("source '%s': %d packets lost", self.name, counters.lost - before[1])
        if self.debug_level >= 3:
            log.info("source '%s': %d good packets", self.name, good)

    def note_failure(self, error: BaseException, what: str = "reception failed") -> None:
        """Shows that reception has failed, counts it, and logs it at a limited rate.

        Args:
            what: the failure; without an effect for `Disconnected`, which is only `trouble`.
        """
        if isinstance(error, Disconnected):
            self._trouble = error.trouble
            detail = f" ({error.detail})" if error.detail else ""
            self.tell_once(f"{error.trouble}{detail}; it is tried again")
            return
        text = getattr(error, "strerror", None) or str(error)
        found = SourceError(self.name, f"{what}: {type(error).__name__}: {text}")
        found.__cause__ = error
        now = clock.monotonic()
        self.counters.failures += 1
        self._failure, self._failed_at = found, now
        if self.debug_level >= 1 and now - self._logged_failure > _WARN_INTERVAL:
            self._logged_failure = now
            # A system's error says enough; of another one the traceback shows the line.
            log.warning("%s", found, exc_info=None if isinstance(error, OSError) else error)

    def tell_once(self, text: str) -> None:
        """Logs a text once until the source is opened again."""
        if self.debug_level >= 1 and self._is_new(text):
            log.warning("source '%s': %s", self.name, text)

    @property
    def error(self) -> Exception | None:
        """The last failure of reception, until packets arrive without one or 10 s have passed."""
        if clock.monotonic() - self._failed_at > _ERROR_SHOWN_FOR:
            return None
        return self._failure
