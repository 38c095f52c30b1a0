"""Messages of KUKA's Fast Research Interface (FRI) 1.x and 2.x of the LBR iiwa and LBR Med.

The controller sends one monitoring message per cycle (1 to 100 ms). It is encoded with Protocol
Buffers and varies in size; `IiwaLayout` converts messages to packets with a fixed layout. A client
answers every `receive_multiplier`-th message, even if it only monitors. FRI 2.7 puts the length
before the message and a checksum after it. Field numbers are from the client SDKs 1.11 to 2.7, and
field names are ours.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from ...base.frames import Array, Ints
from ...data.receive.structure import Rows, Structure, TorqueSign

PORT = 30200  # FRI's own default
JOINTS = 7
MONITORING_ID, COMMAND_ID = 0x245142, 0x34001
# Measured and commanded torques are exerted by the load on the drive, so their sign is opposite to
# ours. External torques and the torques that a client commands have our sign. Sources: drake
# manipulation/README.md and lbr_fri_ros2_stack issue 249; docs/conventions.md.
TORQUE_SIGN: TorqueSign = -1

UNKNOWN = -1  # value of a state that is missing in a message
STATES = (
    "idle", "monitoring wait", "monitoring ready", "commanding wait", "commanding active",
)  # fmt: skip
QUALITIES = ("poor", "fair", "good", "excellent")
CONTROLS = ("position control", "Cartesian impedance control", "joint impedance control",
            "no control")  # fmt: skip
DRIVES = ("drives off", "drives changing", "drives active")
SAFETIES = ("", "safety stop 0", "safety stop 1", "safety stop 2")
COMMANDS = ("", "commanded by joint positions", "commanded by wrenches", "commanded by torques",
            "commanded by poses")  # fmt: skip
_MONITORING = (1, 2)  # states in which an answer does not command anything

_COMMON = " ".join(
    (
        f"message_id:1I={MONITORING_ID:#x} send_counter:1I reflected_counter:1I timestamp:1d",
        "measurement_cycle:1d receive_multiplier:1i state:1b quality:1b control:1b safety:1b",
        "operation_mode:1b command_mode:1b overlay:1b drives:7b tracking_performance:1d",
        "joint_angles:7d torques:7d commanded_torques:7d external_torques:7d",
        "interpolated_angles:7d",
    )
)
_PACKING = "<3I2di7b7bd35d"
# Packet structure of each version. FRI 2 omits commanded angles, and 2.7 adds the external wrench.
STRUCTURES = {
    "iiwa-1": f"{_COMMON} commanded_angles:7d",
    "iiwa-2": f"{_COMMON} tcp_force:1Vd tcp_moment:1Vd",
}
# Events that may be missing in a message.
OPTIONAL = frozenset(
    (
        *("torques", "commanded_torques", "external_torques", "interpolated_angles"),
        *("commanded_angles", "tcp_force", "tcp_moment", "tracking_performance"),
        *("measurement_cycle", "timestamp"),
    )
)
_MISSING = (math.nan,) * JOINTS
# Each number has a tag and 8 bytes. A packed list has one tag and a length instead.
_UNPACKED = {count: struct.Struct("<" + "xd" * count) for count in (6, JOINTS)}
_TAGGED = struct.Struct("<" + "Bd" * JOINTS)
_DOUBLE = struct.Struct("<d")

Fields = dict[int, list[int | bytes]]  # all values of each field, by field number


def read_fields(message: bytes) -> Fields:
    """Parses a message into integers, and bytes for fields of other types; raises ValueError."""
    fields: Fields = {}
    at, end = 0, len(message)
    while at < end:
        tag, at = _varint(message, at)
        number, kind = tag >> 3, tag & 7
        value: int | bytes
        if kind == 0:
            value, at = _varint(message, at)
        else:
            if kind == 2:
                count, at = _varint(message, at)
            elif kind in (1, 5):
                count = 8 if kind == 1 else 4
            else:
                raise ValueError(f"byte {at - 1} is not the start of a field")
            if count > end - at:
                raise ValueError(f"field {number} has {count} bytes, but {end - at} are left")
            value, at = message[at : at + count], at + count
        fields.setdefault(number, []).append(value)
    return fields


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(message) and shift < 70:
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise ValueError(f"the integer that ends at byte {at} is truncated or too long")


def read_numbers(fields: Fields, number: int, count: int = JOINTS) -> tuple[float, ...]:
    """Returns the numbers of a list within a message, or NaN if it is missing."""
    if number not in fields:
        return (math.nan,) * count
    text = read_message(fields, number)
    unpacked = _UNPACKED[count]
    if len(text) == unpacked.size and text[::9] == b"\x09" * count:
        return unpacked.unpack(text)
    if len(text) == 8 * count + 2 and text[:2] == bytes((0x0A, 8 * count)):
        return struct.unpack_from(f"<{count}d", text, 2)
    found = read_fields(text).get(1, [])
    raise ValueError(f"found {len(found)} numbers in field {number}; expected {count}")


def read_message(fields: Fields, number: int) -> bytes:
    """Returns the last value of a message field, or nothing if it is missing."""
    value = fields.get(number, [b""])[-1]
    if isinstance(value, int):
        raise ValueError(f"field {number} is an integer; expected a message")
    return value


def read_integer(fields: Fields, number: int, low: int = UNKNOWN, high: int = 127) -> int:
    """Returns the last value of an integer field, or `UNKNOWN` if it is missing."""
    value = fields.get(number, [UNKNOWN])[-1]
    if not isinstance(value, int):
        raise ValueError(f"field {number} is a message; expected an integer")
    if not low <= value <= high:
        raise ValueError(f"field {number} is {value}; expected {low} to {high}")
    return value


def _double(fields: Fields, number: int) -> float:
    value = fields.get(number, [b""])[-1]
    if value == b"":
        return math.nan
    if isinstance(value, int) or len(value) != _DOUBLE.size:
        raise ValueError(f"field {number} is not a float64")
    return float(_DOUBLE.unpack(value)[0])


def unframed(packet: bytes) -> tuple[bytes, bool]:
    """Returns the message in a packet, and whether the packet has a length and checksum (FRI 2.7).

    Raises:
        ValueError: the checksum is wrong.
    """
    if len(packet) < 8 or int.from_bytes(packet[:4], "little") != len(packet) - 8:
        return packet, False
    message = packet[4:-4]
    if zlib.crc32(message) != int.from_bytes(packet[-4:], "little"):
        raise ValueError("the checksum is wrong")
    return message, True


def pack(packet: bytes, version: str) -> bytes:
    """Converts a monitoring message to a packet of `STRUCTURES[version]`; raises ValueError."""
    message, is_framed = unframed(packet)
    if is_framed and version == "iiwa-1":
        raise ValueError("the message has the header of FRI 2.7; set version = 'iiwa-2'")
    fields = read_fields(message)
    header, link = read_fields(read_message(fields, 1)), read_fields(read_message(fields, 4))
    robot, ipo = read_fields(read_message(fields, 2)), read_fields(read_message(fields, 5))
    monitor = read_fields(read_message(fields, 3))
    if 1 not in header or 2 not in header:
        raise ValueError("the header is missing")
    joints = read_integer(robot, 1)
    if joints not in (UNKNOWN, JOINTS):
        raise ValueError(f"found {joints} joints; expected {JOINTS}")
    time = read_fields(read_message(monitor, 15))
    timestamp = math.nan
    if 1 in time:
        timestamp = read_integer(time, 1, 0, 2**32 - 1) + 1e-9 * read_integer(
            {2: [0], **time}, 2, 0, 10**9
        )
    period = read_integer(link, 3, high=10**6)
    drives = [value if isinstance(value, int) else -1 for value in robot.get(5, [])][:JOINTS]
    if robot.get(5) and isinstance(robot[5][0], bytes):  # packed
        drives = [*robot[5][0]][:JOINTS]
    packed = struct.pack(
        _PACKING,
        *(read_integer({3: [0], **header}, number, 0, 2**32 - 1) for number in (1, 2, 3)),
        timestamp,
        math.nan if period == UNKNOWN else period / 1e3,
        read_integer(link, 4, high=2**31 - 1),
        *(read_integer(link, 1), read_integer(link, 2)),
        *(
            read_integer(robot, 7),
            read_integer(robot, 2),
            read_integer(robot, 6),
            read_integer(ipo, 10),
            read_integer(ipo, 11),
        ),
        *(max(-1, min(drive, 127)) for drive in drives),
        *[UNKNOWN] * (JOINTS - len(drives)),
        _double(ipo, 12),
        *(x for number in (1, 2, 4, 5) for x in read_numbers(monitor, number)),
        *read_numbers(ipo, 1),
    )
    if version == "iiwa-1":
        return packed + struct.pack("<7d", *read_numbers(monitor, 3))
    *force, about_z, about_y, about_x = read_numbers(monitor, 6, 6)
    return packed + struct.pack("<6d", *force, about_x, about_y, about_z)


class IiwaLayout(Structure):
    """Layout of the packets to which monitoring messages of an iiwa are converted.

    `version` is `iiwa-1` or `iiwa-2`. Moments are sent in the order z, y, x and returned as x, y,
    z. Missing values are NaN, and missing states are -1.
    """

    message = "FRI message"

    def __init__(self, version: str, torque_sign: TorqueSign = TORQUE_SIGN) -> None:
        signs = dict.fromkeys(("torques", "commanded_torques"), float(torque_sign))
        super().__init__(STRUCTURES[version], signs=signs)
        self.version = version

    def unpack(self, rows: Rows, lengths: Ints) -> tuple[Rows, Ints]:
        packets = np.zeros((len(rows), self.size), np.uint8)
        sizes = np.zeros(len(rows), np.intp)
        for k, (row, length) in enumerate(zip(rows, lengths.tolist(), strict=True)):
            if length <= len(row):
                try:
                    packet = pack(row[:length].tobytes(), self.version)
                except ValueError:
                    continue
                packets[k], sizes[k] = np.frombuffer(packet, np.uint8), self.size
        return packets, sizes

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        if length > len(packet):
            return f"{length} bytes are not an {self.message}: too long"
        try:
            pack(packet, self.version)
        except ValueError as error:
            return f"{length} bytes are not an {self.message}: {error}"
        return f"{length} bytes are not an {self.message}"

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        return float(values["state"][0]), float(values["quality"][0])

    def link_words(self, state: float, quality: float) -> tuple[str, str]:
        return word(STATES, state), word(QUALITIES, quality)

    def is_healthy(self, state: float, quality: float) -> bool:
        return state > 0 and word(QUALITIES, quality) in ("good", "excellent")

    def describe(self, values: Mapping[str, Array]) -> str:
        """Returns a description of the robot controller's state."""
        drives = values["drives"]
        drive = drives[0] if (drives == drives[0]).all() else 1.0  # like KUKA's client
        texts = [
            word(STATES, values["state"][0]),
            f"quality {word(QUALITIES, values['quality'][0])}",
            word(CONTROLS, values["control"][0]),
            word(DRIVES, drive),
            word(SAFETIES, values["safety"][0]),
            word(COMMANDS, values["command_mode"][0]),
        ]
        return ", ".join(text for text in texts if text)


