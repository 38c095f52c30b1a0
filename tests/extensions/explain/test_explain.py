from __future__ import annotations

import json
import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with, sampled
from explain_runs import BEGIN, finished, simulated_swing, swing, swinging
from runs import HOME, record_packets, record_run, two_joints

from sero_mj.base.errors import UsageError
from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.extensions.explain.edges import Edges, _erf
from sero_mj.extensions.explain.explain import explain, explain_run, explain_runs
from sero_mj.extensions.explain.link_torques import body_torques, link_torques, torques_by_angle
from sero_mj.extensions.explain.torque_residuals import (
    _jumps,
    pair_with_model,
    torque_residuals,
)
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.external_loads import attach_payload
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.align import pair_with_commands
from sero_mj.study.compare import compare_scene, explanations_table
from sero_mj.study.explanation import FLANGE, LINKS, Explanation

# A robot that sends measured and commanded values without a time stamp.
LATE = """
[robots.lwr]
model = "lwr"

[sources.udp]
kind = "udp"
port = 32000
structure = "7F7F7F"

[routes]
"lwr.joint_angles" = "udp.values0"
"lwr.torques" = "udp.values1"
"lwr.commanded_torques" = "udp.values2"
"""


def explanations_of(log: RunLog) -> list[Explanation]:
    return explain_run(log, "lwr")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("loop", [False, True])
def test_run_without_a_fault_has_no_explanation(seed: int, loop: bool) -> None:
    found = torque_residuals(swing(seed=seed, loop=loop), "lwr")
    assert found.torque_control is loop
    assert explain_run(swing(seed=seed, loop=loop), "lwr", found) == []


@pytest.mark.parametrize(
    ("fault", "kind", "part", "size", "tolerance"),
    [
        ({"kind": "sensor", "gain": -1.0}, "sign", "torque sensor", -1.0, 0.02),
        ({"kind": "sensor", "gain": 0.8}, "gain", "torque sensor", 0.8, 0.01),
        ({"kind": "sensor", "bias": -4.0}, "bias", "torque sensor", -4.0, 0.1),
        ({"kind": "sensor", "delay_ms": 40}, "delay", "torque sensor", 0.040, 0.006),
        ({"kind": "sensor", "noise": 0.6}, "noise", "torque sensor", 0.6, 0.1),
        ({"kind": "frozen_sensor"}, "stuck", "torque sensor", None, 0.0),
        ({"kind": "dead_sensor"}, "stuck", "torque sensor", 0.0, 0.0),
        ({"kind": "controller", "gain": 1.3}, "gain", "drive", 1.3, 0.01),
        ({"kind": "controller", "gain": -1.0}, "sign", "drive", -1.0, 0.1),
        ({"kind": "encoder_offset", "offset_deg": 1.0}, "encoder", "encoder", 1.0, 0.02),
        ({"kind": "friction", "added_coulomb": 1.5}, "friction", "joint", 1.5, 0.1),
        ({"kind": "friction", "added_coulomb": 1000}, "stuck", "joint", None, 0.0),
    ],
)
def test_fault_is_identified_with_its_joint_size_and_time(
    fault: dict[str, Any], kind: str, part: str, size: float | None, tolerance: float
) -> None:
    first, *_ = explanations_of(swing(json.dumps({**fault, "joints": ["A2"]})))
    assert (first.joint, first.kind, first.part) == ("A2", kind, part), first
    assert first.begin == pytest.approx(BEGIN, abs=0.11)
    assert not first.from_start
    if size is not None:
        assert first.size == pytest.approx(size, abs=tolerance)
    # A drive with the wrong sign runs away, so there is little data.
    assert first.confidence > (0.8 if (kind, part) == ("sign", "drive") else 0.9)


@pytest.mark.thorough
def test_payload_is_found_from_all_joints_with_its_center_and_end() -> None:
    load = {"kind": "payload", "robot": "lwr", "mass": 2.5, "end": 2.1,
            "center_of_mass": [0.02, -0.03, 0.1]}  # fmt: skip
    for loop in (False, True):
        (found,) = explanations_of(swing(load=json.dumps(load), loop=loop))
        assert (found.joint, found.kind, found.unit) == (FLANGE, "payload", "kg")
        assert found.size == pytest.approx(2.5, abs=0.03)
        assert [found.values[axis] for axis in "xyz"] == pytest.approx([0.02, -0.03, 0.1], abs=0.01)
        assert (found.begin, found.end) == pytest.approx((BEGIN, 2.1), abs=0.03)
        assert {"A2", "A3"} < set(found.joints)


