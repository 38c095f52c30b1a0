"""Checksums of packets: values, encoding, and handling of corrupted packets."""

from __future__ import annotations

import binascii
import socket
import struct
import zlib

import numpy as np
import pytest
from conftest import raises_with
from polling import until
from shm_tools import block, needs_posix

from sero_mj.base.errors import StructureError
from sero_mj.data.receive.checksum import CRCS, Crc, compute, width_of
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.data.send.sender import PacketBuffer, ShmWriter
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.external_control.exchange import Answer, State

__all__ = ["block"]  # a fixture
CHECK = "expected a number, the word size or a checksum, for example 1H=0x2006 or 1H=CRC-16/MODBUS"
LENGTHS = (1, 3, 9, 255, 256, 257, 600)  # around the blocks that are looked up


def rows_of(*packets: bytes) -> np.ndarray:
    return np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)


def bit_by_bit(crc: Crc, message: bytes) -> int:
    """The textbook shift register, one bit at a time."""
    register = crc.init
    for byte in message:
        bits = f"{byte:08b}"
        for bit in bits[::-1] if crc.is_reflected else bits:
            is_out = (register >> (crc.width - 1)) ^ int(bit)
            register = (register << 1) % 2**crc.width ^ (crc.poly if is_out else 0)
    if crc.is_reflected:
        register = int(f"{register:0{crc.width}b}"[::-1], 2)
    return register ^ crc.xorout


@pytest.mark.parametrize("name", CRCS)
def test_crc_has_the_check_value_of_the_catalog(name: str) -> None:
    crc = CRCS[name]
    assert compute(name, rows_of(b"123456789"), crc.width).tolist() == [crc.check]
    for length in LENGTHS:
        messages = [np.random.default_rng(k).bytes(length) for k in range(2)]
        expected = [bit_by_bit(crc, message) for message in messages]
        assert compute(name, rows_of(*messages), crc.width).tolist() == expected


@pytest.mark.parametrize("length", [*LENGTHS, 5000])
def test_checksums_equal_those_of_the_standard_library(length: int) -> None:
    message = np.random.default_rng(length).bytes(length)
    total = sum(message)
    found = {name: int(compute(name, rows_of(message), width_of(name) or 16)[0])
             for name in ("CRC-32/ISO-HDLC", "CRC-16/XMODEM", "CRC-16/IBM-3740", "sum", "-sum",
                          "~sum", "xor")}  # fmt: skip
    assert found == {
        "CRC-32/ISO-HDLC": zlib.crc32(message),
        "CRC-16/XMODEM": binascii.crc_hqx(message, 0),
        "CRC-16/IBM-3740": binascii.crc_hqx(message, 0xFFFF),
        "sum": total % 65536,
        "-sum": -total % 65536,
        "~sum": ~total % 65536,
        "xor": int(np.bitwise_xor.reduce(np.frombuffer(message, np.uint8))),
    }


@pytest.mark.parametrize(
    ("text", "covered", "wanted"),
    [
        ("2f 1H=CRC-16/MODBUS", slice(0, 8), "CRC-16/MODBUS"),
        ("2f >1H=crc-16/ccitt-false", slice(0, 8), "CRC-16/IBM-3740"),
        ("2B 2f check:1I=CRC-32[2:]", slice(2, 10), "CRC-32/ISO-HDLC"),
        ("1B=xor[1:] 2f", slice(1, 9), "xor"),
        ("1B=sum[3:5] 2f 1h", slice(3, 5), "sum"),
        ("2f 1B=-sum 1x", slice(0, 8), "-sum"),
        ("2f 1B=sum 1H=CRC-16/ARC", slice(0, 9), "CRC-16/ARC"),
        ("1H=~sum[0:10] 2f", slice(2, 10), "~sum"),  # the bytes of the checksum count as 0
    ],
)
def test_encoded_packet_has_the_checksum_that_the_receiver_expects(
    text: str, covered: slice, wanted: str
) -> None:
    structure = Structure(text, is_double=False)
    event = next(iter(structure.events))
    values = {each: np.ones(shape) for each, shape in structure.events.items()}
    packet = structure.encode({**values, event: values[event] * 3})
    item = structure.checksums[-1]
    found = np.frombuffer(packet, item.dtype, 1, item.offset)[0]
    assert found == compute(wanted, rows_of(packet[covered]), 8 * item.item_bytes)[0]
    assert not structure.find_wrong_checksums(rows_of(packet)).any()
    assert structure.describe_wrong_checksum(rows_of(packet)) == ""
    for byte in range(*covered.indices(len(packet))):
        changed = bytearray(packet)
        changed[byte] ^= 0x20
        assert structure.find_wrong_checksums(rows_of(bytes(changed))).tolist() == [True]


