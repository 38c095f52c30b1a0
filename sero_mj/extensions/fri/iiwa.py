"""KUKA's Fast Research Interface (FRI) 1.x and 2.x of the LBR iiwa and LBR Med: its messages.

The controller sends one monitoring message each cycle (1 to 100 ms), encoded by Protocol Buffers,
so of any size; `IiwaLayout` turns them into packets of one layout. A client answers every
`receive_multiplier`-th of them, also while it only monitors. FRI 2.7 puts the message's length
before and its checksum after it. Numbers of fields are those of the interface, as the client SDKs
1.11 to 2.7 have them; the names are ours.
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
# Measured and commanded torques are those of the load on the drive, so they have the opposite sign
# of ours. External torques, and the torques that a client commands, have our sign. Sources: drake
# manipulation/README.md and lbr_fri_ros2_stack issue 249; docs/conventions.md.
TORQUE_SIGN: TorqueSign = -1

UNKNOWN = -1  # of a state that a message leaves out
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
_MONITORING = (1, 2)  # states in which an answer commands nothing

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
# Version to its packets' structure. FRI 2 tells no commanded angles, but 2.7 the external wrench.
STRUCTURES = {
    "iiwa-1": f"{_COMMON} commanded_angles:7d",
    "iiwa-2": f"{_COMMON} tcp_force:1Vd tcp_moment:1Vd",
}
# Events that a message may leave out.
OPTIONAL = frozenset(
    (
        *("torques", "commanded_torques", "external_torques", "interpolated_angles"),
        *("commanded_angles", "tcp_force", "tcp_moment", "tracking_performance"),
        *("measurement_cycle", "timestamp"),
    )
)
_MISSING = (math.nan,) * JOINTS
# Tag and 8 bytes of each number; a list may also be packed, which has one tag and a length.
_UNPACKED = {count: struct.Struct("<" + "xd" * count) for count in (6, JOINTS)}
_TAGGED = struct.Struct("<" + "Bd" * JOINTS)
_DOUBLE = struct.Struct("<d")

Fields = dict[int, list[int | bytes]]  # number of a field to all of its values


def read_fields(message: bytes) -> Fields:
    """The fields of a message: whole numbers, and the bytes of all others; raises ValueError."""
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
                raise ValueError(f"byte {at - 1} begins no field")
            if count > end - at:
                raise ValueError(f"its field {number} has {count} bytes; {end - at} are left")
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
    raise ValueError(f"the number that ends at byte {at} is cut off or too long")


def read_numbers(fields: Fields, number: int, count: int = JOINTS) -> tuple[float, ...]:
    """The numbers of a list within a message; NaN if it is not there."""
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
    """The last value of a field, a message; empty if it is not there."""
    value = fields.get(number, [b""])[-1]
    if isinstance(value, int):
        raise ValueError(f"field {number} is a number; expected a message")
    return value


def read_whole(fields: Fields, number: int, low: int = UNKNOWN, high: int = 127) -> int:
    """The last value of a field, a whole number; `UNKNOWN` if it is not there."""
    value = fields.get(number, [UNKNOWN])[-1]
    if not isinstance(value, int):
        raise ValueError(f"field {number} is a message; expected a number")
    if not low <= value <= high:
        raise ValueError(f"field {number} is {value}; expected at most {high}")
    return value


def _double(fields: Fields, number: int) -> float:
    value = fields.get(number, [b""])[-1]
    if value == b"":
        return math.nan
    if isinstance(value, int) or len(value) != _DOUBLE.size:
        raise ValueError(f"field {number} is not a float64")
    return float(_DOUBLE.unpack(value)[0])


def unframed(packet: bytes) -> tuple[bytes, bool]:
    """The message in a packet, and whether its length and checksum stand around it (FRI 2.7).

    Raises:
        ValueError: the checksum is that of another message.
    """
    if len(packet) < 8 or int.from_bytes(packet[:4], "little") != len(packet) - 8:
        return packet, False
    message = packet[4:-4]
    if zlib.crc32(message) != int.from_bytes(packet[-4:], "little"):
        raise ValueError("its checksum is wrong")
    return message, True


def pack(packet: bytes, version: str) -> bytes:
    """Turns a monitoring message into a packet of `STRUCTURES[version]`; raises ValueError."""
    message, is_framed = unframed(packet)
    if is_framed and version == "iiwa-1":
        raise ValueError("it is framed as in FRI 2.7; choose version = 'iiwa-2'")
    fields = read_fields(message)
    header, link = read_fields(read_message(fields, 1)), read_fields(read_message(fields, 4))
    robot, ipo = read_fields(read_message(fields, 2)), read_fields(read_message(fields, 5))
    monitor = read_fields(read_message(fields, 3))
    if 1 not in header or 2 not in header:
        raise ValueError("it has no header")
    joints = read_whole(robot, 1)
    if joints not in (UNKNOWN, JOINTS):
        raise ValueError(f"found {joints} joints; expected {JOINTS}")
    time = read_fields(read_message(monitor, 15))
    timestamp = math.nan
    if 1 in time:
        timestamp = read_whole(time, 1, 0, 2**32 - 1) + 1e-9 * read_whole(
            {2: [0], **time}, 2, 0, 10**9
        )
    period = read_whole(link, 3, high=10**6)
    drives = [value if isinstance(value, int) else -1 for value in robot.get(5, [])][:JOINTS]
    if robot.get(5) and isinstance(robot[5][0], bytes):  # packed
        drives = [*robot[5][0]][:JOINTS]
    packed = struct.pack(
        _PACKING,
        *(read_whole({3: [0], **header}, number, 0, 2**32 - 1) for number in (1, 2, 3)),
        timestamp,
        math.nan if period == UNKNOWN else period / 1e3,
        read_whole(link, 4, high=2**31 - 1),
        *(read_whole(link, 1), read_whole(link, 2)),
        *(
            read_whole(robot, 7),
            read_whole(robot, 2),
            read_whole(robot, 6),
            read_whole(ipo, 10),
            read_whole(ipo, 11),
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
    """The packets that monitoring messages of an iiwa are turned into.

    Angles are in rad, torques in Nm, `measurement_cycle` in s; `tcp_moment` is sent as A, B, C and
    returned as x, y, z. What a message leaves out is NaN, states are -1.

    Args:
        version: of FRI: `iiwa-1` or `iiwa-2`.
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
            return f"{length} bytes that are no {self.message}: it is too long"
        try:
            pack(packet, self.version)
        except ValueError as error:
            return f"{length} bytes that are no {self.message}: {error}"
        return f"{length} bytes that are no {self.message}"

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        return float(values["state"][0]), float(values["quality"][0])

    def link_words(self, state: float, quality: float) -> tuple[str, str]:
        return word(STATES, state), word(QUALITIES, quality)

    def is_good(self, state: float, quality: float) -> bool:
        """Whether a controller's state and quality need no warning."""
        return state > 0 and word(QUALITIES, quality) in ("good", "excellent")

    def describe(self, values: Mapping[str, Array]) -> str:
        """What a packet says of the robot's controller, in words."""
        drives = values["drives"]
        drive = drives[0] if (drives == drives[0]).all() else 1.0  # as KUKA's client has it
        said = [
            word(STATES, values["state"][0]),
            f"quality {word(QUALITIES, values['quality'][0])}",
            word(CONTROLS, values["control"][0]),
            word(DRIVES, drive),
            word(SAFETIES, values["safety"][0]),
            word(COMMANDS, values["command_mode"][0]),
        ]
        return ", ".join(text for text in said if text)


