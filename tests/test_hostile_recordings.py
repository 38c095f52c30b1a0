"""Malicious recordings: an error or a fault that reports what was found, quickly."""

from __future__ import annotations

import json
import re
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, DataEnd, Footer, McapRecord
from mcap.writer import MCAP0_MAGIC, Writer

from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.data.record.mcap_reader import MAX_CHUNK_BYTES
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.replay import Replay

DECLARATION = {
    "name": "arm",
    "kind": "udp",
    "declared": {"structure": "2F"},
    "events": {"values0": [2]},
    "size": 16,
}
PACKET = struct.pack("<2d", 0.25, -0.5)


def pack(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def make(path: Path, *chunks: Chunk, **declaration: Any) -> Path:
    """Writes a recording with two packets, then these chunks, which have no index."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        metadata = {"sero-mj": json.dumps({**DECLARATION, **declaration})}
        channel = writer.register_channel("/arm/raw", "application/octet-stream", 0, metadata)
        times = {"start_epoch_ns": "0", "start_monotonic_ns": "0"}
        writer.add_metadata("sero-mj", {"format": "1", **times})
        for i in range(2):
            writer.add_message(channel, i, PACKET, i)
        if not chunks:
            writer.finish()
            return path
        writer.flush()
        # The library writes channels into chunks; ours are also outside of them.
        record = next(iter(writer._Writer__channels.values()))  # type: ignore[attr-defined]
        file.write(pack(record))
        for chunk in chunks:
            file.write(pack(chunk))
        file.write(pack(DataEnd(0)) + pack(Footer(0, 0, 0)) + MCAP0_MAGIC)
    return path


def chunk_of(compression: str, data: bytes, size: int) -> Chunk:
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=5,
        message_end_time=9,
        uncompressed_crc=0,
        uncompressed_size=size,
    )


def unsized(size: int) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=False).compress(bytes(size))


ZEROS = 20 << 20
BOMBS: dict[str, tuple[Callable[[], Chunk], str]] = {
    "says its size": (
        lambda: chunk_of("zstd", unsized(1 << 30), 1 << 32),
        rf"{1 << 32} bytes when decompressed; expected at most {MAX_CHUNK_BYTES}",
    ),
    "frame says more": (
        lambda: chunk_of("zstd", zstandard.compress(bytes(1 << 30)), 100),
        rf"its data are {1 << 30} bytes when decompressed; it says 100",
    ),
    "frame does not say": (
        lambda: chunk_of("zstd", unsized(1 << 30), 100),
        "its data are more than 100 bytes when decompressed; it says 100",
    ),
    "lz4": (
        lambda: chunk_of("lz4", lz4.frame.compress(bytes(ZEROS)), 100),
        "its data are more than 100 bytes when decompressed; it says 100",
    ),
    "zeros": (
        lambda: chunk_of("zstd", zstandard.compress(bytes(ZEROS)), ZEROS),
        "record at byte 0 of its contents: found opcode 0",
    ),
    "too short": (
        lambda: chunk_of("zstd", zstandard.compress(b"\x80" * 9), 2000),
        "its data are 9 bytes when decompressed; it says 2000",
    ),
    "too long": (
        lambda: chunk_of("", struct.pack("<BQ", 5, 1 << 60), 9),
        rf"record at byte 0 of its contents: {1 << 60} bytes do not fit",
    ),
    "unknown": (
        lambda: chunk_of("xz", b"", 0),
        "compression 'xz'; expected zstd, lz4 or none",
    ),
}

READ = """
import resource, sys, time
from sero_mj.data.record.recording import Recording
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
begin = time.monotonic()
with Recording(sys.argv[1]) as recording:
    count = len(list(recording.packets("arm")))
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(count, time.monotonic() - begin, (after - before) / 1024)
print(*recording.faults, sep="\\n")
"""


@pytest.mark.parametrize("bomb", BOMBS)
def test_decompression_bomb_is_skipped(tmp_path: Path, bomb: str) -> None:
    make_chunk, expected = BOMBS[bomb]
    path = make(tmp_path / "a.mcap", make_chunk())
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    first, *faults = done.stdout.splitlines()
    count, seconds, megabytes = map(float, first.split())
    assert count == 2
    assert seconds < 2.0 and megabytes < 150.0
    assert any(re.search(rf"the chunk at byte \d+ is damaged \({expected}\)", f) for f in faults)


def test_many_small_bombs_take_little_memory_each(tmp_path: Path) -> None:
    bomb = chunk_of("zstd", zstandard.compress(bytes(MAX_CHUNK_BYTES)), MAX_CHUNK_BYTES)
    path = make(tmp_path / "a.mcap", *[bomb] * 5)
    begin, before = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with Recording(path) as recording:
        assert len(list(recording.packets("arm"))) == 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300 << 10
    assert time.monotonic() - begin < 10.0


@pytest.mark.parametrize(
    ("declaration", "expected"),
    [
        (
            {"kind": "upd"},
            "source 'arm': no kind 'upd'; did you mean 'udp'?",
        ),
        (
            {"kind": "replay"},
            "source 'arm': no kind 'replay'; available: foxglove, franka, fri, json, ros2, rtde, "
            "shm, udp, zenoh",
        ),
        ({"kind": "table"}, "source 'arm': no kind 'table'"),
        (
            {"declared": {"structre": "2F"}},
            "how source 'arm' is decoded: structure is required; "
            "structre: unknown key; did you mean 'structure'?",
        ),
        (
            {"events": {"values7": [2]}},
            "events of source 'arm': found values7 with shape (2,); expected no such event",
        ),
        (
            {"events": {"values0": [10**12]}},
            f"events of source 'arm': found values0 with shape ({10**12},); expected (2,)",
        ),
    ],
)
def test_wrong_declarations_in_a_recording_are_reported(
    tmp_path: Path, declaration: dict[str, Any], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make(tmp_path / "a.mcap", **declaration)
    with pytest.raises(DeclarationError, match=re.escape(f"source: {path}: {expected}")):
        Replay(file=path)
    with pytest.raises(SystemExit) as ended:
        main(["export", str(path), str(tmp_path / "a.csv")])
    assert ended.value.code == 2
    assert f"sero-mj: source: {path}: {expected}" in capsys.readouterr().err


def test_valid_recording_of_the_same_writer_is_read(tmp_path: Path) -> None:
    """This shows that the others are rejected for the right reason."""
    path = make(tmp_path / "a.mcap")
    assert Replay(file=path).decode(PACKET)["values0"].tolist() == [0.25, -0.5]  # type: ignore[index]
    with Recording(path) as recording:
        assert [data for _, data in recording.packets("arm")] == [PACKET] * 2
        assert recording.faults == []
