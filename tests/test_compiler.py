"""A compiler's cached results equal newly compiled ones."""

from __future__ import annotations

import numpy as np
import pytest

from sero_mj.robots.assemble.world import World, world_without_meshes
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.control.compiler import Compiler, fingerprint
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation


def scenario(**changes: object) -> Scenario:
    robot = SerialRobot.from_model("lwr", joint_angles=[0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])
    return Scenario(
        Scene(robots=[robot]),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": 800.0}},
        disturbances={
            "load": {"kind": "payload", "robot": "lwr", "mass": 3.0, "begin": 0.1, "end": 0.4}
        },
        faults={"rust": {"kind": "friction", "robot": "lwr", "begin": 0.2, "coulomb": 2.0}},
        duration=0.3,
        **changes,
    )


def rows(compiler: Compiler, **changes: object) -> bytes:
    simulation = Simulation(scenario(**changes), compiler=compiler)
    simulation.advance(simulation.steps)
    return simulation.rows.tobytes()


@pytest.mark.thorough
def test_run_with_a_used_compiler_equals_a_run_with_a_new_one() -> None:
    compiler = Compiler()
    # Each run leaves a payload on the flange and other friction in the joints.
    first, second = rows(compiler), rows(compiler)
    assert first == second == rows(Compiler())
    assert rows(compiler, timestep=0.002) == rows(Compiler(), timestep=0.002)
    elastic = rows(compiler, elastic=True)
    assert elastic == rows(Compiler(), elastic=True) != first
    assert rows(compiler) == first


def test_worlds_of_one_compiler_have_separate_models() -> None:
    compiler = Compiler()
    robot = SerialRobot.from_model("lwr")
    one, other = compiler.world(Scene(robots=[robot])), compiler.world(Scene(robots=[robot]))
    one.model.dof_damping[:] = 99.0
    assert (other.model.dof_damping < 99.0).all()
    assert (compiler.world(Scene(robots=[robot])).model.dof_damping < 99.0).all()


def test_changed_declarations_are_compiled_again() -> None:
    compiler = Compiler()
    light = SerialRobot.from_model("lwr")
    masses = 2.0 * np.asarray(light.dynamics.masses)
    heavy = SerialRobot.from_model("lwr", dynamics={"masses": masses.tolist()})
    a, b = (compiler.world(Scene(robots=[robot])).model for robot in (light, heavy))
    assert b.body_mass.sum() > 1.5 * a.body_mass.sum()
    for robot in (light, heavy):
        model = compiler.robot_model(robot)
        model.update(np.full(7, 0.5), np.zeros(7))
        assert np.abs(model.gravity()).max() > 5.0


RODS = [
    SerialRobot(name="rod", dh_convention="craig", dh_params=[[0, 0, 0, 0.1 * k]],
                torque_limits=[20.0])
    for k in range(1, 12)
]  # fmt: skip


def test_compiler_caches_a_limited_number_of_worlds() -> None:
    compiler = Compiler()
    for robot in RODS:
        compiler.world(Scene(robots=[robot]))
    assert len(compiler._worlds) == 8


def test_each_of_many_robots_is_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler()
    for robot in RODS:
        compiler.robot_model(robot)
    monkeypatch.setattr("sero_mj.simulate.control.compiler.RobotModel.of", None)
    for robot in RODS:
        compiler.robot_model(robot)


def test_fingerprint_distinguishes_declarations() -> None:
    one, other = SerialRobot.from_model("lwr"), SerialRobot.from_model("lwr")
    assert fingerprint(one) == fingerprint(other)
    assert hash(fingerprint(one)) == hash(fingerprint(other))
    moved = SerialRobot.from_model("lwr", base_frame={"xyz": [0.1, 0.0, 0.0]})
    assert fingerprint(moved) != fingerprint(one)


@pytest.mark.parametrize("name", ["impedance_push", "singularity_pass", "haptic_position"])
def test_second_simulation_compiles_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler()
    Simulation(read_scenario(name), compiler=compiler)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a world is compiled again")

    monkeypatch.setattr("sero_mj.simulate.control.compiler.World", refuse)
    monkeypatch.setattr("sero_mj.simulate.control.robot_model.World", refuse)
    Simulation(read_scenario(name), compiler=compiler)


@pytest.mark.parametrize("name", ["lwr", "hit_finger", "biped_leg"])
def test_controller_model_equals_the_model_with_meshes(name: str) -> None:
    robot = SerialRobot.from_model(name)
    whole = World(Scene(robots=[robot], floor=False), dynamic=True)
    bare = world_without_meshes([robot])
    assert robot.filenames and whole.model.nmesh > 0 and bare.model.nmesh == 0
    models = RobotModel.of(robot, whole), RobotModel.of(robot, bare), RobotModel.of(robot)
    found = []
    for model in models:
        model.update(np.linspace(-0.4, 0.7, robot.n), np.linspace(1.0, -1.0, robot.n))
        parts = (model.gravity(), model.coriolis(), model.mass(), model.flange_position)
        found.append([part.copy() for part in parts])
    for part, *others in zip(*found, strict=True):
        for other in others:
            np.testing.assert_array_equal(other, part)
