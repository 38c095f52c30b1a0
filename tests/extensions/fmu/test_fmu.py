"""Controllers as Functional Mock-up Units: of FMI 2 and 3 from C, and one that pythonfmu makes."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_tools import GROUPS, write_fmu

from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

fmpy = pytest.importorskip("fmpy")

SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.6, 0, -1.2, 0, 1.2, 0]
[controllers.lwr]
kind = "fmu"
file = "{name}"
[targets.lwr]
kind = "sine"
amplitude_deg = 5
frequency = 0.5
[run]
duration = 0.1
"""
PYTHON = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Impedance(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for group in ("angles", "velocities", "target_angles", "gravity", "torques"):
            causality = Fmi2Causality.output if group == "torques" else Fmi2Causality.input
            for i in range(1, 8):
                name = f"{group}_{i}"
                setattr(self, name, 0.0)
                self.register_variable(Real(name, causality=causality))

    def do_step(self, time, step):
        for i in range(1, 8):
            angle, speed, wanted, gravity = (
                getattr(self, f"{group}_{i}")
                for group in ("angles", "velocities", "target_angles", "gravity"))
            setattr(self, f"torques_{i}", 800.0 * (wanted - angle) - 40.0 * speed + gravity)
        return True
"""


class Law:
    """The same control law in Python."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def torques(self, sensed: Any, target: Any, out: np.ndarray) -> None:
        self.model.update(sensed.motor_angles, sensed.motor_velocities)
        out[:] = 800.0 * (target.angles - sensed.angles) - 40.0 * sensed.velocities
        out += self.model.gravity()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmu")


def simulation(folder: Path, name: str, **settings: Any) -> Simulation:
    file = folder / "scenario.toml"
    file.write_text(SCENARIO.format(name=name))
    over = {f"controllers.lwr.{key}": value for key, value in settings.items()}
    return Simulation(read_scenario(file, over))


def signals(simulated: Simulation) -> dict[str, np.ndarray]:
    for _ in simulated.run():
        pass
    return dict(simulated.log.signals)


@pytest.fixture(scope="module")
def in_python(folder: Path) -> dict[str, np.ndarray]:
    declared = simulation(folder, write_fmu(folder, 2))
    robot = declared.controlled[0]
    declared.scenario.controllers["lwr"] = Law(declared.robot_model(robot.robot))
    return signals(Simulation(declared.scenario))


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_logs_are_those_of_the_law_in_python(
    folder: Path, version: int, in_python: dict[str, np.ndarray]
) -> None:
    found = signals(simulation(folder, write_fmu(folder, version)))
    for key, values in found.items():
        assert values == pytest.approx(in_python[key], abs=1e-9), key


def test_unit_made_by_another_tool_is_run(folder: Path, in_python: dict[str, np.ndarray]) -> None:
    pytest.importorskip("pythonfmu")
    (folder / "impedance.py").write_text(PYTHON)
    command = [
        sys.executable,
        "-m",
        "pythonfmu",
        "build",
        "-f",
        "impedance.py",
        "--no-external-tool",
    ]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    found = signals(simulation(folder, "Impedance.fmu"))
    for key, values in found.items():
        assert values == pytest.approx(in_python[key], abs=1e-9), key


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_inputs_may_be_mapped_and_parameters_set(folder: Path, version: int) -> None:
    names = ["q", "velocities", "target_angles", "gravity"]
    name = write_fmu(folder, version, names, f"mapped{version}.fmu")
    inputs = {"q": "angles"}  # all elements of the vector, where there are such
    stiff = signals(simulation(folder, name, inputs=inputs))["lwr_commanded_torques"]
    soft = signals(simulation(folder, name, inputs=inputs, parameters={"stiffness": 400.0}))
    assert not np.allclose(stiff, soft["lwr_commanded_torques"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "settings", "key", "said"),
    [
        (["q", *GROUPS[1:]], {}, "inputs", "'q'"),
        (None, {"inputs": {"angels": "angles"}}, "inputs.angels", "did you mean 'angles'"),
        (None, {"output": "tau"}, "output", "the outputs torques"),
        (
            None,
            {"parameters": {"stifness": 1.0}},
            "parameters.stifness",
            "did you mean 'stiffness'",
        ),
        (None, {"file": "none.fmu"}, "file", "none.fmu"),
        (None, {"file": "scenario.toml"}, "file", "not an FMU"),
    ],
)
def test_incompatible_units_are_rejected(
    folder: Path, names: list[str] | None, settings: dict[str, Any], key: str, said: str
) -> None:
    name = write_fmu(folder, 3, names, "wrong.fmu")
    with pytest.raises(DeclarationError) as caught:
        simulation(folder, name, **settings)
    (problem,) = caught.value.problems
    assert problem.key == f"controllers.lwr.{key}"
    assert said in problem.message


@pytest.mark.parametrize(
    ("version", "before", "after", "key", "said"),
    [
        (2, 'name="torques[1]"', 'name="torques"', "output", "found 1 number in variable torques"),
        (2, 'name="angles[1]"', 'name="angles"', "inputs.angles", "found 1 number in variable"),
        (3, 'causality="output"><Dimension start="7"/>', 'causality="output">', "output",
         "found 1 number in variable torques of the FMU; expected 7"),
        (3, '<Dimension start="7"/></Float64></M', '<Dimension start="6"/></Float64></M', "output",
         "found 6 numbers in variable torques"),
        (3, 'start="0 0 0 0 0 0 0"><Dimension start="7"/></Float64><Float64 name="v',
         'start="0"></Float64><Float64 name="v', "inputs.angles",
         "found 1 number in variable angles"),
    ],
)  # fmt: skip
def test_variables_must_have_a_number_per_joint(
    folder: Path, version: int, before: str, after: str, key: str, said: str
) -> None:
    with zipfile.ZipFile(folder / write_fmu(folder, version, name="whole.fmu")) as unit:
        text = unit.read("modelDescription.xml").decode()
    assert before in text
    text = text.replace(before, after)
    with zipfile.ZipFile(folder / "other.fmu", "w") as unit:
        unit.writestr("modelDescription.xml", text)
    with pytest.raises(DeclarationError) as caught:
        simulation(folder, "other.fmu")
    (problem,) = caught.value.problems
    assert problem.key == f"controllers.lwr.{key}"
    assert said in problem.message


@pytest.mark.parametrize(
    ("failing", "said"),
    [("FMU_FAIL", "cannot be initialized"), ("FMU_STEP_FAIL", "fmi2DoStep")],
)
def test_failing_units_end_the_run(
    folder: Path, failing: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(failing, "1")  # asked by the unit
    with pytest.raises(SimulationError, match=f"impedance2.fmu.*{said}"):
        signals(simulation(folder, write_fmu(folder, 2)))
