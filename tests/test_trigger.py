"""Recording around events: conditions, the seconds before and after, bounded memory."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import free_udp_port, raises_with
from newton_euler import inverse_dynamics
from polling import until

from sero_mj import Scene, SerialRobot, UdpReceiver
from sero_mj.base.errors import RecordingError, RouteError
from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import record_events, record_last, record_sources
from sero_mj.data.drive.trigger import Trigger
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.intake import pad_packets
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.triggered_recorder import TriggeredRecorder
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.simulate.runs.run_recording import read_run

LAYOUT = Structure("7F7F7F")
ROUTES = {
    "lwr.joint_angles": "udp.values0",
    "lwr.torques": "0.5 * udp.values1",
    "lwr.commanded_torques": "udp.values2",
}


def scene(port: int = 0, **routes: Any) -> Scene:
    return Scene(
        robots=[SerialRobot.from_model("lwr")],
        sources={"udp": UdpReceiver(structure=LAYOUT.text, udpport=port or 32123)},
        routes={**ROUTES, **routes},
        name="cell",
    )


def trigger(text: str, of: Scene | None = None) -> Trigger:
    of = of or scene()
    return Trigger(text, of, wire(of))


def some_events(count: int = 5) -> dict[str, Array]:
    rng = np.random.default_rng(0)
    return {f"values{k}": rng.normal(0, 10, (count, 7)) for k in range(3)}


EVENTS = some_events(200)
TORQUES, COMMANDED = 0.5 * EVENTS["values1"], EVENTS["values2"]
ANGLES = EVENTS["values0"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("abs(lwr.torque_error) > 20", (np.abs(COMMANDED - TORQUES) > 20).any(axis=1)),
        ("lwr.joint_angles[3] > 5", ANGLES[:, 3] > 5),
        ("lwr.joint_angles[-1] >= 5 and lwr.torques[0] < 0",
         (ANGLES[:, 6] >= 5) & (TORQUES[:, 0] < 0)),
        ("not (max(lwr.torques) > 5) or udp.values0[2] < -10",
         ~(TORQUES.max(axis=1) > 5) | (ANGLES[:, 2] < -10)),
        ("all(abs(lwr.torques[1:4]) > 2)", (np.abs(TORQUES[:, 1:4]) > 2).all(axis=1)),
        ("all(lwr.torques > -8)", (TORQUES > -8).all(axis=1)),
        ("norm(lwr.torques - udp.values0 / 3) > 20",
         np.linalg.norm(TORQUES - ANGLES / 3, axis=1) > 20),
        ("-2 < lwr.torques[1] <= 3", (TORQUES[:, 1] > -2) & (TORQUES[:, 1] <= 3)),
        ("2 * (lwr.torques[1] + 1) > lwr.torques[2] * lwr.torques[3]",
         2 * (TORQUES[:, 1] + 1) > TORQUES[:, 2] * TORQUES[:, 3]),
        ("lwr.torques[0,2,-1] > 8", (TORQUES[:, [0, 2, 6]] > 8).any(axis=1)),
        ("max([lwr.torques[0:2], -udp.values0[1]]) > 9",
         np.column_stack([TORQUES[:, :2], -ANGLES[:, 1]]).max(axis=1) > 9),
        ("min(lwr.torques) - 1 != min(lwr.torques) - 1", np.zeros(200, bool)),
    ],
)  # fmt: skip
def test_conditions_equal_the_numpy_result(text: str, expected: Array) -> None:
    found = trigger(text).find("udp", EVENTS)
    assert np.array_equal(found.holds, expected)
    assert expected.any() != ("!=" in text) and not expected.all()


def test_satisfied_condition_is_described_with_joint_and_value() -> None:
    events = {key: np.zeros((2, 7)) for key in EVENTS}
    events["values2"][1, 4] = 23.456
    hits = trigger("abs(lwr.torque_error) > 20").find("udp", events)
    assert hits.holds.tolist() == [False, True]
    assert hits.describe(1) == "lwr/A4: abs(lwr.torque_error) = 23.46 > 20"
    hits = trigger("lwr.commanded_torques[3:6] > 20 and udp.values0[0] < 1").find("udp", events)
    assert hits.describe(1) == (
        "lwr/A4: lwr.commanded_torques[3:6] = 23.46 > 20, udp.values0[0] = 0 < 1"
    )


@pytest.mark.thorough
def test_model_outputs_are_signals() -> None:
    of = scene()
    lwr = SerialRobot.from_model("lwr", inputs=["joint_velocities"])
    moved = Scene(
        robots=[lwr],
        sources=of.sources,
        routes={
            **ROUTES,
            "lwr.joint_velocities": "udp.values1 * deg / s",
            "lwr.billboard_values": "lwr.torques - lwr.gravity_torques",
        },
        name="cell",
    )
    events = {**EVENTS, "values0": EVENTS["values0"] / 10}
    weight = np.array(
        [inverse_dynamics(lwr, robot_dynamics(lwr), angles) for angles in events["values0"]]
    )
    found = trigger("abs(lwr.gravity_torques[1]) > 20", moved).find("udp", events)
    assert np.array_equal(found.holds, np.abs(weight[:, 1]) > 20)
    assert 0 < found.holds.sum() < 200
    hits = trigger("lwr.billboard_values[3] > 5", moved).find("udp", events)
    assert np.array_equal(hits.holds, (TORQUES - weight)[:, 3] > 5)
    speeds = np.deg2rad(events["values1"])
    signs = np.clip(speeds / 0.01, -1.0, 1.0)
    friction = lwr.dynamics.viscous_friction * speeds + lwr.dynamics.coulomb_friction * signs
    hits = trigger("lwr.friction_torques > 1.2", moved).find("udp", events)
    assert np.array_equal(hits.holds, (friction > 1.2).any(axis=1))
    assert hits.describe(int(np.argmax(hits.holds))).startswith("lwr/A")
    reason = "lwr.friction_torques needs a route to lwr.joint_velocities"
    for text in ("lwr.friction_torques[0] > 1", "1 < lwr.billboard_values[0]"):
        still = scene(**{"lwr.billboard_values": "udp.values1 - lwr.friction_torques"})
        with raises_with(RouteError, reason=reason, position=4 if text[0] == "1" else 0):
            trigger(text, still)


def test_missing_data_satisfies_nothing_and_other_sources_hold_their_values() -> None:
    two = Scene(
        robots=[SerialRobot.from_model("lwr")],
        sources={
            "udp": UdpReceiver(structure=LAYOUT.text, udpport=32123),
            "other": UdpReceiver(structure="7F", udpport=32124),
        },
        routes={"lwr.joint_angles": "udp.values0", "lwr.torques": "other.values0 - udp.values1"},
    )
    found = trigger("lwr.torques[0] > 5", two)
    assert not found.find("udp", EVENTS).holds.any()  # nothing of the other source has arrived
    later = found.find("other", {"values0": np.full((3, 7), 1e3)})
    assert later.holds.all()
    assert found.find("udp", EVENTS).holds.tolist() == (1e3 - EVENTS["values1"][:, 0] > 5).tolist()
    blank = {**EVENTS, "values1": np.full((200, 7), np.nan)}
    assert not found.find("udp", blank).holds.any()
    assert not trigger("lwr.torques[0] != 5", two).find("udp", blank).holds.any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("abs(lwr.torqe_error) > 20", "'abs(lwr.torqe_error) > 20', character 5: found "
         "'lwr.torqe_error', expected a signal of scene 'cell'; did you mean 'lwr.torque_error'?"),
        ("asb(lwr.torques) > 20",
         "character 1: found 'asb', expected a function; did you mean 'abs'?"),
        ("abs(lwr.torques)", "character 1: found 'abs', expected a comparison such as"),
        ("lwr.torques > ", "character 15: found the end, expected an event such as"),
        ("lwr.torques > 20 20", "character 18: found '20', expected"),
        ("lwr.torques = 20",
         "character 13: found '=', expected +, -, * or / between spaces, or the end; write =="),
        ("lwr.torques[9] > 1", "character 13: found '9', expected 0 to 6"),
        ("lwr.torques[0][0] > 1", "is a single number, which has no index"),
        ("lwr.torques[1:3] > lwr.torques", "character 18: found '>', expected the same number on "
         "both sides; found 2 values and 7 values"),
        ("abs(lwr.torques > 2) > 1", "expected numbers; combine comparisons with 'and' or 'or'"),
        ("lwr.torques and lwr.torques > 1", "expected a comparison such as lwr.torques > 20"),
        ("any(lwr.torques) > 1", "expected numbers; combine comparisons with 'and' or 'or'"),
        ("any(lwr.torques)", "expected a comparison such as lwr.torques > 20"),
        ("lwr.torques % 2 > 1", "character 13: found '%', expected +, -, * or /"),
        ("", "character 1: found the end"),
        ("((lwr.torques > 1)", "character 19: found the end"),
        ("lwr.receiving > 1", "expected a signal of scene 'cell'"),
    ],
)  # fmt: skip
def test_invalid_condition_is_reported_with_its_position(text: str, message: str) -> None:
    with pytest.raises(RouteError) as caught:
        trigger(text)
    assert message in str(caught.value)


def test_torque_error_requires_both_torques() -> None:
    of = scene()
    of.routes = {key: route for key, route in of.routes.items() if "commanded" not in key}
    reason = "it needs routes to lwr.commanded_torques"
    with raises_with(RouteError, position=0, reason=reason):
        trigger("lwr.torque_error > 1", of)


# Recording.


def numbered(count: int, hits: dict[int, float], rate: float = 100.0) -> tuple[list[bytes], Array]:
    """Returns packets with their number as an angle and a torque at the listed packets."""
    packets = []
    for k in range(count):
        torques = [0.0] * 7
        torques[2] = hits.get(k, 0.0)
        values = {"values0": [float(k)] * 7, "values1": [0.0] * 7, "values2": torques}
        packets.append(LAYOUT.encode(values))
    return packets, np.arange(count) / rate


def numbers_in(path: Path) -> list[int]:
    with Recording(path) as recording:
        assert recording.faults == []
        return [int(LAYOUT.decode(data)["values0"][0]) for _, data in recording.packets("udp")]


def find(name: str, rows: Any, lengths: Any) -> Any:
    torque = rows[:, : LAYOUT.size].copy().view(np.float64).reshape(len(rows), -1)[:, 16]
    return np.abs(torque) > 20, lambda row: f"A3 is {torque[row]:g}"


def recorder(folder: Path, **options: Any) -> TriggeredRecorder:
    fields = {"before": 0.5, "after": 0.3, "now": None, "find": find, **options}
    made = TriggeredRecorder(lambda n, _: folder / f"{n}.mcap", about={}, **fields)
    made.add_source(
        "udp", kind="udp", declared={"structure": LAYOUT.text}, events=LAYOUT.events,
        size=LAYOUT.size, decode=LAYOUT.decode,
    )  # fmt: skip
    return made


@pytest.mark.parametrize("at_once", [1, 7, 1000])
def test_each_event_contains_the_packets_before_and_after_it(tmp_path: Path, at_once: int) -> None:
    # At 100 Hz: one event, one that another extends, and one at the very end.
    packets, times = numbered(1000, {200: 25, 500: -30, 520: 40, 551: 22, 990: 21})
    with recorder(tmp_path) as made:
        for k in range(0, 1000, at_once):
            rows, lengths = pad_packets(packets[k : k + at_once], LAYOUT.size)
            assert made.take("udp", rows, lengths, times[k : k + at_once])
    first, second, third, fourth = made.events
    assert numbers_in(first.path) == [*range(150, 231)]
    assert numbers_in(second.path) == [*range(450, 551)]  # 520 + 0.3 s
    assert numbers_in(third.path) == [*range(501, 582)]
    assert numbers_in(fourth.path) == [*range(940, 1000)]
    assert [event.again for event in made.events] == [0, 1, 0, 0]
    assert [event.what for event in made.events][:2] == ["A3 is 25", "A3 is -30"]
    assert [event.packets for event in made.events] == [81, 101, 81, 60]
    assert (first.time, first.began, first.ended) == pytest.approx((2.0, 1.5, 2.3))
    with Recording(first.path) as recording:
        assert recording.duration == pytest.approx(0.8, abs=1e-6)
        assert recording.about["event"] == "A3 is 25"
        assert float(recording.about["event_time"]) == pytest.approx(0.5, abs=1e-6)
    assert made.statistics.packets == 1000


def test_waiting_lasts_until_all_packets_have_been_examined(tmp_path: Path) -> None:
    looking, goes_on = threading.Event(), threading.Event()

    def find_slowly(name: str, rows: Any, lengths: Any) -> Any:
        looking.set()
        assert goes_on.wait(60)
        return find(name, rows, lengths)

    packets, times = numbered(30, {})
    rows, lengths = pad_packets(packets, LAYOUT.size)
    seen: list[int] = []
    with recorder(tmp_path, find=find_slowly) as made:
        assert made.take("udp", rows, lengths, times)
        assert looking.wait(60)  # the queue is empty, and nothing has been examined

        def wait() -> None:
            made.wait_until_handled()
            seen.append(made.statistics.packets)

        waiting = threading.Thread(target=wait)
        waiting.start()
        goes_on.set()
        waiting.join()
    assert seen == [30]


def test_memory_holds_only_the_last_seconds(tmp_path: Path) -> None:
    packets, _ = numbered(1000, {})
    rows, lengths = pad_packets(packets, LAYOUT.size)
    with recorder(tmp_path, before=1.0) as made:
        for k in range(100):
            made.take("udp", rows, lengths, k + np.arange(1000) / 1000)
            made.wait_until_handled()
        size = made.statistics.buffer_bytes
    assert 1000 * LAYOUT.size < size < 4000 * (LAYOUT.size + 100)
    assert made.statistics.evicted == 0 and not made.events
    # If the memory is smaller, the oldest packets are dropped and counted.
    with recorder(tmp_path, before=60.0, buffer_bytes=500_000) as made:
        for k in range(20):
            made.take("udp", rows, lengths, k + np.arange(1000) / 1000)
            made.wait_until_handled()
        assert made.statistics.buffer_bytes < 700_000
        assert made.statistics.evicted > 15_000
        late = pad_packets([numbered(1, {0: 99})[0][0]], LAYOUT.size)
        made.take("udp", *late, np.array([20.0]))
    assert len(made.events) == 1 and made.events[0].packets > 1000


def test_live_event_ends_without_further_packets(tmp_path: Path) -> None:
    packets, _ = numbered(3, {1: 30})
    ended: list[float] = []
    with recorder(tmp_path, after=0.1, now=time.monotonic) as made:
        made.on_event = lambda event: ended.append(event.ended)
        now = time.monotonic()
        made.take("udp", *pad_packets(packets, LAYOUT.size), now + np.array([0.0, 0.01, 0.02]))
        until(lambda: len(ended) == 2)  # it began, and it ended
        assert not made.statistics.is_recording
    assert np.isnan(ended[0]) and ended[1] == pytest.approx(now + 0.02)


def test_write_error_ends_recording_and_is_reported(tmp_path: Path) -> None:
    (tmp_path / "1.mcap").write_text("mine")
    packets, times = numbered(3, {1: 30})
    made = recorder(tmp_path)
    made.take("udp", *pad_packets(packets, LAYOUT.size), times)
    made.wait_until_handled()
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/1.mcap",
        reason="already exists. Choose another name, or remove it",
    ):
        made.close()
    assert not made.take("udp", *pad_packets(packets, LAYOUT.size), times)
    assert (tmp_path / "1.mcap").read_text() == "mine"


# The command.

SENDER = """
import socket, struct, sys, time
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
start = time.monotonic()
k = 0
while True:
    torques = [0.0] * 7
    if 300 <= k < 310:
        torques[4] = 35.0
    packet = struct.pack("<21d", *[0.001 * k] * 7, *[0.0] * 7, *torques)
    out.sendto(packet, ("127.0.0.1", int(sys.argv[1])))
    k += 1
    time.sleep(max(start + k / 500 - time.monotonic(), 0))
