"""Receives measurements of a KUKA LWR 4/4+ (FRI 1.0) or iiwa, and defines the packets of FRI 1.0.

The controller sends one measurement packet per cycle (1 to 100 ms) to a configured address. A
client answers each packet with a command packet. Without answers, the controller continues to send,
with the quality `unacceptable`. Packets are little-endian without padding. Their layouts are from
the interface, and the names are ours.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PrivateAttr, model_validator

from ...base.frames import Array
from ...data.receive.structure import Rows, Structure, TorqueSign, are_frames
from ...data.receive.udp import UdpReceiver
from ...data.receive.udp_socket import OnArrival
from . import iiwa as fri_iiwa

PORT = 49938  # FRI's own default
TORQUE_SIGN: TorqueSign = 1  # default sign of an LWR; not verified on hardware
CYCLES = (0.001, 0.1)  # s; range of the controller's setting
ALL_DRIVES = 0x7F  # `power` with all seven drives on

INVALID = 65535  # -1 as an unsigned state or quality
STATES = {0: "off", 1: "monitor", 2: "command", INVALID: "invalid"}
QUALITIES = {0: "unacceptable", 1: "bad", 2: "ok", 3: "perfect", INVALID: "invalid"}

_ID = 0x2006  # datagram id of measurements
_HEADER = "send_counter:1H reflected_counter:1H packet_size:1H=size datagram_id:1H={}"
_KRL = "krl_real:16f krl_int:16i krl_bool:1H 2x"
# Packet from the controller, 916 bytes.
MEASUREMENT = " ".join(
    (
        _HEADER.format(hex(_ID)),
        _KRL,
        "timestamp:1f state:1H quality:1H measurement_cycle:1f command_cycle:1f safety_limits:1f",
        "answer_rate:1f latency:1f jitter:1f miss_rate:1f miss_counter:1I",
        "power:1H control:1H error:1H warning:1H temperatures:7f",
        "joint_angles:7f flange_frame:1Tf",
        "commanded_before_fri:7f commanded_offset:7f",
        "commanded_frame:1Tf commanded_frame_offset:12f",
        "torques:7f external_torques:7f tcp_force:1Vf tcp_moment:1Vf",
        "jacobian:42f mass_matrix:49f gravity_torques:7f",
    )
)
# Packet to the controller, 376 bytes. Values have an effect if their bit in `command_flags` is set.
COMMAND = " ".join(
    (
        _HEADER.format("0x1005"),
        _KRL,
        "command_flags:1I joint_angles:7f tcp_frame:12f joint_torques:7f tcp_wrench:6f",
        "joint_stiffness:7f joint_damping:7f cartesian_stiffness:6f cartesian_damping:6f",
    )
)
# Structure and description by packet size.
KNOWN_PACKETS = {
    916: (MEASUREMENT, "KUKA FRI, measured data (LWR 4)"),
    376: (COMMAND, "KUKA FRI, commands (LWR 4)"),
}
FRAMES = frozenset(("flange_frame", "commanded_frame"))
_COMMANDED = ("commanded_before_fri", "commanded_offset")


class FriLayout(Structure):
    """Layout of the measurement packet, with values in the conventions of this package.

    - `commanded_angles` is added. FRI reports the command of the robot's program and the offset of
      its client; the robot follows their sum.
    - `tcp_moment` and the last three rows of the `jacobian` (6 x 7, row by row) are sent in the
      order z, y, x and returned as x, y, z.
    - Frames in `optional_frames` are NaN if they are invalid, for example zero because no program
      has commanded one yet. Other invalid frames make a packet malformed.
    """

    def __init__(
        self,
        optional_frames: Collection[str] = FRAMES,
        torque_sign: TorqueSign = TORQUE_SIGN,
    ) -> None:
        super().__init__(
            MEASUREMENT,
            is_double=False,
            column_major=False,
            signs={"torques": float(torque_sign)},
        )
        self.optional_frames = FRAMES & set(optional_frames)
        self.events["commanded_angles"] = self.events[_COMMANDED[0]]

    def decode(self, packet: bytes | bytearray | memoryview) -> dict[str, Array]:
        values = super().decode(packet)
        derived = self._derive({event: array[None] for event, array in values.items()})
        return {event: array[0] for event, array in derived.items()}

    def decode_rows(self, rows: Rows, events: Collection[str] | None = None) -> dict[str, Array]:
        if events is not None and "commanded_angles" in events:
            events = {*events, *_COMMANDED}
        return self._derive(super().decode_rows(rows, events))

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        return float(values["state"][0]), float(values["quality"][0])

    def link_words(self, state: float, quality: float) -> tuple[str, str]:
        state_word, quality_word = (
            words.get(int(number), f"{number:.0f}")
            for words, number in ((STATES, state), (QUALITIES, quality))
        )
        return state_word, quality_word

    def is_healthy(self, state: float, quality: float) -> bool:
        state_word, quality_word = self.link_words(state, quality)
        return state_word in ("monitor", "command") and quality_word in ("ok", "perfect")

    def describe(self, values: Mapping[str, Array]) -> str:
        """Returns a description of the robot controller's state."""
        return "state {}, quality {}".format(*self.link_words(*self.link_state(values)))

    @property
    def required_frames(self) -> tuple[str, ...]:
        return tuple(event for event in self.matrices if event not in self.optional_frames)

    def find_not_finite(self, rows: Rows, but: Collection[str] = ()) -> NDArray[np.bool_]:
        if "commanded_angles" not in but:  # both of its summands must be finite
            but = frozenset(but).difference(_COMMANDED)
        return super().find_not_finite(rows, but)

    def bounds(self, limits: Mapping[str, float]) -> list[Any]:
        if "commanded_angles" in limits:  # the sum of two events
            half = limits["commanded_angles"] / 2.0
            parts = {part: min(half, limits.get(part, half)) for part in _COMMANDED}
            limits = {**limits, **parts}
        return super().bounds(limits)

    def _derive(self, values: dict[str, Array]) -> dict[str, Array]:
        if all(event in values for event in _COMMANDED):
            before, offset = (values[event] for event in _COMMANDED)
            with np.errstate(invalid="ignore"):  # infinity - infinity
                values["commanded_angles"] = before + offset
        _reverse_moments(values)
        for event in self.optional_frames & values.keys():
            frames = values[event]
            with np.errstate(invalid="ignore", over="ignore"):
                good = are_frames(frames.reshape(-1, 4, 4)).reshape(-1, 1, 1, 1)
            values[event] = np.where(good, frames, np.nan)
        return values

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        packed: dict[str, Any] = {
            event: np.array(value) if event in ("tcp_moment", "jacobian") else value
            for event, value in values.items()
        }
        if "commanded_angles" in packed:
            offset = np.asarray(packed.get("commanded_offset", 0.0))
            packed["commanded_before_fri"] = np.asarray(packed.pop("commanded_angles")) - offset
        _reverse_moments(packed)
        return super().encode(packed)


