"""`endless_scene`: simulations without an end time, for dragging, moving and tuning robots."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..base.frames import Array
from ..robots.declared.robot import SerialRobot
from ..robots.declared.scene import Scene
from .runs.run_source import RunSource
from .scenario import Scenario
from .simulated_scene import simulated_scene
from .simulation import Simulation

KEPT = 60.0  # minimum duration of the past that can be replayed, s
_LOG_DURATION = 90.0  # duration of a full log, whose oldest rows are discarded, s
# Number of random poses, and their range about zero in rad or m.
_POSES, _RANGE = 1000, 1.6
_SINGULAR = 0.03  # a pose with a smaller inverse condition number counts as singular
# The score of a pose is its inverse condition number, minus a cost per mean rad or m from the home
# pose, plus a gain per distance between base and flange along x, relative to the reach.
_PER_MOTION, _PER_REACH = 0.06, 0.3
_HEIGHTS = (0.2, 0.6)  # range of the flange's height above the base, relative to the reach


class EndlessRun(RunSource):
    """A simulation without an end time. A full log of 90 s drops its oldest third."""

    @property
    def end(self) -> float | None:
        return None

    @property
    def begin(self) -> float:
        return float(self.run.times[0])

    @property
    def newest(self) -> float:
        return float(self.run.time)

    @property
    def about(self) -> str:
        return str(self.run.about)

    def start_again(self) -> None:
        """Restarts the simulation in its initial pose with the current controllers."""
        simulation = self.run
        simulation.restart(simulation._start, simulation.plant.sensors.seed)
        self._error = None
        self.open()

    def _before(self, row: int) -> int:
        return row - 1

    def advance_to(self, time: float) -> None:
        run = self.run
        while time > run.times[-1] and self._error is None:
            super().advance_to(float(run.times[-1]))
            if self._error is None:
                rows = round(KEPT / run.scenario.run.timestep)
                self._shown = max(self._shown - run.drop_oldest(rows), -1)
        super().advance_to(max(time, float(run.times[0])))


def endless_scene(
    scene: Scene, control: str = "joint", angles: Mapping[str, Array] | None = None
) -> Scene:
    """Returns a scene whose robots are simulated for as long as it is shown.

    Controllers and physics run at 1 kHz. If all robots declare torque control, physics and torque
    control run at 3 kHz. Sources and routes of the scene are removed. If the scene shows a
    scenario, only its scene and gravity are used. Arrows are shown unless a robot disables them.

    Args:
        control: kind or short name of the initial controllers, for example `joint`.
        angles: initial joint angles by robot, shape (n,), rad or m (default: `bent_pose`).

    Raises:
        DeclarationError: an initial pose is beyond its limits, or masses are missing.
    """
    runs = [each.run for each in scene.sources.values() if isinstance(each, RunSource)]
    declared = [run.scenario for run in runs if isinstance(run, Simulation)]
    shown = copy.copy(declared[0].scene if declared else scene)
    shown.sources, shown.routes = {}, {}
    starts = angles or {}
    shown.robots = {
        name: robot.model_copy(
            update={
                "joint_angles": starts[name] if name in starts else bent_pose(robot),
                "torques": None,
                "show_arrows": robot.show_arrows or "show_arrows" not in robot.model_fields_set,
            }
        )
        for name, robot in shown.robots.items()
    }
    has_loops = all("torque_control" in robot.model_fields_set for robot in shown.robots.values())
    gravity: dict[str, Any] = {"gravity": declared[0].run.gravity} if declared else {}
    scenario = Scenario(
        shown, name=scene.name, duration=_LOG_DURATION, torque_control=has_loops, **gravity
    )
    simulation = Simulation(scenario, by_hand=True, is_live=True)
    assert simulation.live is not None
    for robot in simulation.live.robots.values():
        robot.choose(control)
    return simulated_scene(simulation, EndlessRun(run=simulation))


def bent_pose(robot: SerialRobot) -> Array:
    """Returns the home pose, or a bent pose if the home pose is singular; shape (n,), rad or m.

    A declared home pose, and that of a robot with a free base, is always returned. The bent pose is
    one of a fixed set of random poses within the limits. Its flange is above and in front of the
    base, its angles are close to home, and it is far from singularities (by the inverse condition
    number of the Jacobian, with lengths divided by the reach).
    """
    if robot.joint_angles is not None or robot.free_base:
        return robot.home
    ends = robot.display_ranges.T
    home = np.clip(robot.home, *ends)
    chain = robot.kinematics.moves[robot.flange_link]
    low, high = np.clip(np.outer((-_RANGE, _RANGE), np.ones(robot.n)), *ends)
    rng = np.random.default_rng(0)
    poses = np.concatenate([home[None], rng.uniform(low, high, (_POSES, robot.n))])
    stays = rng.random(poses.shape) < 0.5
    stays[0], stays[:, ~chain] = True, True
    poses = np.where(stays, home, poses)
    poses = robot.coupled.positions(poses[:, robot.coupled.independent])
    frames = robot.kinematics.frames(poses, robot.base_frame)
    flanges = (frames[:, robot.flange_link] @ robot.T_n_flange)[:, :3, 3] - robot.base_frame[:3, 3]
    J = robot.kinematics.jacobian(poses, robot.base_frame, robot.T_n_flange, robot.flange_link)
    J[:, :3] /= robot.reach
    values = np.linalg.svd(J[:, :, chain], compute_uv=False)
    inverse = values[:, -1] / np.maximum(values[:, 0], 1e-12)
    if inverse[0] > _SINGULAR:
        return home
    flanges /= robot.reach
    score = inverse + _PER_REACH * flanges[:, 0] - _PER_MOTION * np.abs(poses - home).mean(axis=1)
    lowest = frames[:, 1:, 2, 3].min(axis=1) - robot.base_frame[2, 3]
    is_valid = (flanges[:, 2] > _HEIGHTS[0]) & (flanges[:, 2] < _HEIGHTS[1]) & (lowest > -1e-6)
    is_valid &= inverse > _SINGULAR
    if not is_valid.any():
        return home
    return np.asarray(poses[np.where(is_valid, score, -np.inf).argmax()])