def word(words: Sequence[str], number: float) -> str:
    """Returns the word for a state, or the number itself if there is none."""
    if number == UNKNOWN:
        return "unknown" if words in (STATES, QUALITIES) else ""
    return words[int(number)] if 0 <= number < len(words) else f"{number:.0f}"


class MonitoringClient:
    """Answers monitoring messages with only a header, like a client that only monitors.

    While a controller waits for commands or follows them, its messages are not answered, because
    such an answer would have to contain a command.
    """

    def __init__(self) -> None:
        self._unanswered = 0

    def answer(self, packet: bytes, counter: int) -> bytes | None:
        """Returns the answer to a message, or None if no answer is due."""
        try:
            message, is_framed = unframed(packet)
            fields = read_fields(message)
            header, link = (
                read_fields(read_message(fields, 1)),
                read_fields(read_message(fields, 4)),
            )
            sent, state = read_integer(header, 2, 0, 2**32 - 1), read_integer(link, 1)
            every = read_integer(link, 4, high=2**31 - 1)
        except ValueError:
            return None
        if header.get(1) != [MONITORING_ID] or state not in _MONITORING:
            return None
        self._unanswered += 1
        if self._unanswered < every:
            return None
        self._unanswered = 0
        reply = no_command(counter & 0xFFFFFFFF, sent)
        return framed(reply) if is_framed else reply