def test_checksum_in_the_other_byte_order_is_described() -> None:
    sent = Structure("2F >1H=CRC-16/MODBUS").encode({"values0": [1, 2]})
    found = Structure("2F 1H=CRC-16/MODBUS").describe_wrong_checksum(rows_of(sent))
    assert found.startswith("CRC-16/MODBUS of bytes 0 to 15 is 0x")
    assert found.endswith("is '>' missing in the structure?")


@pytest.mark.parametrize(
    ("text", "character", "reason"),
    [
        ("7F 1I=CRC-16/ARC", 7,
         "a checksum is one unsigned number of 16 bits; expected 1H=CRC-16/ARC"),
        ("7F 2H=sum", 7, "a checksum is one unsigned number; expected 1H=sum"),
        ("7F 1b=xor", 7, "a checksum is one unsigned number of 8 bits; expected 1B=xor"),
        ("7F 1H=modbus", 7, f"{CHECK}; did you mean 'CRC-16/MODBUS'?"),
        ("7F 1B=sum[50:99]", 7,
         "the checksum covers the bytes 50 to 98; expected a range within 0 to 56"),
        ("1B=sum[1:] 7F 1B=xor", 4, "the checksum covers a later checksum"),
        ("7F 1H=CRC-16/ARC[0]", 17,
         "expected a count and F, V, M, T, x or a type, for example 7F1M"),
    ],
)  # fmt: skip
def test_error_in_a_checksum_declaration_points_to_its_position(
    text: str, character: int, reason: str
) -> None:
    with raises_with(StructureError, position=character - 1, reason=reason):
        Structure(text)


def test_corrupted_packet_is_counted_and_not_applied() -> None:
    structure = Structure("n:1I 7F 1H=CRC-16/MODBUS")
    packets = [bytearray(structure.encode({"n": k, "values0": np.full(7, k)})) for k in range(3)]
    packets[1][9] ^= 1
    with (
        UdpReceiver(structure=structure.text, sequence="n") as receiver,
        socket.socket(type=socket.SOCK_DGRAM) as sock,
    ):
        for packet in packets:
            sock.sendto(packet, ("127.0.0.1", receiver.port))
        assert until(lambda: receiver.counters.received == 3)
        counters, latest = receiver.counters, receiver.latest()
        assert (counters.wrong_checksum, counters.malformed, counters.lost) == (1, 1, 1)
        assert receiver.receive_trigger == 2
        assert latest is not None and latest.values["values0"][0] == 2
        told = {cause: (count, why) for cause, count, why in describe(report(receiver))}
    assert told["wrong_checksum"] == ("1", "corrupted: wrong checksum")
    assert told["last fault"][1].startswith("CRC-16/MODBUS of bytes 0 to 59 is 0x")


@needs_posix
def test_checksum_covers_data_read_from_shared_memory(block: str) -> None:
    reader = ShmReader(block=block, structure="lock:1Q v:2d 1I=CRC-32", lock="lock")
    with ShmWriter(block, reader.layout, "lock") as writer, reader:
        for k in (1, 2):
            writer.put(reader.layout.encode({"v": [k, -k]}))
            packet = reader.latest()
            assert packet is not None and packet.values["v"].tolist() == [k, -k]
        assert reader.counters.malformed == 0


def test_precomputed_packets_have_checksums_of_their_counters_and_times() -> None:
    structure = Structure("n:1H t:1d 2F 1I=CRC-32")

    def at(t: float) -> bytes:
        return structure.encode({"values0": [t, -t]})

    ahead = PacketBuffer(at, structure, rate=4000, sequence="n", time="t")
    packets = rows_of(*(ahead.at(k / 4000) for k in range(9)))
    assert structure.decode_rows(packets)["n"].ravel().tolist() == [*range(1, 10)]
    assert not structure.find_wrong_checksums(packets).any()


def test_controller_states_and_answers_have_checksums() -> None:
    model = RobotModel.of(SerialRobot.from_model("lwr"))
    state = State("step:1I angles:7d 1I=CRC-32", model)
    state.fill(3, Sensed(7), Target(7))
    body, (check,) = bytes(state.packet[:-4]), struct.unpack("<I", state.packet[-4:])
    assert check == zlib.crc32(body)
    answer = Answer("torques:7d 1I=CRC-32", model, None, None)
    answer.incoming[:-1] = answer.structure.encode({"torques": np.ones(7)})
    assert answer.wrong_checksum == ""
    answer.incoming[3] ^= 1
    assert answer.wrong_checksum.startswith("CRC-32/ISO-HDLC of bytes 0 to 55 is")
