"""`FriReceiver`: a KUKA LWR 4/4+ on its Fast Research Interface (FRI) 1.0.

The controller sends one measurement packet each cycle (1 to 100 ms) to an address that is set
there; a client answers each with a command packet. A client that does not answer is sent
measurements all the same, with the quality `unacceptable`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from ._datagrams import OnArrival
from ._scheduling import short_turns
from .fri_layout import FRAMES, MEASUREMENT, PORT, FriLayout, counter_of, no_command
from .udp import UdpReceiver


class FriReceiver(UdpReceiver):
    """Receives the measurements of an LWR; commands nothing.

    What FRI fixes (`structure`, byte order, counters, time stamps) cannot be set. Events are in
    SI units; frames are T_base_tcp as the controller has its base and its tool set, that is base
    to flange without a tool. `answer_rate` is 1 when every packet was answered; like `latency`,
    `jitter` (s) and `miss_rate` it is an average of the controller over 100 packets.

    Attributes:
        answer: whether measurements are answered. Every answer is a command packet with no command
            in it: its flags, and all but its header, are 0. Without answers the controller calls
            the quality unacceptable. With them an interface that its program has put into command
            mode stays there, and holds the robot where that program has it.
            Answers go first: what is in a packet is looked at up to 4 ms later.
    """

    name: str = "fri"
    udpport: int = Field(PORT, alias="port", ge=0, le=65535)
    is_double: bool = Field(False, alias="double")
    column_major: bool = False
    structure: str = MEASUREMENT
    sequence: str = "send_counter"
    time: str = "timestamp"
    answer: bool = False

    # Where nobody has said what is routed, frames may be missing.
    _nan_allowed: frozenset[str] = PrivateAttr(FRAMES)
    _answers: int = PrivateAttr(0)

    @field_validator(
        "is_double", "column_major", "alignment", "scale", "structure", "sequence", "time",
        "time_scale", mode="before",
    )  # fmt: skip
    @classmethod
    def _is_fixed(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.field_name is not None
        if value != cls.model_fields[info.field_name].default:
            raise ValueError(f"found {value!r}; FRI fixes it: leave it out")
        return value

    @cached_property
    def layout(self) -> FriLayout:
        """The decoder."""
        return FriLayout(self._nan_allowed)

    @property
    def about(self) -> str:
        """Kind and address, as shown to the user."""
        does = "answers, commands nothing" if self.answer else "listens only"
        return f"KUKA FRI 1.0 on {super().about}, {does}"

    @property
    def answers(self) -> int:
        """How many packets were answered since it was opened."""
        return self._answers

    def allow_nan(self, events: Collection[str]) -> None:
        """Lets NaN, and frames that are none, mean `no data` in these events, and in no others.

        Raises:
            UnknownName: an event that FRI does not have.
        """
        super().allow_nan(events)
        self.layout.missing = FRAMES & self._nan_allowed

    def open(self) -> None:
        """Binds the socket and starts the thread; raises SourceError as `UdpReceiver.open` does."""
        super().open()
        if self.answer:
            short_turns.begin(self)

    def close(self) -> None:
        """Stops the thread and closes the socket; harmless when it is not open."""
        short_turns.end(self)
        super().close()

    def reset(self) -> None:
        """Forgets all packets and counters, and takes a changed declaration into account."""
        super().reset()
        self._answers = 0

    def _on_arrival(self, send: Callable[[bytes, bytes], None]) -> OnArrival | None:
        """Answers before anything else is done, for the controller measures the latency."""
        if not self.answer:
            return None

        def answer(packet: memoryview, length: int, sender: bytes) -> None:
            reflected = counter_of(packet, length)
            if reflected is None or not self._is_known(sender):
                return
            try:
                send(no_command(self._answers + 1, reflected), sender)
            except OSError as error:
                self._warn(f"no answer could be sent: {error.strerror}")
                return
            self._answers += 1

        return answer
