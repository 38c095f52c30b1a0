from __future__ import annotations

import numpy as np
import pytest

from sero_mj.extensions.explain.base_parameters import (
    BaseParameters,
    standard_parameters,
    standard_torques,
)
from sero_mj.extensions.explain.link_torques import link_torques
from sero_mj.robots.declared.robot import SerialRobot

BASE = np.array([[0.0, -1, 0, 0.1], [0.8, 0, 0.6, 0], [-0.6, 0, 0.8, 0.3], [0, 0, 0, 1]])


def random_motion(robot: SerialRobot, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.6, (3, 40, robot.n))


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("lwr", {}),
        ("lwr", {"base_frame": BASE}),
        ("lwr", {"mirrored": True}),
        ("stanford", {"base_frame": BASE}),  # prismatic, standard convention
        ("scara", {}),
        ("lwr", {"parents": ["base", "A1", "A2", "E1", "A3", "A2", "A5"]}),  # a tree
    ],
)
def test_declared_parameters_have_the_torques_of_mujoco(name: str, overrides: dict) -> None:
    robot = SerialRobot.from_model(name, name="arm", **overrides)
    motion = random_motion(robot)
    expected = link_torques(robot, *motion)
    torques, parameters = standard_torques(robot, *motion), standard_parameters(robot)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(torques @ parameters, expected, atol=1e-9 * scale)
    base = BaseParameters.of(robot)
    by_base = base.columns(torques) @ (base.combination @ parameters)
    np.testing.assert_allclose(by_base, expected, atol=1e-7 * scale)


# Puma: Khalil, Dombre 2002. FR3: Gaz et al., RA-L 2019.
@pytest.mark.parametrize(("name", "number"), [("puma560", 36), ("fr3", 43), ("lwr", 43)])
def test_number_of_base_parameters_is_that_of_the_literature(name: str, number: int) -> None:
    robot = SerialRobot.from_model(name)
    base = BaseParameters.of(robot)
    assert len(base) == len(base.names) == number
    X = standard_torques(robot, *random_motion(robot, 2)).reshape(-1, 10 * robot.n)
    assert np.linalg.matrix_rank(X) == number  # at other poses, by singular values
    np.testing.assert_allclose(base.combination[:, base.indices], np.eye(number), atol=1e-9)


def test_base_parameters_are_named_as_sums() -> None:
    base = BaseParameters.of(SerialRobot.from_model("lwr"))
    names = [each.split()[0] for each in base.names]
    assert "A1.Izz" in names and "A2.hy" in names
    assert not {"A1.mass", "A1.hx", "A1.Ixx"} & set(names)
    assert any("+ 0.4 A3" in each or "+ 0.4 E1" in each for each in base.names), base.names
