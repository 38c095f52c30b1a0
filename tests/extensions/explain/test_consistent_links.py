from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from sero_mj.extensions.explain.base_parameters import BaseParameters, standard_parameters
from sero_mj.extensions.explain.links.consistent_links import (
    _parameters_of,
    consistent_parameters,
    pseudo_inertias,
)
from sero_mj.robots.declared.robot import SerialRobot


def test_pseudo_inertia_is_the_second_moment_of_points() -> None:
    rng = np.random.default_rng(0)
    points, masses = rng.normal(size=(8, 3)), rng.uniform(0.1, 1.0, 8)
    tensor = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)
    )
    parameters = np.array([
        masses.sum(), *(masses @ points), *np.diag(tensor),
        tensor[0, 1], tensor[0, 2], tensor[1, 2],
    ])  # fmt: skip
    homogeneous = np.column_stack([points, np.ones(8)])
    expected = homogeneous.T @ (masses[:, None] * homogeneous)
    np.testing.assert_allclose(pseudo_inertias(parameters)[0], expected, atol=1e-12)
    np.testing.assert_allclose(_parameters_of(expected[None]), parameters, atol=1e-12)


def test_result_is_the_minimum_by_another_solver() -> None:
    robot = SerialRobot.from_model("dlr_hand2_finger", name="finger")
    prior = standard_parameters(robot)
    base, scale = BaseParameters.of(robot), np.abs(prior) + 1e-6
    values = (base.combination @ prior) * np.linspace(0.7, 1.4, len(base))
    information = np.diag(1.0 / (0.1 * np.abs(values) + 1e-9) ** 2)
    found = consistent_parameters(prior, base.combination, values, information, 2.0)
    inverse = np.linalg.inv(pseudo_inertias(prior))

    def cost(x: np.ndarray) -> float:
        P = pseudo_inertias(found + x * scale)
        if (np.linalg.eigvalsh(P) <= 0).any():
            return 1e9
        left = base.combination @ (found + x * scale) - values
        size = np.log(np.linalg.det(P)).sum()
        return float(
            0.5 * left @ information @ left + 2.0 * (np.einsum("nij,nji", inverse, P) - size)
        )

    start = cost(np.zeros(len(prior)))
    best = minimize(cost, np.zeros(len(prior)), method="Powell", options={"maxiter": 3})
    assert best.fun == pytest.approx(start, abs=1e-5)
    assert start < cost((prior - found) / scale)  # the prior


def test_impossible_values_become_consistent_and_nothing_else_changes() -> None:
    robot = SerialRobot.from_model("lwr")
    prior, base = standard_parameters(robot), BaseParameters.of(robot)
    values, information = base.combination @ prior, np.zeros((len(base), len(base)))
    same = consistent_parameters(prior, base.combination, values, information, 1.0)
    np.testing.assert_allclose(same, prior, atol=1e-6)
    last = base.names.index("A6.Izz")
    values[last], information[last, last] = -0.01, 1e8
    found = consistent_parameters(prior, base.combination, values, information, 1.0)
    assert (np.linalg.eigvalsh(pseudo_inertias(found)) > 0).all()
    assert 0 < found[66] < prior[66]
    np.testing.assert_allclose(found[:60], prior[:60], atol=1e-6)
