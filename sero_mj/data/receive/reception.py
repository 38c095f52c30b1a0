"""Checks and counts the packets of a source, and provides the valid packets."""

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
from .receiving_thread import MAX_PAUSE, Disconnected
from .structure import Rows
from .tracking import Timing

log = logging.getLogger("sero_mj.data.receive.source")

QUIET_AFTER = 0.5  # s without a packet after which a source is silent
_WARN_INTERVAL = 10.0  # s
_ERROR_DURATION = 2 * MAX_PAUSE  # s for which `error` is set if no packets arrive
# Function that receives raw packets (n, bytes), their lengths (n,) and arrival times (n,) in s.
Tap = Callable[[Rows, Ints, Array], object]


class Timeline:
    """Clock of a source: real time, unless a recording or simulation overrides these methods."""

    def now(self) -> float:
        """Returns the current time in seconds, on the same clock as packets' arrival times."""
        return clock.monotonic()

    @property
    def is_live(self) -> bool:
        """Whether packets arrive in real time, and not only when `advance_to` is called."""
        return True

    @property
    def end(self) -> float | None:
        """Time of the last packet in seconds; None for live sources and runs without an end."""
        return None

    @property
    def begin(self) -> float:
        """Earliest time in seconds to which `advance_to` can go back."""
        return 0.0

    @property
    def newest(self) -> float | None:
        """Time in seconds that a simulation without an end has reached; None for other sources."""
        return None

    @property
    def step(self) -> float | None:
        """Time step in seconds, if `advance_to` runs a simulation; None for other sources."""
        return None

    def advance_to(self, time: float) -> None:
        """Advances to a time in seconds. Has no effect on live sources."""


