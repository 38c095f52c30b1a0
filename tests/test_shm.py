"""`ShmReader` on real shared memory: applied packets, and reasons why none are applied."""

from __future__ import annotations

import logging
import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from polling import until
from shm_tools import block, make, needs_posix, remove

from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive import shm, shm_block
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.receive.shm_block import Block
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.replay import Replay
from sero_mj.data.send.sender import ShmWriter

__all__ = ["block"]  # a fixture
pytestmark = needs_posix
LINUX = sys.platform == "linux"
LOCKED: dict[str, Any] = {"structure": "lock:1Q v:2d", "lock": "lock"}


@pytest.fixture(autouse=True)
def patient_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reads the latest values; waits if the receiving thread is delayed during a read."""
    monkeypatch.setattr(shm, "_LOCK_TIMEOUT", 5.0)


def locked(lock: int, *values: float) -> bytes:
    return struct.pack("<Q2d", lock, *values)


def shown(reader: ShmReader, event: str = "v") -> list[float] | None:
    packet = reader.latest()
    return None if packet is None else packet.values[event].tolist()


def test_latest_reads_a_packet_immediately_after_it_is_written(block: str) -> None:
    reader = ShmReader(block=block, poll_rate=1.0, **LOCKED)
    with ShmWriter(block, reader.layout, "lock") as writer, reader:
        assert reader.latest() is None
        for k in range(1, 4):  # polling once per second would find only one
            before = time.monotonic()
            writer.put(locked(0, k, -k))
            packet = reader.latest()
            assert packet is not None and packet.number == k
            assert packet.values["v"].tolist() == [k, -k]
            assert packet.values["lock"].tolist() == [2 * k]
            assert before <= packet.arrival <= time.monotonic()
        assert reader.latest() is packet
        assert (reader.counters.received, reader.counters.torn, reader.trouble) == (3, 0, "")


def test_thread_receives_packets_and_calls_back(block: str) -> None:
    called: list[str] = []
    reader = ShmReader(block=block, name="r", **LOCKED)
    reader.on_receive(lambda: called.append(threading.current_thread().name))
    with ShmWriter(block, reader.layout, "lock") as writer, reader:
        writer.put(locked(0, 1, 2))
        assert reader.wait(5.0)
        assert until(lambda: called)
        writer.put(locked(0, 3, 4))
        assert shown(reader) == [3, 4]  # read by this thread, but called back by the other
        assert until(lambda: len(called) >= 2)
    assert set(called) == {"shm r"}


def test_lossless_reader_returns_all_packets(block: str) -> None:
    reader = ShmReader(block=block, only_latest_packet=False, sequence="n", structure="n:1I v:1d")
    seen: list[float] = []
    with ShmWriter(block, reader.layout) as writer, reader:
        for k in range(1, 200):
            writer.put(struct.pack("<Id", k, k))
            assert until(lambda k=k: reader.receive_trigger == k)
            if k % 50 == 0 or k == 199:
                packets = reader.take()
                assert packets is not None
                seen += packets.values["v"][:, 0].tolist()
        assert reader.take() is None
    assert seen == list(range(1, 200))
    assert (reader.counters.lost, reader.counters.duplicates) == (0, 0)


def test_missing_block_is_reported_and_opened_when_it_is_created(
    block: str, caplog: pytest.LogCaptureFixture
) -> None:
    with ShmReader(block=block.removeprefix("/"), **LOCKED) as reader:
        assert reader.about == f"shared memory {block}"
        assert reader.trouble == f"no shared memory {block} yet"
        assert not reader.wait(0.01)
        assert f"source 'shm': no shared memory {block} yet" in caplog.text
        made = Block(block, writable=True, create=True)
        assert until(lambda: reader.trouble == f"shared memory {block} has 0 bytes; expected 24")
        made.resize(24)
        assert until(lambda: "(24 bytes), but nothing has been written yet" in reader.trouble)
        made.write(locked(2, 5, 6))
        assert reader.wait(5.0)
        assert shown(reader) == [5, 6]
        counters = reader.counters
        assert (counters.received, counters.restarts, counters.wrong_size) == (1, 0, 0)
        remove(made)
        assert until(lambda: reader.trouble == f"shared memory {block} is gone")
        assert shown(reader) == [5, 6]


def test_recreated_block_is_opened_quickly(block: str) -> None:
    structure = "n:1I v:1d"
    with ShmReader(block=block, structure=structure, sequence="n") as reader:
        for life in range(1, 4):
            made = make(block, struct.pack("<Id", 1, life))  # each writer counts from 1
            born = time.monotonic()
            assert until(lambda life=life: shown(reader) == [life])
            assert time.monotonic() - born < 1.0  # 20 ms on an idle machine
            counters = reader.counters
            assert (counters.restarts, counters.late, counters.duplicates) == (life - 1, 0, 0)
            remove(made)


@pytest.mark.skipif(not LINUX, reason="blocks are files on Linux only")
def test_replaced_block_is_detected(block: str) -> None:
    first, second = make(block, locked(2, 1, 1)), make(f"{block}_b", locked(2, 2, 2))
    with ShmReader(block=block, **LOCKED) as reader:
        assert until(lambda: shown(reader) == [1, 1])
        os.rename(f"/dev/shm{block}_b", f"/dev/shm{block}")
        assert until(lambda: shown(reader) == [2, 2])
        assert reader.counters.restarts == 1
    first.close()
    second.path = first.path
    remove(second)


def test_shrunk_block_is_reported_and_read_again_when_it_grows(block: str) -> None:
    made = make(block, locked(2, 1, 2))
    with ShmReader(block=block, **LOCKED) as reader:
        assert until(lambda: shown(reader) == [1, 2])
        counters = reader.counters
        for size in (17, 3):
            made.resize(size)
            assert until(lambda size=size: counters.last_size == size)
            assert counters.last_fault == f"{size} bytes; expected 24"
            assert reader.trouble == f"shared memory {block} has {size} bytes; expected 24"
        assert shown(reader) == [1, 2]
        assert (counters.received, counters.wrong_size) == (3, 2)
        made.resize(5000)  # larger than necessary, as on systems that round to pages
        made.write(locked(4, 3, 4))
        assert until(lambda: shown(reader) == [3, 4])
        assert reader.trouble == ""
    remove(made)


def test_block_can_be_resized_while_it_is_read(block: str) -> None:
    made = make(block, locked(2, 1, 1))
    with ShmReader(block=block, poll_rate=1e4, **LOCKED) as reader:
        assert until(lambda: shown(reader) == [1, 1])
        for k in range(2, 2000):
            made.resize(k % 24)
            reader.latest()
            made.resize(24)
            made.write(locked(2 * k, k, k))
            assert shown(reader) == [k, k] or until(lambda k=k: shown(reader) == [k, k])
    remove(made)


def test_packet_is_read_at_an_offset(block: str) -> None:
    made = make(block, bytes(40) + locked(2, 7, 8))
    with ShmReader(block=block, offset=40, **LOCKED) as reader:
        assert until(lambda: shown(reader) == [7, 8])
        made.resize(48)
        assert until(lambda: reader.counters.last_fault == "8 bytes; expected 24")
        assert reader.trouble == f"shared memory {block} has 48 bytes; expected 64"
    remove(made)


def test_unchanged_bytes_are_not_a_new_packet(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = make(block, struct.pack("<d", 1.5))
    with ShmReader(block=block, structure="v:1d", poll_rate=1e4) as reader:
        assert until(lambda: shown(reader) == [1.5])
        assert reader.receiving
        made.write(struct.pack("<d", 1.5))
        monkeypatch.setattr("sero_mj.data.receive.reception.QUIET_AFTER", 0.0)
        assert not reader.receiving and reader.receive_trigger == 1
        made.write(bytes(8))  # 0 is a value, unless the block is new
        assert until(lambda: shown(reader) == [0.0])
    remove(made)


def test_unwritten_block_is_not_applied(block: str) -> None:
    made = make(block, bytes(24))
    with ShmReader(block=block, **LOCKED) as reader:
        assert until(lambda: reader.trouble)
        assert (
            reader.trouble
            == f"shared memory {block} exists (24 bytes), but nothing has been written yet"
        )
        made.write(locked(0, 1, 2))
        message = f"nothing has been written to shared memory {block}: 'lock' is 0"
        assert until(lambda: reader.trouble == message)
        assert reader.latest() is None
    remove(made)


def test_lock_that_stays_odd_or_unchanged_is_reported(block: str) -> None:
    made = make(block, locked(2, 1, 2))
    with ShmReader(block=block, **LOCKED) as reader:
        assert until(lambda: shown(reader) == [1, 2])
        made.write(locked(3, 9, 2))
        writer = f"the writer of shared memory {block}"
        message = f"{writer} stopped in the middle of a packet: 'lock' is odd"
        assert until(lambda: reader.trouble == message)
        assert (shown(reader), reader.counters.torn) == ([1, 2], 1)  # one write, one torn read
        made.write(locked(2, 9, 9))
        message = f"{writer} does not increase 'lock' for each packet"
        assert until(lambda: reader.trouble == message)
        assert shown(reader) == [1, 2]
        made.write(locked(6, 9, 9))
        assert until(lambda: shown(reader) == [9, 9])
        assert reader.trouble == ""
    remove(made)


def test_packet_is_applied_only_after_its_counter_has_changed(block: str) -> None:
    made = make(block, struct.pack("<Qd", 1, 1.0))
    with ShmReader(block=block, structure="n:1Q v:1d", sequence="n") as reader:
        assert until(lambda: shown(reader) == [1.0])
        made.write(struct.pack("<d", 2.0), 8)
        for _ in range(100):
            assert shown(reader) == [1.0]
        made.write(struct.pack("<Q", 2))
        assert until(lambda: shown(reader) == [2.0])
        assert reader.counters.duplicates == 0
    remove(made)


def test_packet_is_applied_after_the_settle_time(block: str) -> None:
    made = make(block, struct.pack("<2d", 1.0, 1.0))
    start = time.monotonic()  # the reader starts immediately
    with ShmReader(block=block, structure="v:2d", settle=0.3) as reader:
        assert until(lambda: shown(reader) == [1.0, 1.0])
        assert time.monotonic() - start >= 0.3
        made.write(struct.pack("<d", 2.0))
        looked = reader.receive_trigger
        assert until(lambda: reader.latest() and reader._packets._candidate[:8] != bytes(8))
        made.write(struct.pack("<d", 2.0), 8)
        assert until(lambda: reader.receive_trigger > looked)
        assert shown(reader) == [2.0, 2.0]
        assert reader.counters.torn == 1
    remove(made)


@pytest.mark.parametrize("kind", ["1B", "1i", "> 1H", "1d", "1f", "1q"])
def test_lock_can_have_any_type(block: str, kind: str) -> None:
    order, letter = kind.rpartition(" ")[0], kind[-1]
    structure = Structure(f"{order} lock:1{letter} v:1d".strip(), alignment=8)
    fields: dict[str, Any] = {"structure": structure.text, "lock": "lock", "alignment": 8}
    reader = ShmReader(block=block, poll_rate=1.0, **fields)
    with ShmWriter(block, structure, "lock") as writer, reader:
        for k in range(300):  # some types wrap
            writer.put(structure.encode({"v": [k + 1]}))
            assert shown(reader) == [k + 1]
        assert reader.counters.torn == 0


def test_block_is_mapped_if_shared_memory_is_not_a_file(
    block: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shm_block, "_PREAD", None)
    monkeypatch.setattr(shm_block, "_PWRITE", None)
    reader = ShmReader(block=block, poll_rate=1.0, **LOCKED)
    with ShmWriter(block, reader.layout, "lock") as writer, reader:
        for k in range(1, 10):
            writer.put(locked(0, k, k))
            assert shown(reader) == [k, k]
        writer._block.resize(3)
        assert shown(reader) == [9, 9]
        assert reader.counters.last_fault == "3 bytes; expected 24"
        with pytest.raises(OSError, match="the block has shrunk"):
            writer.put(locked(0, 1, 1))


def test_close_is_immediate_and_frees_all_resources(
    block: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    made = make(block, locked(2, 1, 2))
    reader = ShmReader(block=block, name="closing", poll_rate=1.0, debug_level=2, **LOCKED)
    reader.close()  # before it is open: harmless
    open_files = len(os.listdir("/proc/self/fd")) if LINUX else 0
    for _ in range(3):
        with reader:
            assert shown(reader) == [1, 2] or until(lambda: shown(reader) == [1, 2])
            start = time.monotonic()
        assert time.monotonic() - start < 0.5
        assert not [t for t in threading.enumerate() if t.name == "shm closing"]
        assert shown(reader) == [1, 2]  # the last packet remains available
    reader.close()
    assert not LINUX or len(os.listdir("/proc/self/fd")) == open_files
    assert f"source 'closing': reading shared memory {block}" in caplog.text
    remove(made)


def test_exiting_reader_does_not_remove_the_block(block: str) -> None:
    made = make(block, locked(2, 1, 2))
    code = (
        "from sero_mj import ShmReader\n"
        f"with ShmReader(block={block!r}, structure='lock:1Q v:2d', lock='lock') as reader:\n"
        "    assert reader.wait(10.0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    Block(block).close()
    remove(made)


def test_status_reports_why_no_packets_arrive(block: str) -> None:
    def reported(reader: ShmReader) -> str:
        return describe(report(reader))[0][2]

    with ShmReader(block=block, **LOCKED) as reader:
        assert reported(reader) == f"no valid packet yet: no shared memory {block} yet"
        made = make(block, bytes(16))
        about = f"no valid packet yet: shared memory {block}"
        assert until(lambda: reported(reader) == f"{about} has 16 bytes; expected 24")
        made.resize(24)
        assert until(
            lambda: (
                reported(reader) == f"{about} exists (24 bytes), but nothing has been written yet"
            )
        )
        made.write(locked(2, 5, 6))
        assert reader.wait(5.0)
        assert "jitter" in reported(reader)
        remove(made)
        gone = f": shared memory {block} is gone"
        assert until(lambda: "for" in reported(reader) and reported(reader).endswith(gone))


def test_recorded_shared_memory_is_replayed(block: str, tmp_path: Path) -> None:
    reader = ShmReader(name="arm", block=block, **LOCKED)
    with (
        ShmWriter(block, reader.layout, "lock") as writer,
        reader,
        record_sources({"arm": reader}, tmp_path / "arm.mcap"),
    ):
        writer.put(locked(0, 1.0, 2.0))
        assert reader.wait(5.0)
    with Replay(file=tmp_path / "arm.mcap") as replay:
        replay.advance_to(10.0)
        assert replay.latest().values["v"].tolist() == [1.0, 2.0]
