"""Indices of a scene's robots and doubles in the compiled model."""

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
    """Indices of one robot in the compiled model.

    Attributes:
        robot: its declaration.
        dh: its Denavit-Hartenberg table.
        qpos: index of every joint in `qpos`, (n,).
        dofs: index of every joint in `qvel`, (n,).
        mocap: index of its base in `mocap_pos` and `mocap_quat`.
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
        """Its declaration: name, toggles, values."""
        return self.robot

    @property
    def scope(self) -> str:
        """Prefix of the names of its sites."""
        return f"{self.robot.name}/"

    @property
    def arrow_quantity(self) -> str:
        """Quantity that its arrows initially show."""
        return self.robot.arrow_quantity

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        """Declared lines of its billboards."""
        return self.robot.billboard_lines

    @property
    def base_name(self) -> str:
        """Name of its base frame."""
        return f"{self.robot.name}/base"

    @property
    def flange_name(self) -> str:
        """Name of its flange frame."""
        return f"{self.robot.name}/flange"

    @property
    def link_names(self) -> list[str]:
        """Names of its base and links, n + 1."""
        name = self.robot.name
        return [self.base_name] + [f"{name}/link{i + 1}" for i in range(self.robot.n)]

    @property
    def chain(self) -> Ints:
        """Indices of its joints that move the flange, in order from the base."""
        return np.arange(self.robot.n)

    @property
    def reach(self) -> float:
        """Sum of all link lengths of its table, m; 1 where that is zero."""
        return float(np.abs(self.dh.a).sum() + np.abs(self.dh.d).sum()) or 1.0


@dataclass(frozen=True, eq=False)
class DoublePart:
    """Indices of one double in the compiled model.

    Attributes:
        double: its declaration.
        of: the robot it copies.
        mocap: index in `mocap_pos` of the base and every link, (rows, n + 1); a path has several
            rows.
        bodies: their ids, (rows, n + 1).
        frames: index in `mocap_pos` of the frame of every link, (n,), placed also for hidden
            links; empty for a path.
        path: joint angles of every row, (rows, n); None for a single double.
        joints: its rows in the world's `JointTable`; empty for a path.
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
        """Whether the model has bodies for it; otherwise decor draws it."""
        return self.bodies.size > 0

    @property
    def declared(self) -> Double:
        """Its declaration: name, toggles, values."""
        return self.double

    @property
    def robot(self) -> SerialRobot:
        """Declaration of the robot it copies."""
        return self.of.robot

    @property
    def dh(self) -> DhTable:
        """Table of the robot it copies."""
        return self.of.dh

    @property
    def scope(self) -> str:
        """Prefix of the names of its sites."""
        return f"double-{self.double.name}-"

    @property
    def flange_name(self) -> str:
        """Name of its flange frame."""
        return f"{self.double.name}/{self.of.flange_name.partition('/')[2]}"

    @property
    def chain(self) -> Ints:
        """Indices of its joints that move the flange, in order from the base."""
        return self.of.chain

    @property
    def reach(self) -> float:
        """Reach of the robot it copies, m."""
        return self.of.reach

    @property
    def arrow_quantity(self) -> str:
        """Quantity that its arrows initially show."""
        return self.double.arrow_quantity or self.robot.arrow_quantity

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        """Declared lines of its billboards, its own or those of its robot."""
        return self.double.billboard_lines or self.robot.billboard_lines


Owner = RobotPart | DoublePart


@dataclass(frozen=True, eq=False)
class DrawnDouble:
    """A double drawn from another state of the same model.

    Attributes:
        double: name of the double.
        model: compiled.
        data: the other state, frames up to date.
        geoms: geoms of the model to draw, (ngeom,) bool.
        rgba: its colour, (4,).
    """

    double: str
    model: mujoco.MjModel
    data: mujoco.MjData
    geoms: NDArray[np.bool_]
    rgba: NDArray[np.float64]
