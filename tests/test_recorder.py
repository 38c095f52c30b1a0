"""`Recorder`: packets of several threads, bounded memory, a killed process, and a full disk."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from mcap.reader import make_reader
from polling import until
from recordings import signals_in

from sero_mj.base.errors import RecordingError, UnknownName
from sero_mj.data.receive.intake import pad_packets
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recorder import Recorder
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_format import unpack_raw

LAYOUT = Structure("2F1V")


def packet(i: int) -> bytes:
    return LAYOUT.encode({"values0": [i, i / 3], "vectors0": [[i, math.nan, -i]]})


def begin(path: Path, *names: str, decode: Any = LAYOUT.decode, **more: Any) -> Recorder:
    recorder = Recorder(path, about={"scene": "s"}, **more)
    for name in names or ("arm",):
        recorder.add_source(
            name,
            kind="udp",
            declared={"structure": LAYOUT.text},
            events=LAYOUT.events,
            size=LAYOUT.size,
            decode=decode,
        )
    return recorder


def give(recorder: Recorder, name: str, packets: list[bytes], arrivals: list[float]) -> bool:
    return recorder.take(name, *pad_packets(packets, LAYOUT.size), np.array(arrivals))


def packets_in(path: Path, name: str = "arm") -> list[bytes]:
    with Recording(path) as recording:
        assert recording.faults == []
        return [data for _, data in recording.packets(name)]


@pytest.fixture
def held() -> Iterator[threading.Event]:
    """Event on which the recorder's thread waits in its decoder."""
    event = threading.Event()
    yield event
    event.set()


def held_decoder(event: threading.Event, entered: threading.Event) -> Any:
    def decode(data: bytes) -> None:
        entered.set()
        event.wait()

    return decode


def test_packets_of_several_threads_are_recorded_in_order(tmp_path: Path) -> None:
    path, names = tmp_path / "a.mcap", ("one", "two", "three")

    def send(name: str) -> None:
        for i in range(0, 500, 5):
            now = time.monotonic()
            assert give(recorder, name, [packet(i + k) for k in range(5)], [now] * 5)

    with begin(path, *names) as recorder:
        recorder.attach("scene.toml", "application/toml", b"x")
        threads = [threading.Thread(target=send, args=[name]) for name in names]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for name in names:
        assert packets_in(path, name) == [packet(i) for i in range(500)]
    statistics = recorder.statistics
    assert (statistics.packets, statistics.bytes) == (1500, 1500 * LAYOUT.size)
    assert statistics.not_recorded == dict.fromkeys(names, 0)
    assert statistics.file_size == path.stat().st_size
    assert 0.0 < statistics.seconds < 60.0
    assert recorder.error is None


def test_rows_are_copied_and_truncated_to_their_lengths(tmp_path: Path) -> None:
    rows = np.arange(40, dtype=np.uint8).reshape(4, 10)
    lengths = np.array([10, 3, 0, 99])
    with begin(tmp_path / "a.mcap") as recorder:
        now = np.full(4, time.monotonic())
        recorder.take("arm", rows, lengths, now)
        rows[:] = 255
        recorder.take("arm", rows[:1], lengths[:1], now[:1])
        recorder.take("arm", rows[:0], lengths[:0], now[:0])
    assert packets_in(tmp_path / "a.mcap") == [
        bytes(range(10)),
        bytes([10, 11, 12]),
        b"",
        bytes(range(30, 40)),
        b"\xff" * 10,
    ]


def test_decoded_values_are_recorded_for_valid_packets(tmp_path: Path) -> None:
    now = time.monotonic()
    with begin(tmp_path / "a.mcap", signals_rate=1000.0) as recorder:
        give(recorder, "arm", [packet(3), b"short", packet(6)], [now, now, now])
    _, _, found = signals_in(tmp_path / "a.mcap", "/arm/signals")
    np.testing.assert_equal(found, {
        0: {"values0": [3.0, 1.0], "vectors0": [{"x": 3.0, "y": math.nan, "z": -3.0}]},
        2: {"values0": [6.0, 2.0], "vectors0": [{"x": 6.0, "y": math.nan, "z": -6.0}]},
    })  # fmt: skip
    assert recorder.statistics.signals == 2
    assert len(packets_in(tmp_path / "a.mcap")) == 3


@pytest.mark.parametrize(("rate", "batch"), [(1000.0, 1), (1000.0, 40), (100.0, 1), (50.0, 20)])
def test_signals_rate_limits_decoded_values_but_not_packets(
    tmp_path: Path, rate: float, batch: int
) -> None:
    now = time.monotonic()
    with begin(tmp_path / "a.mcap", signals_rate=rate) as recorder:
        for i in range(0, 2000, batch):  # two seconds at 1 kHz, in batches
            give(recorder, "arm", [packet(i)] * batch, [now + i / 1000] * batch)
    statistics = recorder.statistics
    assert statistics.packets == 2000
    assert 0.9 * 2.0 * rate <= statistics.signals <= 2.1 * rate + 1


@pytest.mark.parametrize(("rate", "expected"), [(0.0, 0), (math.inf, 200)])
def test_signals_rate_can_be_zero_or_infinite(tmp_path: Path, rate: float, expected: int) -> None:
    with begin(tmp_path / "a.mcap", signals_rate=rate) as recorder:
        give(recorder, "arm", [packet(0)] * 200, [time.monotonic()] * 200)
    assert recorder.statistics.signals == expected