def _reverse_moments(values: dict[str, Any]) -> None:
    if "tcp_moment" in values:
        values["tcp_moment"] = values["tcp_moment"][..., ::-1]
    if "jacobian" in values:
        rows = np.array(values["jacobian"])
        turned = rows.reshape(*rows.shape[:-1], 6, 7)[..., [0, 1, 2, 5, 4, 3], :]
        values["jacobian"] = turned.reshape(rows.shape)


_HEAD = struct.Struct("<4H")  # layout of _HEADER
_SIZE = Structure(MEASUREMENT, is_double=False).size
_NO_COMMAND = Structure(COMMAND).encode({})[4:]


def counter_of(packet: memoryview, length: int) -> int | None:
    """Returns the `send_counter` of a measurement, or None for any other packet.

    The checks are the same as in `FriLayout.find_wrong_constants`, but ten times faster.
    """
    if length != _SIZE:
        return None
    counter, _, size, datagram_id = _HEAD.unpack_from(packet)
    return int(counter) if (size, datagram_id) == (_SIZE, _ID) else None


def no_command(counter: int, reflected: int) -> bytes:
    """Returns a command packet without a command, which is zero except for its header.

    Args:
        counter: number of packets sent so far, including this one; the lower 16 bits are sent.
        reflected: `send_counter` of the last measurement.
    """
    return struct.pack("<HH", counter & 0xFFFF, reflected) + _NO_COMMAND


_STRUCTURES = {"1": MEASUREMENT, **fri_iiwa.STRUCTURES}


# By default, a thread that answers waits up to 5 ms until the interpreter switches to it. The
# cycle of a controller can be 1 ms.
_SWITCH_INTERVAL = 5e-4  # s
_DEFAULT_SWITCH_INTERVAL = sys.getswitchinterval()
_ANSWERING: set[int] = set()  # ids of the receivers that answer


def _set_switch_interval() -> None:
    sys.setswitchinterval(_SWITCH_INTERVAL if _ANSWERING else _DEFAULT_SWITCH_INTERVAL)


