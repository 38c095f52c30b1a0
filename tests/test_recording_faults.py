"""Truncated and damaged recordings, files of other programs, and full disks."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from recordings import begin, numbered, record

from sero_mj.base.errors import RecordingError, UnknownName
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_format import unpack_raw
from sero_mj.data.record.recording_writer import RecordingWriter


def test_unclosed_recording_is_complete_without_an_index(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    expected = record(path, numbered(50), chunk_bytes=400, close=False)
    with Recording(path) as recording:
        assert list(recording.packets("arm")) == expected
        assert recording.sources["arm"].count == 50
        assert len(recording.faults) == 1 and "was not closed" in recording.faults[0]
    with open(path, "rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 50
    with open(path, "rb") as file:
        assert len(list(NonSeekingReader(file).iter_messages())) == 50


@pytest.mark.slow
def test_truncated_recording_has_the_packets_before_the_cut(tmp_path: Path) -> None:
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    expected = record(path, numbered(12), chunk_bytes=150)
    whole = path.read_bytes()
    found_sizes = set()
    for size in range(len(whole)):
        cut.write_bytes(whole[:size])
        try:
            with Recording(cut) as recording:
                assert recording.faults
                found = list(recording.packets("arm")) if recording.sources else []
                assert not recording.sources or recording.sources["arm"].count == len(found)
        except RecordingError as error:
            assert str(cut) in str(error)
            continue
        assert found == expected[: len(found)]
        found_sizes.add(len(found))
    assert len(found_sizes) > 2 and max(found_sizes) == 12
    # The mcap library reads a file without an end up to the cut, and then raises an error.
    cut.write_bytes(whole[: len(whole) // 2])
    kinds = []
    with open(cut, "rb") as file, pytest.raises((McapError, struct.error, ValueError)):
        for found_record in StreamReader(file).records:
            kinds.append(type(found_record).__name__)
    assert "Message" in kinds


@settings(max_examples=examples(150), deadline=None)
@given(
    flips=st.lists(st.tuples(st.floats(0.0, 0.999999), st.integers(1, 255)), min_size=1, max_size=4)
)
def test_damage_never_creates_packets(
    tmp_path_factory: pytest.TempPathFactory, flips: list[tuple[float, int]]
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    expected = record(folder / "a.mcap", numbered(12), chunk_bytes=150)
    whole = bytearray((folder / "a.mcap").read_bytes())
    for share, flip in flips:
        whole[int(share * len(whole))] ^= flip
    (folder / "a.mcap").write_bytes(whole)
    try:
        recording = Recording(folder / "a.mcap")
    except RecordingError:
        return
    packets = {packet for _, packet in expected}
    with recording:
        for name in recording.sources:
            assert {packet for _, packet in recording.packets(name)} <= packets
            recording.last_before(name, 0.5)


def test_damaged_chunk_loses_only_its_own_packets(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    expected = record(path, numbered(60), chunk_bytes=400)
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[2]
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xFF
    path.write_bytes(data)
    with Recording(path) as recording:
        assert recording.faults == []
        found = list(recording.packets("arm"))
        lost = [packet for packet in expected if packet not in found]
        assert found == [packet for packet in expected if packet not in lost]
        assert 0 < len(lost) < 10
        list(recording.packets("arm"))
        (fault,) = recording.faults
        assert f"the chunk at byte {chunk.chunk_start_offset} is damaged" in fault
        assert f"from {lost[0][0]:.3f} s to {lost[-1][0]:.3f} s are missing" in fault
        before = expected[expected.index(lost[0]) - 1]
        assert recording.last_before("arm", lost[0][0]) == before


def foreign(path: Path) -> None:
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/camera/image", "ros1", 0)
        writer.add_message(channel, 1, b"x", 1)
        writer.finish()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is empty; expected a file from sero-mj record"),
        (b"time,a\n0,1\n", r"is not an MCAP file: it begins with b'time,a\\n0'"),
        (b"\x89MCAP0\r\n", "is truncated or damaged at byte 8 .*; expected a file from"),
    ],
)
def test_file_that_is_not_a_recording_is_rejected(
    tmp_path: Path, content: bytes, expected: str
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=f"^{path} {expected}"):
        Recording(path)


def test_file_of_another_program_is_rejected(tmp_path: Path) -> None:
    foreign(tmp_path / "a.mcap")
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/a.mcap",
        reason=(
            "is an MCAP file of another program with the topics /camera/image (ros1); "
            "expected a file from sero-mj record"
        ),
    ):
        Recording(tmp_path / "a.mcap")
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/b.mcap",
        reason="cannot be read: No such file or directory",
    ):
        Recording(tmp_path / "b.mcap")


def test_unwritable_file_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/a.mcap",
        reason="already exists. Choose another name, or remove it",
    ):
        RecordingWriter(path, about={})
    assert path.read_bytes() == b"precious"
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/no/a.mcap",
        reason="cannot be written: No such file or directory",
    ):
        RecordingWriter(tmp_path / "no" / "a.mcap", about={})
    with begin(path, "arm") as writer:
        with pytest.raises(ValueError, match="the recording already has a source 'arm'"):
            writer.add_source("arm", kind="udp", declared={}, events={}, size=0)
        with raises_with(UnknownName, kind="source", name="leg"):
            writer.write_raw("leg", b"", 0.0)
        with pytest.raises(TypeError, match="not JSON serializable"):
            writer.add_source("leg", kind="udp", declared={"a": object()}, events={}, size=0)


FILL = """
import random, resource, sys
from recordings import begin
from sero_mj.base.errors import RecordingError
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
packets = [random.Random(i).randbytes(100) for i in range(1000)]
for limit in map(int, sys.argv[3:]):
    writer = begin(f"{sys.argv[1]}/{limit}.mcap", "arm", chunk_bytes=int(sys.argv[2]))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))  # Python ignores SIGXFSZ
    reported = []
    for i, packet in enumerate(packets):
        try:
            writer.write_raw("arm", packet, i / 10)
        except RecordingError as error:
            reported.append(str(error))
    writer.close()
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    print(len(set(reported)), writer.size, reported[0])
"""


@pytest.mark.slow
@pytest.mark.parametrize("chunk_bytes", [4000, 200])
def test_full_disk_ends_the_recording_and_leaves_a_readable_file(
    tmp_path: Path, chunk_bytes: int
) -> None:
    limits = range(12000, 22000, 307)
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(tmp_path), str(chunk_bytes), *map(str, limits)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        cwd=Path(__file__).parent,
    )
    for limit, line in zip(limits, done.stdout.splitlines(), strict=True):
        path = tmp_path / f"{limit}.mcap"
        assert limit - 2 * chunk_bytes - 1000 < path.stat().st_size <= limit
        with open(path, "rb") as file:
            messages = list(make_reader(file, validate_crcs=True).iter_messages())
        packets = [random.Random(i).randbytes(100) for i in range(len(messages))]
        assert [unpack_raw(message.data) for _, _, message in messages] == packets != []
        with Recording(path) as recording:
            assert [packet for _, packet in recording.packets("arm")] == packets
            assert len(recording.faults) == 1 and "was not closed" in recording.faults[0]
        assert line.startswith(
            f"1 {path.stat().st_size} {path}: the file has reached the maximum size of the "
            f"system. The recording has ended; it has {len(messages)} packets over "
        )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_full_disk_at_the_start_is_reported() -> None:
    expected = "/dev/full: no space left on the disk. The recording has ended; it has no packets"
    with pytest.raises(RecordingError, match=expected):
        RecordingWriter("/dev/full", about={}, overwrite=True)