def word(words: Sequence[str], number: float) -> str:
    """The word for a state; the number itself if there is none, "unknown" for `UNKNOWN`."""
    if number == UNKNOWN:
        return "unknown" if words in (STATES, QUALITIES) else ""
    return words[int(number)] if 0 <= number < len(words) else f"{number:.0f}"


class Monitor:
    """Answers monitoring messages without a command, as a client that only monitors does.

    An answer is a header and nothing else. Messages of a controller that waits for commands, or
    follows them, are not answered: such an answer would have to hold a command.
    """

    def __init__(self) -> None:
        self._unanswered = 0

    def answer(self, packet: bytes, counter: int) -> bytes | None:
        """The answer to a message, or None if none is due."""
        try:
            message, is_framed = unframed(packet)
            fields = read_fields(message)
            header, link = (
                read_fields(read_message(fields, 1)),
                read_fields(read_message(fields, 4)),
            )
            sent, state = read_whole(header, 2, 0, 2**32 - 1), read_whole(link, 1)
            every = read_whole(link, 4, high=2**31 - 1)
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
    """A command message that commands nothing: its header alone.

    Args:
        counter: of the messages sent before, uint32.
        reflected: `send_counter` of the message that is answered.
    """
    return inner(1, whole(1, COMMAND_ID), whole(2, counter), whole(3, reflected))


def framed(message: bytes) -> bytes:
    """A message with its length before and its checksum behind it, as FRI 2.7 has it."""
    return struct.pack("<I", len(message)) + message + struct.pack("<I", zlib.crc32(message))


def whole(number: int, value: int) -> bytes:
    """A field with a whole number."""
    return bytes((number << 3,)) + _encoded(value)


def double(number: int, value: float) -> bytes:
    """A field with a float64."""
    return bytes((number << 3 | 1,)) + _DOUBLE.pack(value)


def inner(number: int, *fields: bytes) -> bytes:
    """A field with a message of fields."""
    message = b"".join(fields)
    return bytes((number << 3 | 2,)) + _encoded(len(message)) + message


def per_joint(number: int, values: Array) -> bytes:
    """A field with a message of one list, that of all joints, (7,)."""
    return inner(number, _TAGGED.pack(*(x for value in values.tolist() for x in (9, value))))


@lru_cache(maxsize=1024)
def _encoded(value: int) -> bytes:
    groups = []
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*groups, value))
