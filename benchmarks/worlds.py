"""Worlds of 7, 14 and 51 joints with all visual features, for benchmarks."""

from __future__ import annotations

import numpy as np

from sero_mj import Double, Scene, SerialRobot, World

# Numbers of joints of the serial robots with 51 joints, as in Rollin' Justin: torso, arms, hands
# with four fingers, neck and platform (Hulin, Hertkorn, Preusche, section 4.1).
JUSTIN = [3, 7, 7, 12, 12, 2, 8]
WORLDS = {7: [7], 14: [7, 7], 51: JUSTIN}


def make_world(counts: list[int], *, doubles: bool = False) -> World:
    """Returns a world with one robot per entry of `counts`, the number of its joints.

    Robots with 7 joints are LWRs. The tables of other robots repeat rows of the LWR's table. With
    `doubles`, each robot has a double in another pose.
    """
    rng = np.random.default_rng(1)
    lwr = SerialRobot.from_model("lwr")
    robots = []
    for i, n in enumerate(counts):
        fields = {
            "name": f"robot{i}",
            "base_frame": {"xyz": [0.0, 0.6 * i, 0.0]},
            "joint_angles": rng.uniform(-1, 1, n),
            "torques": rng.uniform(5, 30, n) * rng.choice([-1, 1], n),
            "show_arrows": True,
            "show_billboards": True,
            "show_axes": True,
        }
        if n == lwr.n:
            robots.append(SerialRobot.from_model("lwr", **fields))
            continue
        fields |= {"dh_params": np.resize(lwr.dh_params, (n, 4)), "torque_limits": np.full(n, 40.0)}
        robots.append(SerialRobot(dh_convention="craig", **fields))
    of_each = [
        Double(name=f"double{i}", of=robot.name, joint_angles=robot.home + 0.5)
        for i, robot in enumerate(robots)
        if doubles
    ]
    return World(Scene(robots=robots, doubles=of_each))
