"""`sero-mj simulate`: recordings, tables, images, videos, streams, and reports."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from polling import until

from sero_mj import HeadlessRenderer, Mirror, Scene, SerialRobot
from sero_mj.cli import main
from sero_mj.data.record.recording import Recording
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.runs.run_source import RunSource
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulated_scene import SOURCE, with_routes
from sero_mj.simulate.simulation import Simulation

MINE = """
[robots.lwr]
model = "lwr"
joint_angles = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]
show_arrows = true

[run]
duration = 0.4

[controllers.lwr]
kind = "joint_impedance"
stiffness = 500

[targets.lwr]
kind = "sine"
amplitude_deg = 5
frequency = 1.0

[disturbances.push]
kind = "force"
at = "lwr/flange"
force = [0.0, 0.0, -40.0]
begin = 0.2

[expect.torques]
measure = "torque_share"
below = 1.0
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(MINE)
    return path


def simulate(*arguments: object) -> int | str | None:
    with pytest.raises(SystemExit) as caught:
        main(["simulate", *map(str, arguments)])
    return caught.value.code


def rows_of(scenario: Path) -> Simulation:
    simulation = Simulation(read_scenario(scenario))
    for _ in simulation.run():
        pass
    return simulation


def test_simulate_reports_expectations(scenario: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulate(scenario) == 0
    out = capsys.readouterr().out
    assert re.search(
        r"^mine: 0\.4 s in \d+\.\d+ s \([\d.]+ times real time\), 400 steps$", out, re.M
    )
    assert re.search(r"^  held    torques: torque share 0\.\d+ of the limit at lwr/A\d, expected b",
                     out, re.M)  # fmt: skip
    assert simulate(scenario, "--set", "expect.torques.below=0.01") == 1
    assert "  FAILED  torques: torque share 0." in capsys.readouterr().out


def test_json_contains_the_whole_report(scenario: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulate(scenario, "--json", "--set", "monitor.external_torque=0.02") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["scenario"], found["seconds"], found["error"]) == ("mine", 0.4, None)
    assert found["expect"][0]["holds"] is True
    assert {"kind": "external_torque", "robot": "lwr"}.items() <= found["findings"][0].items()


def test_recording_contains_every_row_and_replays_to_the_same_states(
    scenario: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run.mcap"
    assert simulate(scenario, "--record", out, "--quiet") == 0
    simulation = rows_of(scenario)
    with Recording(out) as recording:
        packets = [packet for _, packet in recording.packets(SOURCE)]
        assert b"".join(packets) == simulation.rows.tobytes()
        assert set(recording.attachments) >= {f"{tmp_path.name}/mine.toml", "lwr/robot.toml"}
    states = []
    for source in (
        RunSource(run=simulation),
        {"kind": "replay", "file": str(out), "source": SOURCE},
    ):
        scene = with_routes(simulation.scenario, simulation.layout.columns, source)
        with Mirror(scene) as mirror:
            for t in (0.0, 0.1003, 0.4, 0.25):
                mirror.advance(t)
                states.append(mirror.data.qpos.copy())
    assert np.array_equal(states[:4], states[4:])
    row = simulation.rows[250, simulation.layout.columns["lwr_joint_angles"]]
    assert np.array_equal(states[3], row)


def test_recording_is_not_overwritten_by_default(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run.mcap"
    assert simulate(scenario, "--record", out, "--quiet") == 0
    assert simulate(scenario, "--record", out, "--quiet") == 2
    assert f"{out} exists" in capsys.readouterr().err.replace("already ", "")
    assert simulate(scenario, "--record", out, "--quiet", "--overwrite") == 0


def test_table_contains_every_value(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    assert simulate(scenario, "--csv", out, "--quiet") == 0
    simulation = rows_of(scenario)
    with open(out, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head[:3] == ["time", "lwr_joint_angles[0]", "lwr_joint_angles[1]"]
    assert np.array_equal(np.array(rows, float), simulation.rows)


@pytest.mark.thorough
@pytest.mark.gl
def test_image_shows_arrow_double_and_push(scenario: Path, tmp_path: Path) -> None:
    pictures = []
    for at in (0.1, 0.4):
        out = tmp_path / f"at{at}.png"
        assert simulate(
            scenario, "--render", out, "--at", at, "--size", "480x320", "--quiet"
        ) == 0  # fmt: skip
        pictures.append(np.asarray(Image.open(out).convert("RGB")).astype(int))
    magenta = [
        int(((p[..., 0] > 120) & (p[..., 2] > 70) & (p[..., 1] < 60)).sum()) for p in pictures
    ]
    assert magenta[0] == 0  # there is no push yet
    assert magenta[1] > 60
    assert np.abs(pictures[0] - pictures[1]).max() > 50


@pytest.mark.thorough
@pytest.mark.gl
def test_video_has_a_frame_for_every_thirtieth_of_a_second(scenario: Path, tmp_path: Path) -> None:

    out = tmp_path / "run.mp4"
    assert simulate(scenario, "--render", out, "--size", "160x120", "--quiet") == 0
    with av.open(str(out)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 12


def test_video_and_log_show_the_same_states(scenario: Path) -> None:
    """A mirror that simulates while rendering shows the states of the finished log."""
    finished = rows_of(scenario)
    fresh = Simulation(read_scenario(scenario))
    scene = with_routes(fresh.scenario, fresh.layout.columns, RunSource(run=fresh))
    with Mirror(scene) as mirror:
        for frame in range(12):
            mirror.advance(frame / 30)
            row = int(frame / 30 / 1e-3 + 1e-6)
            expected = finished.rows[row, finished.layout.columns["lwr_joint_angles"]]
            assert np.array_equal(mirror.data.qpos, expected)
            target = mirror.data.userdata[mirror.world.slots["lwr_target.joint_angles"]]
            columns = finished.layout.columns["lwr_target_angles"]
            assert np.array_equal(target, finished.rows[row, columns])


# ---- streams


@pytest.mark.slow
def test_one_process_simulates_and_another_mirrors(scenario: Path, tmp_path: Path) -> None:
    robot = SerialRobot.from_model("lwr")
    source = {"kind": "udp", "port": 0, "structure": "7F7F", "only_latest_packet": False}
    routes = {"lwr.joint_angles": "udp.values0", "lwr.torques": "udp.values1"}
    receiver = tmp_path / "receiver.toml"
    with Mirror(Scene(robots=[robot], sources={"udp": source}, routes=routes)) as mirror:
        receiver_source: Any = mirror.sources["udp"]
        receiver.write_text(
            '[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\n'
            f'port = {receiver_source.port}\nstructure = "7F7F"\n[routes]\n'
            '"lwr.joint_angles" = "udp.values0"\n"lwr.torques" = "udp.values1"\n'
        )
        got: list[np.ndarray] = []
        mirror.listen(lambda _, packets: got.extend(packets.values["values0"]))
        command = [sys.executable, "-m", "sero_mj", "simulate", str(scenario)]
        done = subprocess.run(
            [*command, "--send", str(receiver), "--quiet"],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert until(lambda: mirror.advance() or len(got) == 401)
        assert receiver_source.counters.malformed == 0
    simulation = rows_of(scenario)
    assert np.array_equal(got, simulation.rows[:, simulation.layout.columns["lwr_joint_angles"]])
    assert "sent 401 packets in " in done.stdout


def test_real_time_is_not_faster_than_the_clock(
    scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert simulate(scenario, "--real-time", "--json") == 0
    assert json.loads(capsys.readouterr().out)["took"] >= 0.4


# ---- errors


@pytest.mark.parametrize("options", [[], ["--json"], ["--quiet"]])
def test_interrupted_run_is_saved_and_not_judged(
    options: list[str],
    scenario: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write, written = RunRecorder.write, list[int]()

    def interrupted(recorder: RunRecorder, first: int, stop: int) -> None:
        write(recorder, first, stop)
        written.append(stop)
        if stop > 100:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunRecorder, "write", interrupted)
    out = tmp_path / "run.mcap"
    assert simulate(scenario, "--record", out, "--real-time", *options) == 130
    output = capsys.readouterr()
    (text,) = re.findall(r"sero-mj: stopped at (0\.\d+) s of 0\.4 s; expect.*", output.err)
    step = round(1000 * float(text))
    assert step == written[-1] - 1
    assert all(stop <= 100 for stop in written[:-1])
    assert "held" not in output.out and "FAILED" not in output.out
    if options == ["--json"]:
        found = json.loads(output.out)
        assert found["error"] in output.err and found["expect"] == []
    with Recording(out) as recording:
        assert recording.sources[SOURCE].count == step + 1


def test_rows_before_an_error_are_saved(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # This arm cannot resist a push of 1e9 N.
    scenario.write_text(MINE.replace("-40.0", "-1e9"))
    out = tmp_path / "run.mcap"
    assert simulate(scenario, "--record", out, "--csv", tmp_path / "run.csv") == 1
    output, error = capsys.readouterr()
    assert "  so far  torques: " in output and "held" not in output
    assert re.search(r"sero-mj: lwr/\w\d at 0\.2\d+ s: found .* rad/s, more than 3 times", error)
    with Recording(out) as recording:
        count = recording.sources[SOURCE].count
    assert count == 202  # the last row is the one in which it runs away
    assert len((tmp_path / "run.csv").read_text().splitlines()) == count + 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--record", "run.txt"], "--record: found 'run.txt'; expected a name that ends in .mcap"),
        (
            ["--render", "run.avi"],
            "--render: found 'run.avi'; expected a name that ends in .png",
        ),
        (["--at", "1"], "--at needs an image: --render OUT.png"),
        (["--render", "x.png", "--at", "9"], "--at 9: the run ends at 0.4 s"),
        (["--set", "controllers.lwr.stifness=1"], "stifness: unknown key; did you mean"),
        (["--seed", "-1"], "found '-1'; expected a whole number of 0 or more"),
        (["--send", "lwr_udpp"], "no scene or robot 'lwr_udpp'; did you mean 'lwr_udp'?"),
    ],
)
def test_incompatible_options_are_rejected(
    scenario: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert simulate(scenario, *options) == 2
    assert message in capsys.readouterr().err


def test_simulation_is_rendered_with_decor_from_python(scenario: Path) -> None:
    simulation = rows_of(scenario)
    scene = with_routes(simulation.scenario, simulation.layout.columns, RunSource(run=simulation))
    with Mirror(scene) as mirror, HeadlessRenderer(mirror.world, 160, 120) as renderer:
        mirror.advance(0.3)
        assert renderer.render(mirror.data).shape == (120, 160, 3)