class FriReceiver(UdpReceiver):
    """Receives the measurements of an LWR or an iiwa without commanding it.

    `structure`, byte order, counters and time stamps are fixed by FRI and cannot be set. Frames are
    T_base_tcp with the base and tool that are set in the controller. Without a tool, they are
    T_base_flange. `answer_rate` is 1 if every packet was answered. Like `latency`, `jitter` (s) and
    `miss_rate`, it is an average of the controller over 100 packets.

    Attributes:
        version: FRI version: `1` for an LWR 4/4+, `iiwa-1` or `iiwa-2` (1.x and 2.x) for an iiwa or
            Med. For the latter, the default port is 30200.
        answer: whether to answer measurements. Every answer is a command packet without a command:
            except for its header, everything including the flags is 0 or omitted. Without answers,
            the controller rates the quality as unacceptable or poor. With answers, an LWR in
            command mode stays in command mode and follows the robot program. An iiwa that waits for
            commands or follows them receives no answer. Answers have priority, so packets are
            processed up to 4 ms later.
        torque_sign: factor of measured and commanded torques, 1 or -1 (default: 1 for an LWR, -1
            for an iiwa).
    """

    name: str = "fri"
    udpport: int = Field(PORT, alias="port", ge=0, le=65535)
    is_double: bool = Field(False, alias="double")
    column_major: bool = False
    structure: str = MEASUREMENT
    sequence: str = "send_counter"
    time: str = "timestamp"
    version: Literal["1", "iiwa-1", "iiwa-2"] = "1"
    answer: bool = False
    torque_sign: TorqueSign | None = None

    _fixed_by: ClassVar[str] = "FRI"
    # Until the routes are known, frames may be missing.
    _nan_allowed: frozenset[str] = PrivateAttr(FRAMES)
    _answers: int = PrivateAttr(0)

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, fields: dict[str, Any]) -> dict[str, Any]:
        fields = dict(fields)
        structure = _STRUCTURES.get(str(fields.get("version", "1")))
        if structure and fields.get("structure", MEASUREMENT) in _STRUCTURES.values():
            fields["structure"] = structure
        if structure != MEASUREMENT and not {"port", "udpport"} & fields.keys():
            fields["port"] = fri_iiwa.PORT
        return fields

    def model_post_init(self, context: Any, /) -> None:
        """Allows an iiwa to omit optional values until the routes are known."""
        self.__pydantic_fields_set__.discard("structure")  # it was set by `_complete`
        if self.is_iiwa:
            self._nan_allowed = fri_iiwa.OPTIONAL & self.events.keys()

    @classmethod
    def _fixed(cls, field: str) -> Collection[Any]:
        return _STRUCTURES.values() if field == "structure" else super()._fixed(field)

    @cached_property
    def layout(self) -> FriLayout | fri_iiwa.IiwaLayout:
        if self.is_iiwa:
            return fri_iiwa.IiwaLayout(self.version, self.torque_sign or fri_iiwa.TORQUE_SIGN)
        return FriLayout(self._nan_allowed, self.torque_sign or TORQUE_SIGN)

    def decoding_fields(self) -> dict[str, Any]:
        if not self.is_iiwa:
            return super().decoding_fields()
        kept = {"version", "torque_sign"}  # fields that determine the structure and the signs
        return self.model_dump(mode="json", include=kept, exclude_defaults=True)

    @property
    def is_iiwa(self) -> bool:
        return self.version != "1"

    @property
    def can_be_played(self) -> bool:
        return not self.is_iiwa

    @property
    def about(self) -> str:
        does = "answers without commands" if self.answer else "listens only"
        name = f"FRI {self.version[-1]}.x of an iiwa" if self.is_iiwa else "FRI 1.0"
        return f"KUKA {name} on {super().about}, {does}"

    def describe_link(self, values: Mapping[str, Array]) -> str:
        return self.layout.describe(values)

    def link_faults(self, state: float, quality: float) -> list[str]:
        if self.layout.is_healthy(state, quality):
            return []
        state_word, quality_word = self.layout.link_words(state, quality)
        lines = [f"quality {quality_word}, state {state_word}"]
        if quality_word in ("unacceptable", "poor") and not self.answer:
            lines.append("  no answers are sent: answer = false")
        return lines

    @property
    def answers(self) -> int:
        """Number of packets answered since the source was opened."""
        return self._answers

    def allow_nan(self, events: Collection[str]) -> None:
        super().allow_nan(events)
        if isinstance(self.layout, FriLayout):
            self.layout.optional_frames = FRAMES & self._nan_allowed

    def open(self) -> None:
        super().open()
        if self.answer:
            _ANSWERING.add(id(self))
            _set_switch_interval()

    def close(self) -> None:
        if id(self) in _ANSWERING:
            _ANSWERING.discard(id(self))
            _set_switch_interval()
        super().close()

    def reset(self) -> None:
        super().reset()
        self._answers = 0

    def _on_arrival(self, send: Callable[[bytes, bytes], None]) -> OnArrival | None:
        if not self.answer:
            return None
        monitoring = fri_iiwa.MonitoringClient()

        def answer(packet: memoryview, length: int, sender: bytes) -> None:
            if not self._is_known(sender):
                return
            if self.is_iiwa:
                reply = monitoring.answer(bytes(packet[:length]), self._answers)
            elif (counter := counter_of(packet, length)) is not None:
                reply = no_command(self._answers + 1, counter)
            else:
                return
            if reply is None:
                return
            try:
                send(reply, sender)
            except OSError as error:
                self._warn(f"an answer could not be sent: {error.strerror}")
                return
            self._answers += 1

        return answer
