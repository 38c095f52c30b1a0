"""`endless_scene`: robots simulated without an end time, pulled, steered and tuned meanwhile."""

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

KEPT = 60.0  # s of the past that can be seen again, at least
_LONGEST = 90.0  # s of the log, before its oldest rows are forgotten
# Where a start is looked for: poses, and rad or m to either side of zero.
_POSES, _RANGE = 1000, 1.6
_SINGULAR = 0.03  # inverse condition number, below which a start is looked for
# What this number must gain for a mean rad or m away from zero, and what it may lose for the flange
# to be farther in front of the base by the reach.
_PER_MOTION, _PER_REACH = 0.06, 0.3
_HEIGHTS = (0.2, 0.6)  # of the reach, of the flange above the base


class EndlessRun(RunSource):
    """A simulation without an end time; when its log is full, the oldest third is discarded.

    So it takes no more memory than its log of 90 s, and at least the last 60 s can be seen again.
    """

    @property
    def end(self) -> float | None:
        """None: it has no end."""
        return None

    @property
    def begin(self) -> float:
        """Time of the oldest row, s."""
        return float(self.run.times[0])

    @property
    def newest(self) -> float:
        """Time of the newest row, s."""
        return float(self.run.time)

    @property
    def about(self) -> str:
        return str(self.run.about)

    def start_again(self) -> None:
        """Restarts in the declared pose with the current controllers; clears errors."""
        simulation = self.run
        simulation.restart(simulation._start, simulation.plant.sensors.seed)
        self._error = None
        self.open()

    def _before(self, row: int) -> int:
        return row - 1

    def advance_to(self, time: float) -> None:
        """Passes on the rows up to a time, s; simulates missing ones."""
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
    """Returns a scene whose robots are simulated without an end while it is shown.

    Physics and controllers run at 1 kHz; where all robots declare a torque loop, joint torque
    control between them at 3 kHz. Sources and routes of the scene have no part in it; of a scenario
    its scene and gravity are taken. Arrows are shown, unless a robot declares that they are not.

    Args:
        control: kind of the controller of all of them at first, or its short name, as `joint`.
        angles: where they begin, (n,), rad or m; others at the declared pose, see `bent_pose`.

    Raises:
        DeclarationError: what only shows when robots are simulated: starts beyond limits, no
            masses.
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
    given: dict[str, Any] = {"gravity": declared[0].run.gravity} if declared else {}
    scenario = Scenario(
        shown, name=scene.name, duration=_LONGEST, torque_control=has_loops, **given
    )
    simulation = Simulation(scenario, by_hand=True, is_live=True)
    assert simulation.live is not None
    for robot in simulation.live.robots.values():
        robot.choose(control)
    return simulated_scene(simulation, EndlessRun(run=simulation))


def bent_pose(robot: SerialRobot) -> Array:
    """Returns the declared pose (n,), rad or m; without one a pose from which an arm can move.

    At zeros many an arm is stretched upwards: its flange is in a singularity and its joints carry
    nothing. Of random poses within the limits, the same ones each time, this one has its flange in
    front of the base and above it, is far from singularities (by the inverse condition number of
    the Jacobian, lengths in units of the reach) and not far from zero.
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
    tips = (frames[:, robot.flange_link] @ robot.T_n_flange)[:, :3, 3] - robot.base_frame[:3, 3]
    J = robot.kinematics.jacobian(poses, robot.base_frame, robot.T_n_flange, robot.flange_link)
    J[:, :3] /= robot.reach
    values = np.linalg.svd(J[:, :, chain], compute_uv=False)
    inverse = values[:, -1] / np.maximum(values[:, 0], 1e-12)
    if inverse[0] > _SINGULAR:
        return home
    tips /= robot.reach
    score = inverse + _PER_REACH * tips[:, 0] - _PER_MOTION * np.abs(poses - home).mean(axis=1)
    lowest = frames[:, 1:, 2, 3].min(axis=1) - robot.base_frame[2, 3]
    is_good = (tips[:, 2] > _HEIGHTS[0]) & (tips[:, 2] < _HEIGHTS[1]) & (lowest > -1e-6)
    is_good &= inverse > _SINGULAR
    if not is_good.any():
        return home
    return np.asarray(poses[np.where(is_good, score, -np.inf).argmax()])
