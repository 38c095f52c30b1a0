from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st
from runs import record_run, simulated, sine_run, two_joints

from sero_mj.base.errors import CsvError, UsageError
from sero_mj.cli import main
from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.study.align import align, at_times, find_shift
from sero_mj.study.compare import as_json, compare, compare_scene, exceeded, write_csv


def shifted(log: RunLog, **signals: float) -> RunLog:
    changed = {key: values + signals.get(key, 0.0) for key, values in log.signals.items()}
    return RunLog(log.robots, changed, log.times, "other")


@settings(max_examples=examples(25), deadline=None)
@given(
    delay=st.floats(-1.2, 1.2),
    start=st.floats(-50.0, 50.0),
    rates=st.tuples(st.sampled_from([250.0, 500.0, 1000.0]), st.sampled_from([250.0, 1000.0])),
)
def test_known_shift_is_found_within_a_sample(
    delay: float, start: float, rates: tuple[float, float]
) -> None:
    a = sine_run(rate=rates[0], duration=4.0)
    b = sine_run(rate=rates[1], duration=4.0, delay=delay)
    shift = find_shift(
        a.times, a.of("arm", "joint_angles"), b.times + start, b.of("arm", "joint_angles")
    )
    assert shift is not None
    assert shift.seconds == pytest.approx(-delay - start, abs=1.0 / min(rates))
    assert shift.correlation > 0.99


def test_part_of_a_motion_is_found_in_it() -> None:
    a = sine_run(duration=6.0)
    part = a.of("arm", "joint_angles")[3000:4500]
    noisy = part + np.random.default_rng(1).normal(0.0, 1e-4, part.shape)
    shift = find_shift(a.times, a.of("arm", "joint_angles"), np.arange(1500) * 1e-3, noisy)
    assert shift is not None
    assert shift.seconds == pytest.approx(3.0, abs=1e-3)


def test_nearest_shift_of_a_periodic_motion_is_chosen() -> None:
    t = np.arange(5000) * 1e-3
    periodic = np.sin(2.0 * np.pi * t)[:, None]
    shift = find_shift(t, periodic, t, np.sin(2.0 * np.pi * (t - 0.1))[:, None])
    assert shift is not None
    assert shift.seconds == pytest.approx(-0.1, abs=1e-3)


def test_runs_without_motion_are_not_aligned() -> None:
    a = sine_run()
    still = RunLog(
        a.robots, {**a.signals, "arm_joint_angles": np.zeros((4001, 2))}, a.times, "still"
    )
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="one of the runs hardly moves",
        expected="a number of seconds",
    ):
        align(a, still, offset="auto")
    noise = np.cumsum(np.random.default_rng(1).normal(0.0, 0.01, (4001, 2)), axis=0)
    other = RunLog(a.robots, {**a.signals, "arm_joint_angles": noise}, a.times, "noise")
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="the motions of run and noise have a correlation of",
        found=pytest.approx(0.02, abs=0.015),
        expected="at least 0.5, or a number of seconds",
    ):
        align(a, other, offset="auto")


def test_joints_of_other_names_are_compared_in_their_order_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    a = sine_run()
    (arm,) = a.robots.values()
    joints = replace(a, robots={"arm": two_joints(joint_names=["j1", "j2"])})
    align(a, joints)
    (record,) = caplog.records
    assert record.args == (f"{', '.join(arm.names)} in run, j1, j2 in run",)
    turned = replace(a, robots={"arm": two_joints(joint_names=arm.names[::-1])})
    with raises_with(
        UsageError,
        reason=f"the joints are {', '.join(arm.names)} in run, {', '.join(arm.names[::-1])} in run",
        expected="the same order. --scene ROBOT reads both in the order of ROBOT.",
    ):
        align(a, turned)


def test_differences_have_the_known_peak_and_rms() -> None:
    a, b = sine_run(amplitude=3.0), sine_run(amplitude=1.0)
    found = {(each.signal, each.joint): each for each in compare(align(a, b))}
    # 2 Nm sin(4 pi t) over whole periods.
    commanded = found["commanded_torques", "turn"]
    assert commanded.rms == pytest.approx(2.0 / np.sqrt(2.0), rel=1e-3)
    assert abs(commanded.peak) == pytest.approx(2.0, rel=1e-6)
    assert commanded.at % 0.25 == pytest.approx(0.125, abs=1e-3)
    assert commanded.unit == "Nm"
    assert found["commanded_torques", "slide"].unit == "N"
    assert found["joint_angles", "turn"].peak == 0.0
    assert (found["joint_angles", "turn"].unit, found["joint_angles", "slide"].unit) == ("rad", "m")


