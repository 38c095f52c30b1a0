"""The Robotics Toolbox for Python (Corke, Haviland), of the same URDF."""

from __future__ import annotations

import numpy as np
import roboticstoolbox as rtb
from common import best, main, poses, tell, urdf

NAME = "roboticstoolbox-python"


def load() -> rtb.Robot:
    return rtb.Robot.URDF(urdf(7))


def fk_one() -> None:
    robot, q = load(), poses(7)[0]
    out = [np.eye(4)]

    def call() -> None:
        out[0] = robot.fkine(q, end="flange").A

    tell(NAME, best(call), out[0])


def fk_many() -> None:
    robot, q = load(), poses(7)
    out = [np.eye(4)]

    def call() -> None:
        out[0] = robot.fkine(q, end="flange").A

    tell(NAME, best(call, 1, 10), out[0][-1])


def mass_gravity() -> None:
    robot, q = load(), poses(7)[0]
    out = [np.zeros(1)] * 2

    def call() -> None:
        out[:] = robot.inertia(q), robot.gravload(q)

    tell(NAME, best(call, 1, 10), [*out[0].ravel(), *out[1]])


if __name__ == "__main__":
    main({"fk_one": fk_one, "fk_many": fk_many, "mass_gravity": mass_gravity})
