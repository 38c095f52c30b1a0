"""Recordings are read back by sero-mj, the mcap library and rosbags."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from recordings import DECLARED, EVENTS, begin, record, signals_in
from rosbags.highlevel import AnyReader

from sero_mj.base.errors import UnknownName
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_format import RecordingClock, unpack_raw
from sero_mj.data.record.recording_writer import SHORT_ENDING, RecordingWriter
from sero_mj.data.record.replay import Replay


def test_written_packets_and_attachments_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = begin(path, "arm", "hand")
    writer.attach("scene.toml", "application/toml", b"[robots.arm]\n")
    start = writer.clock.monotonic_ns / 1e9
    writer.write_raw("arm", b"one", start + 0.25)
    writer.write_raw("hand", b"", start + 0.3)
    writer.write_raw("arm", b"two", start + 0.5)
    writer.close()
    writer.close()
    with Recording(path) as recording:
        assert recording.faults == []
        assert recording.about == {"scene": "two arms"}
        assert recording.attachments == ("scene.toml",)
        assert recording.read_attachment("scene.toml") == b"[robots.arm]\n"
        assert abs(recording.start.timestamp() - time.time()) < 60.0
        assert recording.duration == pytest.approx(0.5, abs=1e-6)
        arm = recording.sources["arm"]
        assert (arm.name, arm.kind, arm.declared, arm.events) == ("arm", "udp", DECLARED, EVENTS)
        assert (arm.size, arm.count) == (168, 2)
        assert (arm.first, arm.last) == pytest.approx((0.25, 0.5), abs=1e-6)
        assert [data for _, data in recording.packets("arm")] == [b"one", b"two"]
        assert [data for _, data in recording.packets("hand")] == [b""]
        with raises_with(UnknownName, kind="source", name="arn", near="arm"):
            next(recording.packets("arn"))
        with raises_with(UnknownName, kind="file in the recording", name="robot.toml"):
            recording.read_attachment("robot.toml")


def test_source_without_packets_is_listed(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", [])
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.sources["arm"].count == 0
        assert math.isnan(recording.sources["arm"].first)
        assert recording.duration == 0.0
        assert list(recording.packets("arm")) == []
        assert recording.last_before("arm", 1.0) is None


@settings(max_examples=examples(40), deadline=None)
@given(
    packets=st.lists(
        st.tuples(st.sampled_from(["a", "b"]), st.binary(max_size=60), st.floats(-5.0, 1e5)),
        max_size=60,
    ),
    chunk_bytes=st.sampled_from([1, 200, 1 << 20]),
)
def test_arbitrary_packets_and_times_round_trip(
    tmp_path_factory: pytest.TempPathFactory,
    packets: list[tuple[str, bytes, float]],
    chunk_bytes: int,
) -> None:
    path = tmp_path_factory.mktemp("any") / "a.mcap"
    writer = begin(path, "a", "b", chunk_bytes=chunk_bytes)
    start = writer.clock.monotonic_ns / 1e9
    for name, packet, t in packets:
        writer.write_raw(name, packet, start + t)
    writer.close()
    with Recording(path) as recording:
        check_packets(recording, packets)


def check_packets(recording: Recording, packets: list[tuple[str, bytes, float]]) -> None:
    for name in ("a", "b"):
        came = [(packet, t) for source, packet, t in packets if source == name]
        found = list(recording.packets(name))
        assert [packet for _, packet in found] == [packet for packet, _ in came]
        assert [t for t, _ in found] == pytest.approx([t for _, t in came], abs=1e-6)
        assert recording.sources[name].count == len(came)
        times = [t for t, _ in found]
        for at in [*times, -10.0, 1e6]:
            newest = max((t for t in times if t <= at), default=None)
            expected = None if newest is None else [f for f in found if f[0] == newest][-1]
            assert recording.last_before(name, at) == expected
            assert list(recording.packets(name, at)) == [f for f in found if f[0] >= at]
            assert list(recording.packets(name, stop=at)) == [f for f in found if f[0] < at]


def test_times_are_exact_to_one_nanosecond() -> None:
    clock = RecordingClock(epoch_ns=1_700_000_000_123_456_789, monotonic_ns=5_000_000_001)
    assert clock.log_time(5.000000001) == clock.epoch_ns
    assert clock.log_time(5.000000002) == clock.epoch_ns + 1
    assert RecordingClock.from_metadata(clock.to_metadata()) == clock
    for arrival in (math.nan, math.inf):
        with raises_with(key="arrival", found=arrival, expected="seconds on time.monotonic"):
            clock.log_time(arrival)
    with pytest.raises(ValueError, match="before 1970"):
        clock.log_time(-1e10)


def test_mcap_library_reads_recordings(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = begin(path, "arm", chunk_bytes=2000)
    start = writer.clock.monotonic_ns / 1e9
    frame = np.eye(4)
    frame[:3, 3] = 1.0, 2.0, 3.0
    values = {
        "values0": np.array([0.1, math.nan]),
        "vectors0": np.array([[1.0, -2.0, math.inf]]),
        "matrices0": frame[None],
    }
    for i in range(100):
        writer.write_raw("arm", b"%d" % i, start + i)
        writer.write_signals("arm", values, start + i)
    writer.attach("scene.toml", "application/toml", b"x")
    writer.close()
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 200
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
        assert sorted(c.topic for c in summary.channels.values()) == ["/arm/raw", "/arm/signals"]
        assert [m.name for m in reader.iter_metadata()] == ["sero-mj", "about"]
        assert [a.data for a in reader.iter_attachments()] == [b"x"]
        raw = [message for _, _, message in reader.iter_messages(topics="/arm/raw")]
        assert [unpack_raw(message.data) for message in raw] == [b"%d" % i for i in range(100)]
        assert [message.sequence for message in raw] == list(range(100))
        assert raw[0].log_time == raw[0].publish_time == writer.clock.epoch_ns
    _, schema, found = signals_in(path, "/arm/signals")
    np.testing.assert_equal(found[0], {
        "values0": [0.1, math.nan],
        "vectors0": [{"x": 1.0, "y": -2.0, "z": math.inf}],
        "matrices0": [
            {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
        ],
    })  # fmt: skip
    assert schema.data.startswith(b"float64[2] values0\ngeometry_msgs/Point[1] vectors0\n")


def test_rosbags_and_ros2_bag_accept_recordings(tmp_path: Path) -> None:
    """All channels have a schema and the same encoding, which `ros2 bag` checks."""
    path = tmp_path / "a.mcap"
    writer = begin(path, "arm", "my-arm", "my_arm", "idle")
    start = writer.clock.monotonic_ns / 1e9
    values = {"values0": np.ones(2), "vectors0": np.ones((1, 3)), "matrices0": np.eye(4)[None]}
    for name in ("arm", "my-arm", "my_arm"):
        for i in range(5):
            writer.write_raw(name, b"%d" % i, start + i)
            writer.write_signals(name, values, start + i)
    writer.close()
    with AnyReader([path]) as reader:
        assert {each.ext.serialization_format for each in reader.connections} == {"cdr"}
        kinds = [each.msgtype for each in reader.connections]
        assert len(set(kinds)) == 1 + len(kinds) / 2 and "__schemaless__" not in kinds
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic.endswith("/raw"):
                assert bytes(message.data).isdigit()
            else:
                assert message.matrices0[0].rotation.tolist() == [1, 0, 0, 0, 1, 0, 0, 0, 1]
        counts = {each.topic: each.msgcount for each in reader.connections}
    assert counts["/my-arm/raw"] == counts["/my_arm/signals"] == 5


def test_chunk_is_flushed_after_less_than_half_a_second(tmp_path: Path) -> None:
    with begin(tmp_path / "a.mcap", "arm") as writer:
        assert writer.flush_if_old() == math.inf
        writer.write_raw("arm", b"x", time.monotonic())
        assert 0.0 < writer.flush_if_old() <= 0.4
    with RecordingWriter(tmp_path / "b.mcap", about={}, flush_after=0.0) as hasty:
        hasty.add_source("arm", kind="udp", declared={}, events={}, size=1)
        hasty.write_raw("arm", b"x", time.monotonic())
        assert hasty.flush_if_old() == math.inf
        with Recording(tmp_path / "b.mcap") as recording:  # while it is being written
            assert recording.sources["arm"].count == 1


def test_late_start_reads_only_a_small_part_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    packets = [np.random.default_rng(i).bytes(500) for i in range(4000)]
    expected = record(path, packets, chunk_bytes=10_000)
    read: list[int] = []
    with Recording(path) as recording:
        file = recording._file

        class Counting:
            def seek(self, at: int, whence: int = 0) -> int:
                return file.seek(at, whence)

            def read(self, count: int) -> bytes:
                read.append(count)
                return file.read(count)

        recording._file = Counting()  # type: ignore[assignment]
        late = expected[3900][0]
        assert next(recording.packets("arm", late)) == expected[3900]
        assert recording.last_before("arm", late + 0.01) == expected[3900]
        recording._file = file
    assert 0 < sum(read) < path.stat().st_size / 50


def test_write_rows_equals_write_raw_for_each_packet(tmp_path: Path) -> None:
    rows = np.random.default_rng(3).integers(0, 256, (5000, 168), np.uint8)
    files = [tmp_path / "one.mcap", tmp_path / "all.mcap"]
    found = []
    for file in files:
        with begin(file, "arm", chunk_bytes=100_000) as writer:
            arrivals = writer.clock.monotonic_ns / 1e9 + 0.001 * np.arange(len(rows))
            if file is files[0]:
                for row, arrival in zip(rows, arrivals.tolist(), strict=True):
                    writer.write_raw("arm", row.tobytes(), arrival)
            else:
                for first in range(0, 5000, 1700):
                    part = slice(first, first + 1700)
                    writer.write_rows("arm", rows[part], arrivals[part])
        with Recording(file) as recording:
            assert recording.faults == []
            found.append(list(recording.packets("arm")))
        with open(file, "rb") as stream:  # the mcap library reads the same
            messages = list(make_reader(stream).iter_messages(topics=["/arm/raw"]))
        assert [message.sequence for _, _, message in messages] == list(range(5000))
        assert b"".join(unpack_raw(each.data) for _, _, each in messages) == rows.tobytes()
    assert [packet for _, packet in found[0]] == [packet for _, packet in found[1]]
    times = np.array([[time for time, _ in each] for each in found])
    assert times[0] == pytest.approx(times[1], abs=2e-9)


def test_recording_of_the_first_version_is_read(tmp_path: Path) -> None:
    """Such recordings were not written by the mcap library, and their signals have no names."""
    path = Path(__file__).with_name("recording_format1.mcap")
    killed = tmp_path / "killed.mcap"  # a short ending instead of an index, as after a kill
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        last = summary.chunk_indexes[-1]
        end = last.chunk_start_offset + last.chunk_length + last.message_index_length
        file.seek(0)
        killed.write_bytes(file.read(end) + SHORT_ENDING)
    for each in (path, killed):
        with Recording(each) as recording:
            assert [fault for fault in recording.faults if "was not closed" not in fault] == []
            assert recording.about == {"scene": "two arms"}
            assert recording.read_attachment("scene.toml") == b"[robots.arm]\n"
            arm, hand = recording.sources["arm"], recording.sources["hand"]
            assert (arm.count, arm.first, arm.last) == pytest.approx((40, 0.0, 3.9), abs=1e-6)
            assert (hand.count, hand.declared) == (1, DECLARED)
            packets = [data for _, data in recording.packets("arm")]
        replay = Replay(file=each, source="arm")
        decoded = [replay.decode(packet) for packet in packets]
        assert [values["values0"].tolist() for values in decoded if values] == [
            [k / 10, 0.0] for k in range(40)
        ]
        with open(each, "rb") as file:
            found = [m.data for _, _, m in make_reader(file).iter_messages(topics="/arm/signals")]
        assert json.loads(found[3])["values0"] == [0.3, 0.0]


def test_one_hour_of_76_bytes_at_1_khz_is_less_than_one_gigabyte(tmp_path: Path) -> None:
    """This includes decoded values, noise in every number, and a chunk every 0.4 s."""
    structure, count = Structure("19F", is_double=False), 4000
    random, times = np.random.default_rng(0), np.arange(count) / 1000
    clean = np.sin(times[:, None] * np.arange(1, 20) / 3) * np.linspace(1, 40, 19)
    values = clean + random.normal(scale=0.05, size=clean.shape)
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, about={}) as writer:
        events = dict(structure.events)
        writer.add_source("udp", kind="udp", declared={}, events=events, size=76)
        arrivals = writer.clock.monotonic_ns / 1e9 + times + random.uniform(0, 5e-5, count)
        for k, (row, arrival) in enumerate(zip(values, arrivals.tolist(), strict=True)):
            packet = structure.encode({"values0": row})
            writer.write_raw("udp", packet, arrival)
            writer.write_signals("udp", structure.decode(packet), arrival)
            if k % 400 == 399:
                writer.flush()
    assert path.stat().st_size / count * 3.6e6 < 0.85e9