class Reception(PacketDeclaration, Timeline):
    """The part of a source that checks, counts and stores packets of one structure.

    Attributes:
        name: name of the source in routes.
        only_latest_packet: apply only the newest packet instead of all packets in order.
        debug_level: amount of log messages: 0 for none, 1 for faults, 2 also for restarts and
            losses, 3 also for every batch.
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
        """Checks and counters of packets. `open` creates new ones."""
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
        """Counts of packets since the source was opened."""
        return self.intake.counters

    @property
    def timing(self) -> Timing:
        """Rate, jitter and delay since the source was opened."""
        return self.intake.timing

    @property
    def receiving(self) -> bool:
        """Whether a valid packet arrived within the last half second."""
        last = self._mail.last_arrival
        return last is not None and self.now() - last < QUIET_AFTER

    @property
    def receive_trigger(self) -> int:
        """Number of valid packets since the source was opened."""
        return self._mail.number

    def allow_nan(self, events: Collection[str]) -> None:
        """Accepts NaN and infinity as missing data in the named events; raises UnknownName.

        Such values become NaN, and a matrix that contains one becomes NaN as a whole. The rest of
        the packet is applied, and the packet is counted as `blanked`. In other events, NaN and
        infinity make a packet malformed. Takes effect with the next packet.
        """
        for event in events:
            if event not in self.events:
                raise UnknownName("event", event, self.events)
        self._nan_allowed = frozenset(events)
        self.intake.nan_allowed = self._nan_allowed

    def limit(self, limits: Mapping[str, Array]) -> None:
        """Sets the maximum magnitudes, shape (k,), of the k numbers of each event.

        A packet with a larger number is malformed and counted as `implausible`. Takes effect with
        the next packet.
        """
        self._limits = dict(limits)
        self.intake.limits = self._limits

    def on_receive(self, callback: Callable[[], None]) -> None:
        """Registers a function that the receiving thread calls after valid packets.

        If the function raises an exception, this becomes `error`, and reception continues.
        """
        self._callbacks.append(callback)

    def remove_callback(self, callback: Callable[[], None]) -> None:
        """Removes a function registered by `on_receive`. Has no effect for other functions."""
        with suppress(ValueError):
            self._callbacks.remove(callback)

    def record_to(self, tap: Tap | None) -> None:
        """Passes all packets, including malformed ones, to `tap` on arrival; None ends this."""
        self._tap = tap

    @property
    def closing(self) -> threading.Event:
        """Event that is set while the source is being closed."""
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
        """Discards all packets, counters and errors, and applies a changed declaration."""
        self.__dict__.pop("layout", None)
        self._intake = self._new_intake()
        self._mail.is_lossless = not self.only_latest_packet
        self._mail.empty()
        self._trouble, self._failure, self._is_new = "", None, Once()
        self._warned = self._logged_failure = -np.inf

    def latest(self) -> Packet | None:
        """Returns the newest valid packet, or None if none has arrived."""
        packets = self._mail.newest()
        return None if packets is None else packets.last

    def take(self) -> Packets | None:
        """Returns the valid packets since the last call, or None if there are none.

        If `only_latest_packet` is set, returns only the newest one.
        """
        return self._mail.take()

    def start_history(self) -> None:
        """Starts storing all valid packets for `take_history`, independently of `take`."""
        self._mail.start_history()

    def stop_history(self) -> None:
        """Stops storing packets for `take_history`, and discards the stored packets."""
        self._mail.stop_history()

    def take_history(self) -> Packets | None:
        """Returns the valid packets since `start_history` or the last call; None if there are none.

        If the packets exceed 16 MB, the oldest packets are missing.
        """
        return self._mail.take_history()

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` seconds for a valid packet, and returns whether one has arrived."""
        return self._mail.wait(timeout)

    def accept(
        self,
        packets: Sequence[bytes],
        arrivals: Sequence[float] | None = None,
        senders: Rows | None = None,
    ) -> None:
        """Accepts n raw packets, including malformed ones. Call this in the receiving thread.

        Args:
            arrivals: n arrival times in seconds on the clock of `now`; None for the current time.
            senders: identifier of each packet's sender, shape (n, any); None for a single sender.
        """
        times = np.full(len(packets), self.now()) if arrivals is None else np.array(arrivals, float)
        if len(times) != len(packets):
            raise ValueError(f"found {len(times)} arrivals for {len(packets)} packets")
        if len(packets):
            self._accept(*pad_packets(packets, self.size), times, senders)

    def reject(self, message: bytes, reason: str) -> None:
        """Counts a malformed message; `reason` becomes the last fault of the source.

        Sources call this for messages that they cannot convert to packets.
        """
        if (tap := self._tap) is not None:
            # A recorded message with the size of a packet would be replayed as a packet.
            raw = message + b"\0" * (len(message) == self.size)
            tap(*pad_packets([raw], self.size), np.array([self.now()]))
        self.intake.reject(reason, len(message), self.now())

    def _accept(
        self, rows: Rows, lengths: Ints, arrivals: Array, senders: Rows | None = None
    ) -> None:
        if (tap := self._tap) is not None:
            tap(rows, lengths, arrivals)
        intake = self._intake or self.intake
        before = (intake.counters.restarts, intake.counters.lost)
        rows, arrivals = intake.take(rows, lengths, arrivals, senders)
        if len(rows):
            self._trouble = ""
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
            except Exception as error:  # the other callbacks are still called
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

    def _log_batch(self, before: tuple[int, int], valid: int) -> None:
        counters = self.counters
        if counters.restarts > before[0]:
            log.info("source '%s': the sender restarted", self.name)
        if counters.lost > before[1]:
            log.info("source '%s': %d packets lost", self.name, counters.lost - before[1])
        if self.debug_level >= 3:
            log.info("source '%s': %d valid packets", self.name, valid)

    def note_failure(self, error: BaseException, what: str = "reception failed") -> None:
        """Sets `error`, counts the failure, and logs it at a limited rate.

        `Disconnected` sets only `trouble`. `what` precedes the text of other exceptions.
        """
        if isinstance(error, Disconnected):
            self._trouble = error.trouble
            detail = f" ({error.detail})" if error.detail else ""
            self.log_once(f"{error.trouble}{detail}; trying again")
            return
        text = getattr(error, "strerror", None) or str(error)
        found = SourceError(self.name, f"{what}: {type(error).__name__}: {text}")
        found.__cause__ = error
        now = clock.monotonic()
        self.counters.failures += 1
        self._failure, self._failed_at = found, now
        if self.debug_level >= 1 and now - self._logged_failure > _WARN_INTERVAL:
            self._logged_failure = now
            # Errors of the operating system need no traceback.
            log.warning("%s", found, exc_info=None if isinstance(error, OSError) else error)

    def log_once(self, text: str) -> None:
        """Logs a text unless it has been logged since the source was opened."""
        if self.debug_level >= 1 and self._is_new(text):
            log.warning("source '%s': %s", self.name, text)

    @property
    def trouble(self) -> str:
        """Displayed reason why no packets arrive; empty if unknown. Valid packets clear it."""
        return self._trouble

    def note_trouble(self, trouble: str) -> None:
        """Sets `trouble`; an empty text clears it."""
        self._trouble = trouble

    @property
    def error(self) -> Exception | None:
        """Last failure of reception; None after valid packets, or 10 s after the failure."""
        if clock.monotonic() - self._failed_at > _ERROR_DURATION:
            return None
        return self._failure