def test_difference_is_the_first_minus_the_second() -> None:
    a = sine_run()
    b = shifted(a, arm_torques=0.25)
    found = {each.signal: each for each in compare(align(a, b)) if each.joint == "turn"}
    assert found["torques"].peak == pytest.approx(-0.25)
    assert found["torques"].rms == pytest.approx(0.25)


def test_runs_of_different_rates_meet_at_the_times_of_the_faster_one() -> None:
    a, b = sine_run(rate=1000.0), sine_run(rate=200.0)
    pair = align(a, b)
    np.testing.assert_array_equal(pair.times, a.times)
    by_numpy = np.interp(a.times, b.times, b.of("arm", "torques")[:, 1])
    np.testing.assert_allclose(pair.b["torques"][:, 1], by_numpy, atol=1e-12)
    # 20 sin(t) between rows 5 ms apart is off by no more than this.
    slide = [each for each in compare(pair) if each.signal == "torques"][1]
    assert abs(slide.peak) <= 20.0 * 0.005**2 / 8.0 * 1.001
    np.testing.assert_array_equal(align(b, a).times, a.times)


def test_only_common_signals_are_compared() -> None:
    a = sine_run()
    only = {"arm_joint_angles": a.signals["arm_joint_angles"][1000:3001]}
    b = RunLog(a.robots, only, a.times[1000:3001] + 7.0, "b")
    pair = align(a, b, offset=-7.0)
    assert pair.signals == ["joint_angles"]
    assert (pair.times[0], pair.times[-1]) == (1.0, 3.0)
    np.testing.assert_allclose(pair.difference("joint_angles"), 0.0, atol=1e-12)


def test_nothing_is_made_up_in_a_gap() -> None:
    a = sine_run()
    keep = (a.times < 1.0) | (a.times > 1.5)
    b = RunLog(a.robots, {key: v[keep] for key, v in a.signals.items()}, a.times[keep], "gap")
    known = np.isfinite(align(a, b).difference("joint_angles")).all(axis=1)
    np.testing.assert_array_equal(known, keep)


@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_values_at_other_times_are_those_of_numpy(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(1e-3, 2e-3, count))
    values = rng.normal(size=(count, 2))
    wanted = np.sort(np.append(rng.uniform(times[0], times[-1], 20), times))
    found = at_times(times, values, wanted)
    for k in range(2):
        np.testing.assert_allclose(found[:, k], np.interp(wanted, times, values[:, k]), atol=1e-9)
    assert np.isnan(at_times(times, values, np.array([times[0] - 1.0, times[-1] + 1.0]))).all()


def test_incomparable_runs_are_rejected() -> None:
    a, late = sine_run(name="a"), sine_run(start=20.0, name="late")
    with raises_with(
        UsageError,
        reason="found a from 0.000 s to 4.000 s, late from 20.000 s to 24.000 s",
        expected="runs that overlap. Set --offset S or --offset auto.",
    ):
        align(a, late)
    other = sine_run(robot=two_joints("leg"), name="b")
    assert align(a, other).robot.name == "arm"  # the only one in each
    with raises_with(
        UsageError, key="--robot", reason="no robot", found="leh", of="in b", near="leg"
    ):
        align(a, other, "arm,leh")
    both = RunLog({**a.robots, **other.robots}, {**a.signals, **other.signals}, a.times, "both")
    with raises_with(UsageError, reason="both runs have arm, leg; choose one with --robot NAME"):
        align(both, both)
    assert align(both, both, "leg").robot.name == "leg"
    third = RunLog({"x": two_joints("x"), "y": two_joints("y")}, {}, a.times, "third")
    with raises_with(
        UsageError,
        reason="a has arm, third has x, y: no common robot; choose a pair with --robot NAME,NAME",
    ):
        align(a, third)
    lwr = simulated().log
    with raises_with(
        UsageError, reason="arm has 2 joints in a, lwr has 7 in swing", expected="the same number"
    ):
        align(a, lwr)