"""


def write_scene(path: Path, port: int) -> Path:
    routes = "\n".join(f'"{key}" = "{route}"' for key, route in ROUTES.items())
    path.write_text(
        f'[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\nport = {port}\n'
        f'structure = "{LAYOUT.text}"\n[routes]\n{routes}\n'
    )
    return path


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


def test_packets_of_another_process_are_recorded_around_an_event_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_udp_port()
    file = write_scene(tmp_path / "cell.toml", port)
    sender = subprocess.Popen([sys.executable, "-c", SENDER, str(port)])
    try:
        status, out, _ = run(
            ["record", str(file), str(tmp_path / "events"), "--trigger",
             "abs(lwr.torque_error) > 20", "--before", "0.4", "--after", "0.2",
             "--duration", "1.6", "--quiet"], capsys,
        )  # fmt: skip
    finally:
        sender.kill()
        sender.wait()
    assert status == 0
    assert "lwr/A4: abs(lwr.torque_error) = 35 > 20" in out
    (kept,) = (tmp_path / "events").iterdir()
    assert re.fullmatch(r"cell_\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d\.\d{3}\.mcap", kept.name)
    numbers = []
    with Recording(kept) as recording:
        for _, data in recording.packets("udp"):
            numbers.append(round(LAYOUT.decode(data)["values0"][0] / 0.001))
        assert recording.about["trigger"] == "abs(lwr.torque_error) > 20"
    assert numbers == [*range(numbers[0], numbers[-1] + 1)]
    assert 280 > numbers[0] > 20 and 309 + 50 < numbers[-1] < 500
    log = read_run(kept)
    assert np.abs(log.torque_error("lwr")).max() == 35.0
    status, out, err = run(["compare", str(kept), "--json"], capsys)
    assert status == 0 and "lwr" in out, err


def test_events_in_a_recording_equal_the_live_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_scene(tmp_path / "cell.toml", free_udp_port())
    whole = tmp_path / "whole.mcap"
    packets, times = numbered(1000, {200: 25, 700: 30})
    of = scene()
    source = wire(of).sources["udp"]
    now = time.monotonic()
    with record_sources({"udp": source}, whole, scene=of):
        source._tap(*pad_packets(packets, LAYOUT.size), now + times)  # type: ignore[misc]
    line = ["record", str(file), "--out", str(tmp_path / "hit.mcap"), "--replay", str(whole),
            "--trigger", "lwr.commanded_torques > 20",
            "--before", "1", "--after", "0.5"]  # fmt: skip
    status, out, _ = run(line, capsys)
    assert status == 0 and "2 events in 1000 packets; 302 packets recorded" in out
    assert numbers_in(tmp_path / "hit_001.mcap") == [*range(100, 251)]
    assert numbers_in(tmp_path / "hit_002.mcap") == [*range(600, 751)]
    with Recording(whole) as all_of_it, Recording(tmp_path / "hit_002.mcap") as part:
        apart = (part.start - all_of_it.start).total_seconds()
        first = all_of_it.sources["udp"].first
    assert apart == pytest.approx(first + 6.0, abs=2e-3)  # at its original time
    status, _, err = run(line, capsys)
    assert status == 2 and "hit_001.mcap already exists" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["a.mcap", "--before", "3"], "--before needs --trigger CONDITION"),
        ([], "expected OUT.mcap"),
        (["a.mcap", "-o", "b.mcap"], "found OUT a.mcap and --out b.mcap"),
        (["a.txt", "--trigger", "lwr.torques > 1"],
         "a.txt: expected a folder, or a name that ends in .mcap"),
        (["a.mcap", "--trigger", "lwr.torqes > 1"],
         "--trigger 'lwr.torqes > 1', character 1: found 'lwr.torqes', expected a signal of scene "
         "'lwr_udp'; did you mean 'lwr.torques'?"),
    ],
)  # fmt: skip
def test_invalid_options_are_rejected(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = run(["record", "lwr_udp", *options], capsys)
    assert status == 2 and message in err
    assert record_events is not None


def test_recent_packets_are_recorded_on_request_without_further_packets(
    tmp_path: Path,
) -> None:
    of = scene()
    source = UdpReceiver(structure=LAYOUT.text)
    paths = [tmp_path / "first.mcap", tmp_path / "second.mcap"]
    with source, socket.socket(type=socket.SOCK_DGRAM) as sender, record_last(
        {"udp": source}, lambda number, _: paths[number - 1], of, 30.0
    ) as recorder:  # fmt: skip
        for count, path in zip((20, 30), paths, strict=True):
            for k in range(count):
                rows = {name: values[k : k + 1] for name, values in EVENTS.items()}
                packet = LAYOUT.encode({name: values[0] for name, values in rows.items()})
                sender.sendto(packet, ("127.0.0.1", source.port))
                assert until(lambda: source.counters.received > 0)
            seen = 20 if path == paths[0] else 50
            assert until(lambda seen=seen: recorder.statistics.packets == seen)
            recorder.record_now("kept by hand")
            assert until(lambda: not recorder.statistics.is_recording and recorder.events)
            assert until(lambda path=path: recorder.events[-1].path == path)
    for path, count in zip(paths, (20, 50), strict=True):
        with Recording(path) as recording:
            assert recording.about["event"] == "kept by hand"
            assert len([*recording.packets("udp")]) == count