@pytest.mark.parametrize("loop", sampled([False, True], 0))
def test_deviating_masses_are_not_a_payload(loop: bool) -> None:
    log = swing(loop=loop)
    robot = log.robots["lwr"]
    # The robot is 10 % heavier than declared.
    scale = {"mass_scale": robot.dynamics.mass_scale / 1.1}
    declared = robot.model_copy(update={"dynamics": robot.dynamics.model_copy(update=scale)})
    (found,) = explanations_of(replace(log, robots={"lwr": declared}))
    assert (found.joint, found.kind, found.part) == (LINKS, "masses", "links")
    assert found.size == pytest.approx(10.0, abs=0.1) and found.unit == "%"
    assert found.from_start and found.end is None and found.confidence > 0.9
    assert "% relative to the declared masses, from the start" in str(found)
    assert {"A1", "A2", "A3"} < set(found.joints)


@pytest.mark.parametrize("joint", ["A2", "A5"])
def test_drive_with_wrong_sign_is_identified_although_its_loop_diverges(joint: str) -> None:
    log = swing(json.dumps({"kind": "controller", "gain": -1.0, "joints": [joint]}), loop=True)
    assert log.times[-1] < BEGIN + 0.3
    found, *_ = [each for each in explanations_of(log) if each.joint == joint]
    assert (found.kind, found.part) == ("sign", "drive")
    assert found.begin == pytest.approx(BEGIN, abs=0.05)


def with_drive(
    joint: str,
    drive: Callable[[float, float], float],
    stiffness: float = 1200,
    duration: float = 2.6,
) -> RunLog:
    """Returns a run in which a joint's drive is a function of time and commanded torque."""
    simulation = Simulation(swinging("{}", "{}", stiffness=stiffness, duration=duration))
    rows, k = simulation.plant.rows, simulation.log.robots["lwr"].names.index(joint)
    step = rows.step

    def stepped(torques: Array) -> Array:
        given = torques.copy()
        given[0, k] = drive(simulation.time, float(torques[0, k]))
        return step(given)

    rows.step = stepped  # type: ignore[method-assign]
    return finished(simulation).log


@pytest.mark.parametrize(("joint", "share"), sampled([["A2", 1.7], ["A1", 2.0], ["A3", 2.3]], 0))
def test_drive_bias_of_twice_the_gravity_torque_is_not_a_wrong_sign(
    joint: str, share: float
) -> None:
    k = swing().robots["lwr"].names.index(joint)
    # The commands are its opposite.
    bias = share * float(swing().of("lwr", "torques")[-200:, k].mean())
    (found,) = explanations_of(with_drive(joint, lambda t, u: u + bias * (t >= BEGIN)))
    assert (found.joint, found.kind, found.part) == (joint, "bias", "drive")
    assert found.size == pytest.approx(bias, rel=0.01)


@pytest.mark.parametrize(
    ("joint", "delay", "begin"),
    sampled([["A6", 0.06, BEGIN], ["A3", 0.1, 0.0], ["A2", 0.06, 0.0]], 1),
)
def test_drive_delay_is_identified_also_when_the_arm_oscillates(
    joint: str, delay: float, begin: float
) -> None:
    late = deque[float](maxlen=round(delay / 1e-3) + 1)

    def drive(time: float, torque: float) -> float:
        late.append(torque)
        return late[0] if time >= begin else torque

    (found,) = explanations_of(with_drive(joint, drive, stiffness=400, duration=3.0))
    assert (found.joint, found.kind, found.part) == (joint, "delay", "drive")
    assert found.size == pytest.approx(delay, abs=0.002)
    assert found.begin == pytest.approx(begin, abs=0.11)


