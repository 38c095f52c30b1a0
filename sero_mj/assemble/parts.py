"""Where a scene's robots and doubles are in the compiled model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from .dh import DhTable
from .double import Double
from .robot import SerialRobot
from .robot_parts import BillboardLine

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class RobotPart:
    """Where one robot is in the model.

    Attributes:
        robot: its declaration.
        dh: its table, built once.
        qpos: index of every joint in `qpos`, (n,).
        dofs: index of every joint in `qvel`, (n,).
        mocap: its base's index in `mocap_pos` and `mocap_quat`.
        bodies: ids of the base and every link, (n + 1,).
        flange_body: id of the flange.
        joints: its rows in the world's `JointTable`.
    """

    robot: SerialRobot
    dh: DhTable
    qpos: Ints
    dofs: Ints
    mocap: int
    bodies: Ints
    flange_body: int
    joints: slice

    @property
    def declared(self) -> SerialRobot:
        """What it was declared as: name, toggles, values."""
        return self.robot

    @property
    def scope(self) -> str:
        """What the names of its sites start with."""
        return f"{self.robot.name}/"

    @property
    def arrow_quantity(self) -> str:
        """What its arrows show at first."""
        return self.robot.arrow_quantity

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        """What its billboards say, where declared."""
        return self.robot.billboard_lines

    @property
    def base_name(self) -> str:
        """Name of the frame of its base."""
        return f"{self.robot.name}/base"

    @property
    def flange_name(self) -> str:
        """Name of the frame of its flange."""
        return f"{self.robot.name}/flange"

    @property
    def link_names(self) -> list[str]:
        """Names of its base and links, n + 1."""
        name = self.robot.name
        return [self.base_name] + [f"{name}/link{i + 1}" for i in range(self.robot.n)]

    @property
    def chain(self) -> Ints:
        """Which of its joints move the flange, in order from the base."""
        return np.arange(self.robot.n)

    @property
    def reach(self) -> float:
        """The sum of all lengths in its table, m; 1 where that is zero."""
        return float(np.abs(self.dh.a).sum() + np.abs(self.dh.d).sum()) or 1.0


@dataclass(frozen=True, eq=False)
class DoublePart:
    """Where one double is in the model.

    Attributes:
        double: its declaration.
        of: the robot it doubles.
        mocap: index in `mocap_pos` of the base and every link, (rows, n + 1); a path has rows.
        bodies: their ids, (rows, n + 1).
        frames: index in `mocap_pos` of the frame of every link, (n,), which stay where the double
            is when a link is out of sight; empty for a path.
        path: joint angles of every row, (rows, n); None for a single double.
        joints: its rows in the world's `JointTable`; a path has none.
    """

    double: Double
    of: RobotPart
    mocap: Ints
    bodies: Ints
    frames: Ints
    path: Array | None
    joints: slice

    @property
    def is_compiled(self) -> bool:
        """Whether the model has bodies for it; else decor draws it."""
        return self.bodies.size > 0

    @property
    def declared(self) -> Double:
        """What it was declared as: name, toggles, values."""
        return self.double

    @property
    def robot(self) -> SerialRobot:
        """The declaration of the robot it doubles."""
        return self.of.robot

    @property
    def dh(self) -> DhTable:
        """The table of the robot it doubles."""
        return self.of.dh

    @property
    def scope(self) -> str:
        """What the names of its sites start with."""
        return f"double-{self.double.name}-"

    @property
    def flange_name(self) -> str:
        """Name of the frame of its flange."""
        return f"{self.double.name}/{self.of.flange_name.partition('/')[2]}"

    @property
    def chain(self) -> Ints:
        """Which of its joints move the flange, in order from the base."""
        return self.of.chain

    @property
    def reach(self) -> float:
        """The reach of the robot it doubles, m."""
        return self.of.reach

    @property
    def arrow_quantity(self) -> str:
        """What its arrows show at first."""
        return self.double.arrow_quantity or self.robot.arrow_quantity

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        """What its billboards say, where declared for it or for its robot."""
        return self.double.billboard_lines or self.robot.billboard_lines


Owner = RobotPart | DoublePart


@dataclass(frozen=True, eq=False)
class Ghost:
    """A robot as it stands in another state of the same model.

    Attributes:
        double: name of the double.
        model: compiled.
        data: the other state, frames up to date.
        geoms: which geoms of the model to draw, (ngeom,).
        rgba: its colour, (4,).
    """

    double: str
    model: mujoco.MjModel
    data: mujoco.MjData
    geoms: NDArray[np.bool_]
    rgba: NDArray[np.float64]