def test_full_queue_counts_lost_packets(tmp_path: Path, held: threading.Event) -> None:
    entered = threading.Event()
    recorder = begin(tmp_path / "a.mcap", decode=held_decoder(held, entered), queue_bytes=20_000)
    try:
        give(recorder, "arm", [b"first"], [time.monotonic()])
        assert entered.wait(5.0)
        taken = [
            give(recorder, "arm", [bytes(1000)] * 2, [time.monotonic()] * 2) for _ in range(50)
        ]
        assert taken == [True] * sum(taken) + [False] * (50 - sum(taken))
        assert 7 <= sum(taken) <= 10  # 20 kB, in batches of two times 1,064 bytes
        lost = 2 * (50 - sum(taken))
        assert recorder.statistics.not_recorded == {"arm": lost}
    finally:
        held.set()
        recorder.close()
    assert recorder.statistics.packets == 1 + 2 * sum(taken)
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.lost == {"arm": lost}
        assert recording.faults == [f"{lost} packets of source 'arm' were lost"]
    assert not give(recorder, "arm", [b"late"], [time.monotonic()])
    assert recorder.statistics.not_recorded == {"arm": lost + 1}


def test_take_does_not_wait_for_the_disk(tmp_path: Path, held: threading.Event) -> None:
    entered = threading.Event()
    recorder = begin(tmp_path / "a.mcap", decode=held_decoder(held, entered))
    give(recorder, "arm", [b"first"], [time.monotonic()])
    assert entered.wait(5.0)
    # The writing thread is blocked, so waiting for it would never end.
    assert give(recorder, "arm", [b"second"], [time.monotonic()])
    assert recorder.statistics.packets == 1
    held.set()
    recorder.close()
    assert packets_in(tmp_path / "a.mcap") == [b"first", b"second"]


def test_invalid_calls_raise_errors(tmp_path: Path) -> None:
    with begin(tmp_path / "a.mcap") as recorder:
        with raises_with(UnknownName, kind="source", name="arn", near="arm"):
            give(recorder, "arn", [b""], [0.0])
        with pytest.raises(ValueError, match="found 2 arrivals and 1 lengths for 1 packets"):
            give(recorder, "arm", [b""], [0.0, 1.0])
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/a.mcap",
        reason="already exists. Choose another name, or remove it",
    ):
        begin(tmp_path / "a.mcap")


def test_decoder_error_ends_the_recording_and_is_raised(tmp_path: Path) -> None:
    def decode(data: bytes) -> None:
        if data == b"bad":
            raise ZeroDivisionError("in the decoder")

    recorder = begin(tmp_path / "a.mcap", decode=decode, signals_rate=1000.0)
    now = time.monotonic()
    give(recorder, "arm", [b"good", b"bad", b"after"], [now, now, now])
    assert until(lambda: recorder.error is not None)
    assert not give(recorder, "arm", [b"late"], [now])
    for _ in range(2):
        with pytest.raises(ZeroDivisionError, match="in the decoder"):
            recorder.close()
    assert recorder.statistics.not_recorded == {"arm": 2}
    with Recording(tmp_path / "a.mcap") as recording:
        assert [data for _, data in recording.packets("arm")] == [b"good", b"bad"]


CHILD = """
import sys, time
from pathlib import Path
from test_recorder import begin, give, packet, Recording, until
path = Path(sys.argv[1])
recorder = begin(path)
taken = time.monotonic()
give(recorder, "arm", [packet(i) for i in range(1000)], [taken] * 1000)
def count():
    with Recording(path) as recording:
        return recording.sources["arm"].count if recording.sources else 0
assert until(lambda: count() == 1000, 20.0)
print(time.monotonic() - taken, flush=True)
while True:
    give(recorder, "arm", [packet(i) for i in range(100)], [time.monotonic()] * 100)
    time.sleep(0.001)
"""


def test_killed_process_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parent,
    )
    with child:
        assert child.stdout is not None
        line = child.stdout.readline()
        child.kill()
    assert child.returncode == -signal.SIGKILL
    # 0.4 s until the chunk is written, plus delays of a busy machine.
    assert 0.3 < float(line) < 5.0
    expected = [packet(i) for i in range(1000)]
    with Recording(path) as recording:
        found = [data for _, data in recording.packets("arm")]
        assert found[:1000] == expected
        (fault,) = recording.faults
    if "cut off" in fault:
        return  # killed during a write, so the last chunk is incomplete
    with open(path, "rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages("/arm/raw")
        assert [unpack_raw(message.data) for _, _, message in messages] == found


FULL = """
import resource, sys, time
from pathlib import Path
from test_recorder import begin, give, packet, until
recorder = begin(Path(sys.argv[1]))
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))  # Python ignores SIGXFSZ
while recorder.error is None:
    give(recorder, "arm", [packet(i) for i in range(100)], [time.monotonic()] * 100)
try:
    recorder.close()
except OSError as error:
    print(error is recorder.error, type(error).__name__, error)
assert not give(recorder, "arm", [packet(0)], [time.monotonic()])
assert recorder.statistics.not_recorded["arm"] > 0
assert recorder.statistics.file_size == Path(sys.argv[1]).stat().st_size
"""


def test_full_disk_ends_the_recording_with_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    start = f"True RecordingError {path}: the file has reached the maximum size of the system"
    assert done.stdout.startswith(start)
    assert path.stat().st_size <= 100_000
    with open(path, "rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages("/arm/raw"))
    assert f" {len(found)} packets over " in done.stdout or "it has no packets" in done.stdout
    with Recording(path) as recording:
        assert recording.sources["arm"].size == LAYOUT.size