def no_command(counter: int, reflected: int) -> bytes:
    """Returns a command message without a command, which consists only of a header.

    Args:
        counter: number of messages sent before (uint32).
        reflected: `send_counter` of the message that is answered.
    """
    header = integer_field(1, COMMAND_ID), integer_field(2, counter), integer_field(3, reflected)
    return message_field(1, *header)


def framed(message: bytes) -> bytes:
    """Returns a message preceded by its length and followed by its checksum (FRI 2.7)."""
    return struct.pack("<I", len(message)) + message + struct.pack("<I", zlib.crc32(message))


def integer_field(number: int, value: int) -> bytes:
    """Encodes an integer field of a message."""
    return bytes((number << 3,)) + _encoded(value)


def float_field(number: int, value: float) -> bytes:
    """Encodes a float64 field of a message."""
    return bytes((number << 3 | 1,)) + _DOUBLE.pack(value)


def message_field(number: int, *fields: bytes) -> bytes:
    """Encodes a field whose value is a message with the given fields."""
    message = b"".join(fields)
    return bytes((number << 3 | 2,)) + _encoded(len(message)) + message


def joints_field(number: int, values: Array) -> bytes:
    """Encodes a field whose value is a message with a list of one value per joint."""
    return message_field(
        number, _TAGGED.pack(*(x for value in values.tolist() for x in (9, value)))
    )


@lru_cache(maxsize=1024)
def _encoded(value: int) -> bytes:
    groups = []
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*groups, value))