def test_tolerances_tell_joint_time_and_both_numbers() -> None:
    a = sine_run()
    differences = compare(align(a, shifted(a, arm_torques=0.25, arm_joint_angles=np.deg2rad(2.0))))
    assert exceeded(differences) == []
    assert exceeded(differences, torque=0.2500001, angle=0.1) == []
    found = [str(each) for each in exceeded(differences, torque=0.2, angle=0.01, travel=0.02)]
    assert found[1].startswith("slide: angle differs by ") and found[1].endswith("tolerance 20 mm")
    pattern = r"turn: {} differs by {} at \d\.\d{{3}} s; tolerance {}"
    assert re.fullmatch(pattern.format("angle", "2 deg", "0.573 deg"), found[0])
    assert re.fullmatch(pattern.format("torque", "0.25 Nm", "0.2 Nm"), found[2])
    blank = RunLog(a.robots, {**a.signals, "arm_torques": np.full((4001, 2), np.nan)}, a.times)
    assert len(exceeded(compare(align(a, blank)), torque=1e9)) == 2  # unknown is not the same


def test_first_row_without_commands_is_not_compared() -> None:
    log = sine_run()
    commanded = log.signals["arm_commanded_torques"].copy()
    commanded[0] = 0.0
    before = RunLog(log.robots, {**log.signals, "arm_commanded_torques": commanded}, log.times)
    pair = align(before, log)
    assert np.isnan(pair.a["commanded_torques"][0]).all()
    assert np.isfinite(pair.a["commanded_torques"][1:]).all()
    assert not commanded[0].any()  # the run itself is as it was
    assert np.isfinite(align(log, log).a["commanded_torques"]).all()