@pytest.mark.parametrize(
    "fault", sampled([{}, {"kind": "sensor", "bias": -4.0, "joints": ["A2"]}], 1)
)
def test_packets_in_bursts_are_not_a_contact(fault: dict[str, Any], tmp_path: Path) -> None:
    log, size = swing(json.dumps(fault)), 4
    signals = ("joint_angles", "torques", "commanded_torques")
    rows = {f"values{i}": log.of("lwr", signal) for i, signal in enumerate(signals)}
    number = np.arange(len(log.times))
    arrivals = 1e-3 * (size * (number // size + 1) - 1) + 8e-6 * (number % size)
    path = record_packets(tmp_path / "held.mcap", "7F7F7F", rows, arrivals, {"scene.toml": LATE})
    found = [(each.joint, each.kind) for each in explanations_of(read_run(path))]
    assert found == ([("A2", "bias")] if fault else [])


def test_frozen_sensor_outside_the_compared_time_is_not_reported() -> None:
    """For example, of a robot at rest before another run begins."""
    found = torque_residuals(swing(), "lwr")
    before = float(found.times[0]) - 1.0
    held = ((before, before + 0.9, 1.5),) * found.robot.n
    noise = replace(found.noise, held=held)
    assert explain(replace(found, noise=noise)) == explain(found)


@pytest.mark.thorough
def test_several_faults_are_distinguished() -> None:
    fault = json.dumps({"kind": "sensor", "bias": 5.0, "joints": ["A3"]})
    load = json.dumps({"kind": "payload", "robot": "lwr", "mass": 2.0, "begin": 1.9})
    found = {(each.joint, each.kind): each for each in explanations_of(swing(fault, load))}
    assert set(found) == {("A3", "bias"), (FLANGE, "payload")}
    assert found["A3", "bias"].size == pytest.approx(5.0, abs=0.1)
    assert found[FLANGE, "payload"].size == pytest.approx(2.0, abs=0.05)


@pytest.mark.thorough
def test_push_is_not_a_fault_of_the_robot() -> None:
    push = {"kind": "force", "at": "lwr/flange", "force": [0, 25, 0], "end": 2.2,
            "profile": "half_sine"}  # fmt: skip
    found = explanations_of(swing(load=json.dumps(push)))
    assert {"A1", "E1"} <= {each.joint for each in found if each.kind == "unexplained"}
    assert FLANGE not in {each.joint for each in found}


@pytest.mark.thorough
def test_runs_are_distinguished_by_faults_in_only_one_of_them() -> None:
    fault = json.dumps({"kind": "sensor", "bias": -4.0, "joints": ["A2"]})
    a, b = swing(fault), swing(seed=5)
    both = "lwr", "lwr"
    assert explain_runs(b, swing(seed=6), both) == []
    (mine,) = explain_runs(a, b, both)
    assert (mine.joint, mine.kind, mine.size) == ("A2", "bias", pytest.approx(-4.0, abs=0.1))
    (theirs,) = explain_runs(b, a, both)
    assert theirs.size == pytest.approx(-4.0, abs=0.1) and theirs.is_second
    assert theirs.confidence > 0.9
    # Started later by another clock.
    later = RunLog(b.robots, b.signals, b.times + 0.7, "later")
    (moved,) = explain_runs(a, later, both, offset=-0.7)
    assert moved.begin == pytest.approx(BEGIN, abs=0.03)


@pytest.mark.parametrize(
    ("fault", "kind"),
    sampled(
        [
            [{"kind": "sensor", "noise": 0.6}, "noise"],
            [{"kind": "sensor", "delay_ms": 40}, "delay"],
            [{"kind": "sensor", "gain": -1.0}, "sign"],
            [{"kind": "frozen_sensor"}, "stuck"],
        ],
        2,
    ),
)
def test_fault_is_reported_for_its_run_in_either_order(fault: dict[str, Any], kind: str) -> None:
    broken, sound = swing(json.dumps({**fault, "joints": ["A2"]})), swing(seed=5)
    for a, b, is_second in ((broken, sound, False), (sound, broken, True)):
        first, *more = explain_runs(a, b, ("lwr", "lwr"))
        assert not [each for each in more if each.joint == "A2"]
        assert (first.joint, first.kind, first.is_second) == ("A2", kind, is_second)
        assert first.begin == pytest.approx(BEGIN, abs=0.11)
        assert (", in B" in first.text, " in B" in first.short) == (is_second, is_second)


@pytest.mark.thorough
def test_difference_of_two_gains_is_reported() -> None:
    runs = [
        swing(json.dumps({"kind": "sensor", "gain": gain, "joints": ["A2"]}), seed=seed)
        for seed, gain in ((0, 0.8), (1, 0.5))
    ]
    sound = swing(seed=5)
    for a, b, size, end in (
        (*runs, 0.3, ", A minus B"), (sound, runs[1], 0.5, ", in B"), (runs[0], sound, 0.8, ""),
    ):  # fmt: skip
        (found,) = explain_runs(a, b, ("lwr", "lwr"))
        assert (found.joint, found.kind, found.part) == ("A2", "gain", "torque sensor")
        assert found.size == pytest.approx(size, abs=0.01)
        assert re.fullmatch(rf"gain: \+?{size:.1f}.* of the torque sensor{end}", found.text)


@pytest.mark.parametrize(
    ("fault", "load", "kind", "size"),
    sampled(
        [
            [{}, {"kind": "payload", "robot": "lwr", "mass": 2.5}, "payload", 2.5],
            [{"kind": "friction", "added_coulomb": 1.5}, {}, "friction", 1.5],
            [{"kind": "encoder_offset", "offset_deg": 1.0}, {}, "encoder", 1.0],
        ],
        2,
    ),
)
def test_fault_of_the_second_run_has_its_own_size(
    fault: dict[str, Any], load: dict[str, Any], kind: str, size: float
) -> None:
    joints = {"joints": ["A2"]} if fault else {}
    broken = swing(json.dumps({**fault, **joints}), json.dumps(load))
    (found,) = explain_runs(swing(seed=5), broken, ("lwr", "lwr"))
    assert (found.kind, found.is_second) == (kind, True)
    assert found.size == pytest.approx(size, abs=0.05)
    assert found.confidence > 0.9
    assert found.text.endswith(", in B")


def test_commands_alone_suffice_without_link_masses() -> None:
    found = torque_residuals(
        swing(json.dumps({"kind": "controller", "gain": 0.7, "joints": ["A2"]})), "lwr"
    )
    first, *_ = explain(replace(found, no_model="estimated"))
    assert (first.joint, first.kind) == ("A2", "gain")
    assert first.size == pytest.approx(0.7, abs=0.05)


def test_arm_with_coupled_fingers_is_examined_without_them() -> None:
    log = swing(json.dumps({"kind": "sensor", "gain": 0.7, "joints": ["A2"]}))
    couplings = {"A6": {"to": "A5", "ratio": -1.0}}
    coupled = SerialRobot.from_model("lwr", joint_angles=HOME[:6], couplings=couplings)
    found = torque_residuals(replace(log, robots={"lwr": coupled}), "lwr")
    assert found.has_model
    assert np.isnan(found.link[:, 5:]).all()
    np.testing.assert_array_equal(found.link[:, :5], torque_residuals(log, "lwr").link[:, :5])
    first, *_ = explain(found)
    assert (first.joint, first.kind, first.part) == ("A2", "gain", "torque sensor")


@pytest.mark.parametrize("robot", ["lwr", "stanford"])
def test_torques_of_a_body_equal_the_mujoco_difference_with_and_without_it(robot: str) -> None:
    base = np.array([[0.0, -1, 0, 0.1], [0.8, 0, 0.6, 0], [-0.6, 0, 0.8, 0.3], [0, 0, 0, 1]])
    arm = SerialRobot.from_model(robot, name="arm", base_frame=base)
    rng = np.random.default_rng(4)
    q, v, a = rng.normal(0.0, 0.5, (3, 20, arm.n))
    mass, center, tensor = 1.7, np.array([0.03, -0.02, 0.11]), np.diag([0.02, 0.03, 0.015])
    world = World(Scene(robots=[arm], floor=False), dynamic=True)
    attach_payload(world.model, "arm", mass, center, tensor)
    part = world.robots["arm"]
    joints = [int(world.model.dof_jntid[dof]) for dof in part.dofs]
    loaded = RobotModel(world.model, joints, body=part.flange_body)
    about = tensor + mass * (center @ center * np.eye(3) - np.outer(center, center))
    parameters = [mass, *(mass * center), *np.diag(about), about[0, 1], about[0, 2], about[1, 2]]
    by_regressor = link_torques(arm, q, v, a) + body_torques(arm, q, v, a) @ parameters
    for k in range(20):
        loaded.update(q[k], v[k])
        M = loaded.mass() - np.diag(loaded.motor_inertia)
        expected = M @ a[k] + loaded.coriolis() + loaded.gravity()
        np.testing.assert_allclose(by_regressor[k], expected, atol=1e-6)


@pytest.mark.parametrize("robot", ["lwr", "stanford"])
def test_torque_derivatives_equal_those_of_the_mujoco_energy(robot: str) -> None:
    arm = SerialRobot.from_model(robot, name="arm")
    q, still = np.random.default_rng(4).normal(0.0, 0.5, (3, arm.n)), np.zeros((3, arm.n))
    world = World(Scene(robots=[arm], floor=False), dynamic=True)
    joints = world.model.dof_jntid[world.robots["arm"].dofs]
    data, places = mujoco.MjData(world.model), world.model.jnt_qposadr[joints]

    def energy(angles: Array) -> float:
        data.qpos[places] = angles
        mujoco.mj_kinematics(world.model, data)
        mujoco.mj_comPos(world.model, data)
        mujoco.mj_energyPos(world.model, data)
        return float(data.energy[0])

    found, steps = torques_by_angle(arm, q, still, still), 1e-3 * np.eye(arm.n)
    for k, i, j in np.ndindex(3, arm.n, arm.n):
        more, less = (
            energy(q[k] + steps[i] + side) - energy(q[k] - steps[i] + side)
            for side in (steps[j], -steps[j])
        )
        assert found[k, i, j] == pytest.approx((more - less) / 4e-6, abs=1e-4)


def test_encoder_slips_are_jumps_and_coarse_resolution_is_not() -> None:
    times, rng = np.arange(2000) / 1000, np.random.default_rng(1)
    moves = np.stack([np.sin(times), 1e-3 * times, 0.1 * times, np.zeros(2000)], axis=1)
    for steps in (1e-5, 1e-3):  # coarse enough to be constant between two steps
        angles = np.round((moves + rng.normal(scale=0.3 * steps, size=moves.shape)) / steps) * steps
        assert not _jumps(np.diff(angles, n=2, axis=0)).any()
        angles[1200:, 0] += 100 * steps
        angles[:, 2][900:1000] -= 100 * steps
        rows = np.argwhere(_jumps(np.diff(angles, n=2, axis=0))).tolist()
        assert rows == [[898, 2], [899, 2], [998, 2], [999, 2], [1198, 0], [1199, 0]]


def test_perfect_run_has_no_residuals() -> None:
    log = swing()
    exact = {key.replace("actual_angles", "joint_angles").replace("actual_torques", "torques"): v
             for key, v in log.signals.items()
             if "actual" in key or "commanded" in key}  # fmt: skip
    found = torque_residuals(RunLog(log.robots, exact, log.times), "lwr")
    assert np.nanmax(np.abs(found.link)) < 1e-6
    assert np.nanmax(np.abs(found.motor)) < 2e-3  # Coulomb friction where joints rotate
    assert np.isfinite(found.motor).mean() > 0.7


def test_edge_sums_equal_direct_sums() -> None:
    rng = np.random.default_rng(2)
    edges, X, y = Edges(30, 1.9), rng.normal(size=(2, 30, 3)), rng.normal(size=(2, 30))
    sums = edges.sums(X, y)
    for first, last in ((0, 59), (0, 31), (17, 59), (14, 40)):
        H, g, _ = sums.between(first, last)
        seen = edges.share(first, last)
        shown = X * seen[:, None]
        np.testing.assert_allclose(H, np.einsum("ckp,ckq->pq", shown, shown), atol=1e-6)
        np.testing.assert_allclose(g, np.einsum("ckp,ck->p", shown, y), atol=1e-9)
    x = np.linspace(-3.0, 3.0, 61)
    np.testing.assert_allclose(_erf(x), [math.erf(each) for each in x], atol=2e-7)


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["compare", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    fault = json.dumps({"kind": "sensor", "bias": -4.0, "joints": ["A2"]})
    return record_run(simulated_swing(fault), tmp_path_factory.mktemp("recorded") / "gauge.mcap")


@pytest.mark.thorough
def test_explain_reports_an_explanation_for_every_joint(
    recorded: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert command(recorded) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "commanded minus measured: lwr" in out
    assert "A1 no difference found" in out
    assert "A2 bias: -4" in out
    assert "Nm of the torque sensor from 1.3" in out
    picture = tmp_path / "parts.svg"
    assert command(recorded, "--against-model", "--plot", picture) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "gauge minus its model: lwr" in out
    assert "first difference between lwr and its model:" in out and " at A2, from 1.3" in out
    assert "inverse dynamics of the measured motion" in out
    assert "bias -4" in picture.read_text(encoding="utf-8")
    assert command(recorded, "--against-model", "--json") == 0
    (found,) = json.loads(capsys.readouterr().out)["explanations"]
    assert (found["joint"], found["kind"], found["part"]) == ("A2", "bias", "torque sensor")
    assert found["text"].startswith("bias: -4")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["B.mcap", "--against-model"], "--against-model: found a second recording; expected one"),
        (["--offset", "1"], "--offset cannot be combined with a single recording"),
        (["--robot", "lwx"], "--robot: no robot 'lwx' in gauge; did you mean 'lwr'?"),
    ],
)
def test_incompatible_options_are_rejected(
    recorded: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert command(recorded, *arguments) == 2
    assert expected in capsys.readouterr().err


def test_too_little_data_is_an_error() -> None:
    log = swing()
    with raises_with(
        UsageError,
        key="swing",
        reason="has",
        found=0.2,
        of="s of 'lwr'",
        expected="at least 0.51 s",
    ):
        torque_residuals(log.between(1.0, 1.2), "lwr")
    angles = {"lwr_joint_angles": log.of("lwr", "joint_angles")}
    silent = RunLog(log.robots, angles, log.times, "silent")
    with raises_with(
        UsageError, key="silent", reason="has no measured torques of 'lwr'", expected="`torques`"
    ):
        torque_residuals(silent, "lwr")
    with raises_with(
        UsageError,
        key="silent",
        reason="has no torques of 'lwr'",
        expected="torques and commanded_torques, or a second recording to compare with",
    ):
        pair_with_commands(silent)


def test_robots_and_their_models_can_be_rendered_as_video() -> None:
    log = swing()
    pair = pair_with_model(log, torque_residuals(log, "lwr"))
    scene = compare_scene(pair)
    assert scene.routes["lwr.torques"] == "b.torques"
    assert pair.has_one_motion
    table = explanations_table(pair, [])
    assert table.row_count == 7


def test_prismatic_joint_has_newtons() -> None:
    robot = two_joints()
    t = np.arange(4001) * 1e-3
    q = np.stack([0.4 * np.sin(2.0 * t), 0.1 * np.cos(3.0 * t)], axis=1)
    log = RunLog({"arm": robot}, {"arm_joint_angles": q, "arm_torques": q * 0.0}, t)
    bare = torque_residuals(log, "arm")
    torques = np.stack(
        [np.interp(t, bare.times, bare.torques.model[:, k]) for k in range(2)], axis=1
    )
    torques[t > 2.0, 1] += 7.0
    log = RunLog({"arm": robot}, {"arm_joint_angles": q, "arm_torques": torques}, t)
    found = explain(replace(torque_residuals(log, "arm"), no_model=""))
    assert [(each.joint, each.kind, each.unit) for each in found] == [("slide", "bias", "N")]
    assert found[0].size == pytest.approx(7.0, abs=0.2)


def test_robot_at_rest_without_motor_inertias_or_limits_has_no_faults() -> None:
    robot = two_joints(
        torque_limits=[10.0, np.inf],
        dynamics={"motor_inertias": [0, 0], "viscous_friction": [0, 0], "coulomb_friction": [0, 0]},
    )
    t = np.arange(1001) * 1e-3
    rest = np.zeros((1001, 2))
    signals = {"arm_joint_angles": rest, "arm_torques": rest, "arm_commanded_torques": rest}
    found = torque_residuals(RunLog({"arm": robot}, signals, t), "arm")
    assert found.scale[0] == 10.0 and np.isfinite(found.scale[1])
    assert explain(found) == []
