"""Writers of shared memory: the examples, `ShmWriter`, killed writers, and hostile writers."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, examples, raises_with
from polling import until
from shm_tools import block, compile_c, make, needs_posix, remove, unlink

from sero_mj.base.errors import SourceError
from sero_mj.base.paths import find_scene
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.receive.shm_block import Block
from sero_mj.data.receive.structure import Structure
from sero_mj.data.send.sender import ShmWriter
from sero_mj.load import load_scene
from sero_mj.viewer.decor.staleness import Staleness

__all__ = ["block"]  # a fixture
pytestmark = needs_posix
SCENES = ROOT / "scenes"
PACKET = "lock:1Q count:1Q v:30d"


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("programs")
    sources = {
        "example": SCENES / "lwr_shm_writer.c",
        "hostile": Path(__file__).parent / "shm_hostile.c",
    }
    return {name: compile_c(source, folder) for name, source in sources.items()}


@pytest.fixture
def running() -> Iterator[Any]:
    """Starts programs, and finally ends the running ones."""
    started: list[subprocess.Popen[str]] = []

    def start(*command: str | Path) -> subprocess.Popen[str]:
        started.append(subprocess.Popen(list(command), stdout=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def shipped_reader(block: str) -> ShmReader:
    fields = dict(load_scene(find_scene("lwr_shm")).sources["robot"])
    fields.pop("kind")
    return ShmReader(**{**fields, "block": block})


def check_motion(reader: ShmReader) -> None:
    """Checks that packets have the motion of both examples."""
    assert reader.wait(20.0), reader.trouble
    assert until(lambda: reader.receive_trigger > 50, seconds=20.0)
    packet = reader.latest()
    assert packet is not None
    angles, torques = packet.values["angles"], packet.values["torques"]
    t = np.arctan2(angles[0] / 0.6, torques[0] / 20.0)
    np.testing.assert_allclose(angles, 0.6 * np.sin(t + np.arange(7)), atol=1e-9)
    np.testing.assert_allclose(torques, 20.0 * np.cos(t + np.arange(7)), atol=1e-9)
    assert reader.counters.malformed == reader.counters.wrong_size  # the previous contents


def test_c_example_is_read_and_replaced_after_a_kill(
    programs: dict[str, Path], running: Any, block: str
) -> None:
    with shipped_reader(block) as reader:
        for _ in range(2):
            number = reader.receive_trigger
            writer = running(programs["example"], block, "60")
            assert until(lambda number=number: reader.receive_trigger > number, seconds=20.0)
            check_motion(reader)
            writer.kill()
            writer.wait()
            assert until(lambda: not reader.receiving)
        assert reader.counters.restarts == 0  # the block is the same
    unlink(block)


def test_c_example_exits_and_removes_its_block(programs: dict[str, Path], block: str) -> None:
    subprocess.run([programs["example"], block, "0.02"], check=True, timeout=20.0)


def test_python_example_is_read_and_recreates_the_block(running: Any, block: str) -> None:
    script = SCENES / "lwr_shm_writer.py"
    left = make(block, bytes(10))  # by a writer that was killed, with another structure
    left.close()
    with shipped_reader(block) as reader:
        writer = running(sys.executable, "-W", "error", script, block, "60")
        check_motion(reader)
        assert reader.counters.restarts == 1
        writer.send_signal(signal.SIGINT)
        assert writer.wait(timeout=20.0) == 0
        assert until(lambda: reader.trouble == f"shared memory {block} is gone")


def test_shared_memory_moves_the_shipped_scene(block: str) -> None:
    scene = load_scene(find_scene("lwr_shm"))
    scene.sources["robot"] = {**scene.sources["robot"], "block": block}
    with Mirror(scene) as mirror:
        source = mirror.sources["robot"]
        with ShmWriter(block, source.layout, "lock") as writer:  # type: ignore[attr-defined]
            angles = np.linspace(-0.3, 0.3, 7)
            packet = {"angles": angles, "torques": np.ones(7)}
            writer.put(source.layout.encode(packet))  # type: ignore[attr-defined]
            assert mirror.wait(5.0) == []
            assert mirror.advance()
            qpos = mirror.data.qpos[mirror.world.robots["lwr"].qpos]
            np.testing.assert_array_equal(qpos, angles)
            for _ in range(20):  # a read during the update is allowed
                writer.put(source.layout.encode(packet))  # type: ignore[attr-defined]
                assert mirror.advance()
                assert Staleness(mirror.world).find(mirror.data) == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "pause", "between", "settle", "fields"),
    [
        ("lock", 0, 0, 2e-5, {"lock": "lock"}),
        ("lock", 0, 30, 2e-5, {"lock": "lock"}),
        ("lock", 300, 300, 2e-5, {"lock": "lock"}),
        ("first", 0, 100, 2e-5, {"sequence": "count"}),
        ("last", 0, 100, 2e-5, {"sequence": "count"}),
        ("first", 2000, 12000, 5e-3, {"sequence": "count"}),
        ("last", 2000, 12000, 5e-3, {"sequence": "count"}),
        ("none", 0, 100, 2e-5, {}),
        ("none", 2000, 12000, 5e-3, {}),
        ("none", 0, 0, 2e-5, {}),
    ],
)
def test_torn_packets_are_never_applied(
    programs: dict[str, Path],
    running: Any,
    block: str,
    mode: str,
    pause: int,
    between: int,
    settle: float,
    fields: dict[str, str],
) -> None:
    torn: list[int] = []
    good: list[int] = []

    def look(rows: np.ndarray, lengths: np.ndarray, arrivals: np.ndarray) -> None:
        values = rows[:, 16:].view("<f8")
        counts = rows[:, 8:16].view("<u8")[:, 0]
        same = (values == values[:, :1]).all(axis=1)
        same &= counts == values[:, 0] if fields else True  # otherwise, the count is a plain value
        torn.extend(counts[~same].tolist())
        good.extend(counts[same].tolist())

    reader = ShmReader(block=block, structure=PACKET, settle=settle, poll_rate=1e4, **fields)
    reader.record_to(look)
    command = [programs["hostile"], block, mode, str(pause), str(between), str(settle * 1e6)]
    writer = running(*command)
    assert until(lambda: exists(block))
    reads = 0
    with reader:
        packets = reader._packets
        begin = time.monotonic()
        # On a busy machine, it can take longer to observe a continuous writer during a write.
        while (gone := time.monotonic() - begin) < 20.0:
            reader.latest()
            reads += 1
            if gone > max(0.1 * examples(20), 1.2) and (between or reader.counters.torn):
                break
    writer.terminate()
    written, held_up = map(int, writer.communicate(timeout=20.0)[0].split())
    unlink(block)
    assert packets is not None and reads > 200 and written > 50
    # Without a lock, an interruption of the writer during a packet cannot be detected.
    assert len(torn) <= (0 if mode == "lock" else held_up), (torn, held_up)
    if between:
        assert len(good) > 20
        assert good == sorted(set(good))
    else:  # continuous writing is reported
        assert reader.counters.torn > 0


def exists(block: str) -> bool:
    try:
        found = Block(block)
    except FileNotFoundError:
        return False
    size = found.size
    found.close()
    return size > 0


def test_writer_killed_during_a_write_is_replaced(
    programs: dict[str, Path], running: Any, block: str
) -> None:
    reader = ShmReader(block=block, structure=PACKET, lock="lock")
    with reader:
        # The writer stops during its first packet.
        writer = running(programs["hostile"], block, "lock", "1e9", "0", "0")
        assert until(lambda: "'lock' is odd" in reader.trouble, seconds=20.0)
        writer.kill()
        writer.wait()
        assert (reader.latest(), reader.receiving, reader.counters.torn) == (None, False, 1)
        running(programs["hostile"], block, "lock", "10", "500", "0")
        assert reader.wait(20.0)
        assert until(lambda: reader.receive_trigger > 20)
        packet = reader.latest()
        assert packet is not None
        assert (packet.values["v"] == packet.values["count"]).all()
    unlink(block)


def test_writer_continues_the_lock_of_a_dead_writer(block: str) -> None:
    made = make(block, struct.pack("<Qd", 7, 0.5))
    structure = Structure("lock:1Q v:1d")
    with ShmWriter(block, structure, "lock") as writer:
        writer.put(struct.pack("<Qd", 99, 1.5))
        assert struct.unpack("<Qd", made.read(16)) == (8, 1.5)
        writer.put(struct.pack("<Qd", 99, 2.5))
        assert struct.unpack("<Qd", made.read(16)) == (10, 2.5)
        with raises_with(found=3):
            writer.put(b"abc")
    assert exists(block)  # because the writer did not create it
    remove(made)


def test_writer_enlarges_blocks_and_removes_those_it_created(block: str) -> None:
    structure = Structure("v:1d")
    with ShmWriter(block, structure, offset=100) as writer:
        writer.put(struct.pack("<d", 4.5))
        other = Block(block)
        assert (other.size, other.read(8, 100)) == (108, struct.pack("<d", 4.5))
        assert writer.place == f"shared memory {block}"
        other.close()
    assert not exists(block)
    small = make(block, bytes(4))
    with ShmWriter(block, structure):
        assert small.size == 8
    remove(small)


def test_writer_does_not_remove_blocks_of_others(block: str) -> None:
    with ShmWriter(block, Structure("v:1d")):
        unlink(block)
        other = make(block, bytes(8))
    assert exists(block)
    remove(other)


def test_invalid_use_of_the_writer_is_reported(block: str) -> None:
    with pytest.raises(ValueError, match="lock 'v' has 2 numbers"):
        ShmWriter(block, Structure("v:2d"), "v")
    if sys.platform == "linux":
        os.mkdir(f"/dev/shm{block}")
        with pytest.raises(SourceError, match=f"shared memory {block}: (Inv|Is a dir)"):
            ShmWriter(block, Structure("v:2d"))
        os.rmdir(f"/dev/shm{block}")


@pytest.mark.parametrize("options", [[], ["--rate", "3000"]])
def test_send_command_writes_shared_memory(running: Any, block: str, options: list[str]) -> None:
    command = [sys.executable, "-m", "sero_mj", "send", "lwr_shm", "--shm", block, *options]
    with shipped_reader(block) as reader:
        writer = running(*command)
        assert reader.wait(30.0)
        assert until(lambda: reader.receive_trigger > 100)
        writer.send_signal(signal.SIGINT)
        output = writer.communicate(timeout=20.0)[0]
        assert f"(120 bytes) to shared memory {block} at " in output
        assert "sent " in output
        assert reader.counters.malformed == 0
        assert until(lambda: reader.trouble == f"shared memory {block} is gone")