def test_csv_and_json_carry_the_numbers(tmp_path: Path) -> None:
    a = sine_run(duration=0.1)
    pair = align(a, shifted(a, arm_torques=0.25))
    write_csv(pair, tmp_path / "d.csv")
    with open(tmp_path / "d.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 101
    for row, time, torque in zip(rows, a.times, a.of("arm", "torques")[:, 0], strict=True):
        assert float(row["time"]) == time
        assert float(row["torques_turn_a"]) == torque
        assert float(row["torques_turn_diff"]) == pytest.approx(-0.25)
    found = json.loads(json.dumps(as_json(pair, compare(pair))))
    assert (found["robot"], found["rows"], found["offset"]) == ("arm", 101, 0.0)
    assert len(found["differences"]) == 2 * len(pair.signals)
    with raises_with(
        CsvError,
        path=f"{tmp_path}/nowhere/d.csv",
        reason="cannot be written: No such file or directory",
    ):
        write_csv(pair, tmp_path / "nowhere" / "d.csv")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("recorded")
    soft = record_run(simulated(800.0), folder / "soft.mcap")
    return soft, record_run(simulated(2000.0), folder / "stiff.mcap")


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["compare", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.mark.slow
def test_exit_status_is_0_for_equal_runs_and_1_beyond_a_tolerance(
    recorded: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    soft, stiff = recorded
    assert command(soft, soft, "--tolerance-torque", 0, "--tolerance-angle", 0) == 0
    assert "soft minus soft: lwr, 0.000 s to 0.500 s" in capsys.readouterr().out
    assert command(soft, stiff) == 0
    capsys.readouterr()
    assert command(soft, stiff, "--json", "--tolerance-angle", 0.05) == 1
    told = capsys.readouterr()
    found = json.loads(told.out)
    a, b = simulated(800.0).log, simulated(2000.0).log
    by_hand = np.rad2deg(
        np.abs(a.of("lwr", "joint_angles") - b.of("lwr", "joint_angles")).max(axis=0)
    )
    peaks = [abs(each["peak"]) for each in found["differences"] if each["signal"] == "joint_angles"]
    np.testing.assert_allclose(np.rad2deg(peaks), by_hand, rtol=1e-9)
    assert len(found["exceeded"]) == (by_hand > 0.05).sum() > 0
    assert "tolerance 0.05 deg" in told.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--plot", "x.jpg"], "--plot: found 'x.jpg'; expected a name that ends in .png, .pdf"),
        (["--render", "x.avi"], "--render: found 'x.avi'; expected a name that ends in .mp4"),
        (["--offset", "soon"], "found 'soon'; expected a number of seconds, or auto"),
        (["--robot", "lwx"], "--robot: no robot 'lwx' in soft; did you mean 'lwr'?"),
        (["--offset", "30"], "they overlap"),
        (["--source", "udp"], "no source 'udp' in"),
    ],
)
def test_invalid_arguments_are_rejected(
    recorded: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    assert command(*recorded, *arguments) == 2
    assert said.replace("they overlap", "expected runs that overlap") in capsys.readouterr().err


@pytest.mark.gl
def test_several_recordings_have_one_row_each(
    recorded: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    soft, stiff = recorded
    table, broken = tmp_path / "table.csv", tmp_path / "broken.mcap"
    broken.write_bytes(b"none")
    assert command(soft, stiff, "--json") == 0
    told = json.loads(capsys.readouterr().out)["differences"]
    torques = [each for each in told if each["signal"] == "torques"]
    worst = max(torques, key=lambda each: abs(each["peak"]))
    asked = ["--tolerance-angle", 0.05, "--table", table]
    assert command(soft, stiff, soft, broken, *asked) == 2
    shown = capsys.readouterr()
    assert f"{stiff}: " in shown.err and "differs by" in shown.err and f"{broken} is" in shown.err
    names = [str(path) for path in (stiff, soft, broken)]
    title, _, *lines = shown.out.splitlines()
    assert title.strip() == f"each minus {soft}"
    assert [line.split()[0] for line in lines if line.startswith("/")] == names
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == names
    assert float(rows[0]["torques.peak"]) == worst["peak"]
    assert rows[0]["torques.joint"] == worst["joint"]
    assert float(rows[1]["torques.peak"]) == 0 and rows[1]["exceeded"] == ""
    assert rows[2]["torques.peak"] == "" and "MCAP" in rows[2]["error"]
    assert command("--each", soft, stiff, "--against-model", "--json", "--quiet") == 0
    each = json.loads(capsys.readouterr().out)
    assert [row["recording"] for row in each] == [str(soft), str(stiff)]
    assert abs(each[0]["torques.peak"]) < 1e-9 and each[0]["error"] == ""  # it is its own model


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a", "b", "c", "--plot", "x.pdf"], "--plot needs a single comparison"),
        (["a", "b", "--jobs", "2"], "--jobs needs --table or --each"),
        pytest.param(
            ["a", "b", "--engine", "dask"],
            "--engine dask: expected --scheduler",
            marks=pytest.mark.extensions,
        ),
        (
            ["--each", "a", "b", "--offset", "auto"],
            "--offset cannot be combined with --each",
        ),
        (["a", "b", "c"], "a cannot be read: No such file"),
        (["a", "b", "--csv", "b.mcap"], "expected a name that ends in .csv"),
        (["--each", "a", "--tolerance-angle", "1"], "--tolerance-angle cannot be combined with"),
    ],
)
def test_incompatible_options_for_several_recordings_are_rejected(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(*arguments) == 2
    assert said in capsys.readouterr().err


def test_image_shows_the_difference_as_arrows_and_the_other_run_as_double(
    recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    from sero_mj.data.drive.mirror import Mirror

    a, b = simulated(800.0).log, simulated(2000.0).log
    scene = compare_scene(align(a, b))
    assert scene.robots["lwr"].arrow_quantity == "torque_error"
    assert "lwr" not in {double.name for double in scene.doubles.values()}
    with Mirror(scene) as mirror:
        world, data = mirror.world, mirror.data
        for k in (50, 250, 500):
            mirror.advance(a.times[k] + 1e-4)
            near = slice(max(k - 5, 0), k + 1)  # films need not every row
            for target, wanted in (
                ("lwr.commanded_torques", a.of("lwr", "torques")),
                ("lwr.torques", b.of("lwr", "torques")),
                ("b.joint_angles", b.of("lwr", "joint_angles")),
            ):
                shown = data.userdata[world.slots[target]]
                assert (np.abs(wanted[near] - shown).max(axis=1) == 0.0).any(), target
            shown = data.qpos[world.robots["lwr"].qpos]
            assert (np.abs(a.of("lwr", "joint_angles")[near] - shown).max(axis=1) == 0.0).any()


@pytest.mark.thorough
@pytest.mark.gl
def test_video_has_the_duration_of_the_runs(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    import av

    film = tmp_path / "film.mp4"
    assert command(*recorded, "--render", film, "--size", "160x120", "--quiet") == 0
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 15  # 0.5 s
    assert frames[0].shape == (120, 160, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 40


@pytest.mark.thorough
@pytest.mark.gl
def test_differences_are_blue_or_orange_and_the_other_run_green(tmp_path: Path) -> None:
    from PIL import Image

    from sero_mj.viewer.image.render import render_image

    log = simulated().log

    def count(name: str, **signals: float) -> tuple[int, int, int]:
        """Pixels of the double's, the negative and the positive arrows' colours."""
        folder = tmp_path / name
        folder.mkdir()
        scene = compare_scene(align(log, shifted(log, **signals)))
        scene.robots["lwr"].show_billboards = False
        render_image(scene, folder / "x.png", size=(320, 200), wait=0.0)
        r, g, b = np.moveaxis(np.asarray(Image.open(folder / "x.png").convert("RGB"), int), -1, 0)
        return (
            int(((g > r + 40) & (g > b + 20)).sum()),
            int(((b > r + 90) & (b > g + 60)).sum()),
            int(((r > b + 110) & (r > g + 50)).sum()),
        )

    same, other = count("same"), count("other", lwr_joint_angles=0.5)
    more, less = count("more", lwr_torques=-40.0), count("less", lwr_torques=40.0)
    assert other[0] > 300
    assert same[0] < 20
    assert more[2] > same[2] + 100
    assert more[1] < 20
    assert less[1] > same[1] + 100


@pytest.mark.extensions
def test_joint_measured_as_commanded_has_no_explanation(tmp_path, capsys) -> None:
    """Even if its constant torque looks like a sensor that is stuck."""
    scene = tmp_path / "crane.toml"
    scene.write_text(
        '[robots.crane]\ndh_convention = "craig"\ntorque_limits = [120, 120, 60]\n'
        "dh_params = [[0, 0, 0, 0.35], [1.5708, 0, 0, 0], [0, 0.4, 0, 0]]\n"
        # Otherwise, friction in proportion to the velocity would explain the difference of J1.
        "[robots.crane.dynamics]\nmotor_inertias = [0.1, 0.1, 0.1]\n"
        "viscous_friction = [0, 0, 0]\ncoulomb_friction = [0, 0, 0]\n"
        '[sources.udp]\nkind = "udp"\nport = 32123\nstructure = "3F3F3F"\n[routes]\n'
        '"crane.joint_angles" = "udp.values0"\n"crane.torques" = "udp.values1"\n'
        '"crane.commanded_torques" = "udp.values2"\n'
    )
    t = np.arange(1500) / 500
    commanded = np.stack([20 * np.cos(t), -70 * np.cos(t), np.full_like(t, -25.0)], axis=1)
    measured = commanded * [0.9, 1.0, 1.0] + [0.0, 4.0, 0.0]
    angles = np.stack([0.8 * np.sin(t), 0.6 + 0.3 * np.sin(2 * t), np.full_like(t, -0.9)], axis=1)
    path = tmp_path / "crane.mcap"
    with RecordingWriter(path, about={}) as writer:
        writer.add_source(
            "udp", kind="udp", declared={"structure": "3F3F3F"}, size=72,
            events={"values0": (3,), "values1": (3,), "values2": (3,)},
        )  # fmt: skip
        rows = np.ascontiguousarray(np.hstack([angles, measured, commanded])).view(np.uint8)
        writer.write_rows("udp", rows, writer.clock.monotonic_ns / 1e9 + t)
    assert command(path, "--scene", scene) == 0
    lines = capsys.readouterr().out.partition("explanation of")[2].splitlines()
    told = {line.split()[0]: line for line in lines if line.startswith("  J")}
    assert "no difference found" in told["J3"]
    assert "no difference found" not in told["J1"] + told["J2"]
