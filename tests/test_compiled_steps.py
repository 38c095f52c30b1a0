"""Steps as machine code against those in Python, and what is told where there are none."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numba
import numpy as np
import pytest
from test_scenarios import lwr, scenario

from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.surroundings import Object
from sero_mj.cli import main
from sero_mj.control.jit import compiled, folder_of, when_compiling
from sero_mj.control.make_controller import CONTROLLERS, controller_from
from sero_mj.control.robot_model import RobotModel
from sero_mj.errors import DeclarationError, SimulationError
from sero_mj.runs.run_log import event_of
from sero_mj.simulate.compiled_steps import LAWS
from sero_mj.simulate.constraint_arrays import ConstraintArrays
from sero_mj.simulate.simulation import Simulation

# What is compiled at first takes half a minute.
pytestmark = pytest.mark.timeout(400)
SWING = {"kind": "sine", "amplitude_deg": 6.0, "frequency": 1.0, "ramp": 0.1}
PUSH = {"kind": "force", "at": "lwr/flange", "force": [5.0, 10.0, -40.0], "begin": 0.05, "end": 0.1}
WEIGHT = {"kind": "payload", "robot": "lwr", "mass": 2.0, "begin": 0.06}


def finger(**fields: Any) -> SerialRobot:
    """Two joints, of which the second follows the first, with friction."""
    declared: dict[str, Any] = {
        "dh_convention": "craig",
        "dh_params": [[0.0, np.pi / 2, 0.0, 0.0], [0.08, 0.0, 0.0, 0.0]],
        "joint_names": ["base", "tip"],
        "couplings": {"tip": {"to": "base", "ratio": 0.5}},
        "dynamics": {
            "masses": [0.5, 0.3, 0.2],
            "centers_of_mass": [[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [0.03, 0.0, 0.0]],
            "inertias": [[1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0]] * 3,
            "motor_inertias": [0.01] * 2,
            "coulomb_friction": [0.02] * 2,
            "viscous_friction": [0.01] * 2,
        },
        "torque_limits": [5.0, 5.0],
        "base_frame": {"xyz": [0.0, 3.0, 0.5]},
        "name": "finger",
    }
    return SerialRobot(**{**declared, **fields})


def three(*, jit: bool, **fields: Any) -> Simulation:
    """A finger, and LWRs with joint impedance and feed-forward, and with Cartesian impedance."""
    other = lwr(name="other", base_frame={"xyz": [0.0, 1.5, 0.0]})
    declared: dict[str, Any] = {
        "robots": [lwr(), finger(), other],
        "controllers": {
            "lwr": {"kind": "joint_position", "stiffness": 2000.0},
            "finger": {"kind": "gravity_compensation", "damping": 0.05},
            "other": {"kind": "cartesian_impedance", "axes": "flange"},
        },
        "targets": {"lwr": SWING, "other": SWING},
        "duration": 0.25,
    }
    return Simulation(scenario(**{**declared, **fields}, jit=jit))


def difference(**fields: Any) -> float:
    """Between all that is logged by Python and by machine code, at most."""
    plain, fast = three(jit=False, **fields), three(jit=True, **fields)
    assert fast.compiled and fast.in_python == []
    plain.advance(plain.steps)
    for _ in fast.run(chunk=70):
        pass
    assert fast.step == plain.step == plain.steps
    assert fast.plant.actual == pytest.approx(plain.plant.actual, abs=1e-9)
    assert np.abs(plain.rows[1:] - plain.rows[:-1]).max() > 0.01
    return float(np.abs(plain.rows - fast.rows).max())


@pytest.mark.parametrize(
    "run",
    [
        {},
        {"elastic": True},
        {"physics_timestep": 2.5e-4, "drive_delay": 5e-4},
        {"torque_control": True, "elastic": False},
        {"torque_control": True, "elastic": False, "drive_delay": 1 / 3000},
        {"observer_gain": 200.0, "timestep": 5e-4},
        {
            "controllers": {
                "lwr": {"kind": "joint_impedance", "stiffness": 500.0, "damping": 0.3},
                "other": {"kind": "cartesian_impedance", "torque_limits": 30.0},
                "finger": {"kind": "torque", "torques": [0.3, -0.1]},
            }
        },
        {
            "sensors": {
                "lwr": {
                    "torques": {"noise": 0.05, "resolution": 0.01, "gain": 1.02},
                    "angles": {"resolution": 1e-5},
                    "velocity_filter": 500.0,
                },
                "other": {"velocities": {"bias": 1e-3}},
            },
            "duration": 0.6,
        },
        {
            "sensors": {"lwr": {"torques": {"noise": 0.1}, "velocity_filter": 300.0}},
            "torque_control": True,
            "elastic": False,
        },
        {"sensors": {"lwr": {"angles": {"noise": 1e-5}}}, "elastic": True},
    ],
    ids=" ".join,
)
def test_machine_code_logs_what_python_logs(run: dict[str, Any]) -> None:
    assert difference(**run) < 1e-9


def test_what_begins_and_ends_meanwhile_is_as_in_python() -> None:
    faults = {
        "drive": {"kind": "controller", "joints": ["A3"], "gain": 0.5, "begin": 0.03, "end": 0.07},
        "grip": {"kind": "friction", "joints": ["A2"], "coulomb": 20.0, "begin": 0.08},
        "encoder": {"kind": "dead_sensor", "signal": "torques", "joints": ["A1"], "begin": 0.2},
    }
    for fault in faults.values():
        fault["robot"] = "lwr"
    assert difference(disturbances={"push": PUSH, "weight": WEIGHT}, faults=faults) < 1e-9


def test_contacts_are_logged() -> None:
    table = Object(name="table", shape="box", size=[0.5, 0.5, 0.4], frame={"xyz": [-0.6, 0.0, 0.0]})
    down = {"kind": "cartesian_way_points", "relative_to": "start", "times": [0.4],
            "poses": [{"xyz": [0.0, 0.0, 0.15]}]}  # fmt: skip
    robot = lwr(joint_angles=[0.0, 0.8, 0.0, -1.3, 0.0, 1.04, 0.0])
    other = lwr(name="other", base_frame={"xyz": [0.0, 1.5, 0.0]})
    fields: dict[str, Any] = {
        "robots": [other, finger(), robot],
        "controllers": {
            "other": {"kind": "joint_position", "stiffness": 2000.0},
            "finger": {"kind": "joint_impedance", "stiffness": 20.0},
            "lwr": {"kind": "cartesian_impedance"},
        },
        "targets": {"other": SWING, "lwr": down},
        "objects": [table],
        "timestep": 5e-4,
        "duration": 0.5,
    }
    assert difference(**fields) < 1e-6
    force = three(jit=True, **fields)
    force.advance(force.steps)
    pressed = force.rows[:, force.layout.columns[event_of("lwr", "contact_force")]]
    assert np.linalg.norm(pressed, axis=1).max() > 5.0


def poison(simulation: Simulation) -> None:
    simulation._robots[0].law_controller.work.gains[2, 2] = np.nan  # type: ignore[attr-defined]


def kick(simulation: Simulation) -> None:
    simulation.plant.data.qvel[3] = 1e11


WRONG_SIGN = {"kind": "controller", "robot": "lwr", "joints": ["A3"], "begin": 0.03, "gain": -1.0}


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda _: None, "more than 3 times its velocity limit"),
        (kick, "the motion is unstable"),
        (poison, "the controller asks for nan Nm; expected a finite number"),
    ],
)
def test_what_ends_a_run_ends_it_where_python_does(spoil: Any, told: str) -> None:
    messages, steps = [], []
    for jit in (False, True):
        simulation = three(jit=jit, faults={"it": WRONG_SIGN}, duration=2.0)
        simulation.advance(20)
        spoil(simulation)
        with pytest.raises(SimulationError) as caught:
            simulation.advance(simulation.steps)
        messages.append(str(caught.value))
        steps.append(simulation.step)
        assert np.isfinite(simulation.log.of("lwr", "joint_angles")).all()
    assert messages[0] == messages[1] and steps[0] == steps[1]
    assert messages[0].startswith("lwr/") and told in messages[0]


def test_a_run_goes_on_after_a_restart() -> None:
    plain, fast = three(jit=False), three(jit=True)
    for simulation in (plain, fast):
        simulation.advance(60)
        simulation.restart(simulation._start + 0.01, seed=3)
        simulation.advance(200)
    assert fast.rows == pytest.approx(plain.rows, abs=1e-9)


def test_every_shipped_controller_has_a_law() -> None:
    model = RobotModel.of(lwr())
    for kind in CONTROLLERS:
        fields = {"stiffness": 500.0} if kind == "joint_impedance" else {}
        made = controller_from({"kind": kind, **fields}).make(model, 1e-3)
        assert type(made.work) in LAWS, kind  # type: ignore[attr-defined]


class Wave:
    """A user's controller."""

    def torques(self, sensed: Any, target: Any, out: Any) -> None:
        out[:] = np.sin(sensed.time)


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"controllers": {"lwr": Wave()}}, "the controller of lwr is not one of sero-mj's"),
        ({"controllers": {"lwr": {"kind": "gravity_compensation", "torque_rate_limits": 100.0}}},
         "controllers.lwr.torque_rate_limits"),
        ({"sensors": {"lwr": {"torques": {"delay": 3}}}}, "sensors are late"),
        ({"torque_control": True, "elastic": True},
         "elastic joints of lwr behind a torque loop"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_what_needs_python_is_told_and_done_there(fields: dict[str, Any], why: str) -> None:
    def rows(**jit: bool) -> Any:
        simulation = Simulation(scenario(duration=0.05, **fields, **jit))
        simulation.advance(50)
        return simulation, simulation.rows

    simulation, compiled_rows = rows(jit=True)
    assert simulation.in_python == [why] and simulation.compiled is None
    assert np.array_equal(compiled_rows, rows()[1])


@pytest.mark.parametrize("quiet", [["--quiet"], []])
def test_the_command_says_what_is_in_python(
    quiet: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "noisy.toml"
    file.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[run]\nduration = 0.05\njit = true\n'
        "[sensors.lwr]\ntorques = { delay = 2 }\n"
    )
    with pytest.raises(SystemExit) as caught:
        main(["simulate", str(file), *quiet])
    assert caught.value.code == 0
    said = "sero-mj: run.jit: steps are made in Python, since sensors are late\n"
    assert capsys.readouterr().err == ("" if quiet else said)


@pytest.fixture
def no_numba(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for module in ("sero_mj.simulate.compiled_steps", "sero_mj.control.jit"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "numba", None)
    yield


@pytest.mark.usefixtures("no_numba")
def test_without_numba_it_is_told_what_to_install() -> None:
    with pytest.raises(
        DeclarationError, match=r"run\.jit: found true, but no numba; expected pip"
    ) as e:
        Simulation(scenario(jit=True))
    assert "pip install 'sero-mj[jit]', or false" in str(e.value)
    assert Simulation(scenario()).in_python == []


def test_what_is_loaded_beforehand_makes_no_step_and_draws_no_noise() -> None:
    sensors = {"lwr": {"torques": {"noise": 0.1}}}
    plain, fast = (three(jit=True, sensors=sensors, duration=0.1) for _ in range(2))
    assert fast.compiled is not None
    fast.compiled.load()
    assert fast.step == 0
    for simulation in (plain, fast):
        simulation.advance(simulation.steps)
    assert np.array_equal(plain.rows, fast.rows)


@pytest.fixture
def law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Any]]:
    """Compiles a small law, or takes it from its files, as another process would."""
    (tmp_path / "small_law.py").write_text("def twice(x):\n    return x + x\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    def take() -> Any:
        sys.modules.pop("small_law", None)
        return compiled(importlib.import_module("small_law").twice)

    yield take
    sys.modules.pop("small_law", None)


@pytest.mark.parametrize("ending", ["nbc", "nbi"])
@pytest.mark.parametrize("left", [0, 20])
def test_damaged_files_are_made_anew(
    law: Any, ending: str, left: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert law()(2.0) == 4.0
    assert folder_of(law()) == tmp_path / "__pycache__"
    (file,) = (tmp_path / "__pycache__").glob(f"small_law.*.{ending}")
    os.truncate(file, left)
    for hits in (0, 1):
        caplog.clear()
        machine_code = law()
        assert machine_code(3.0) == 6.0
        assert sum(machine_code.stats.cache_hits.values()) == hits
        said = f"{tmp_path}/__pycache__: what was compiled is damaged ("
        assert [text.startswith(said) for text in caplog.messages] == [True] * (1 - hits)


def test_without_room_for_files_it_runs_all_the_same(
    law: Any, caplog: pytest.LogCaptureFixture
) -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    machine_code = law()
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        assert machine_code(3.0) == 6.0
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    (text,) = caplog.messages
    assert text.endswith("what was compiled cannot be kept ([Errno 27] File too large)")


def test_compiling_is_told_once() -> None:
    def twice(x: Any) -> Any:
        return x + x

    told: list[str] = []
    fast = numba.njit(twice)  # it is not kept
    with when_compiling(lambda: told.append("now")):
        assert fast(2) == 4
        assert fast(2.5) == 5.0
    with when_compiling(lambda: told.append("again")):
        assert fast(3) == 6
    assert told == ["now"]


def test_constraints_are_where_mujoco_says() -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><geom type="plane" size="1 1 1"/>
        <body pos="0 0 0.09"><freejoint/><geom size="0.1"/></body>
        <body pos="1 0 1"><joint name="a" frictionloss="0.5" range="-1 1" limited="true"/>
          <joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>
      </worldbody><equality><joint joint1="a" joint2="b"/></equality></mujoco>""")
    data = mujoco.MjData(model)
    arrays = ConstraintArrays.of(data)
    data.qpos[7] = 1.2  # beyond its stop
    for _ in range(3):
        mujoco.mj_step(model, data)
        expected = [data.ncon, data.ne, data.nf, data.nl, data.nefc]
        assert arrays.counts.tolist() == expected and min(expected) > 0
        first = (arrays.force_pointer[0] - arrays.arena_address) // 8
        forces = arrays.arena[first : first + data.nefc]
        assert np.array_equal(forces, data.efc_force) and np.abs(forces).max() > 0
