"""Damping design by mass and stiffness, and stability at a time step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import DeclarationError, Problem

Array = NDArray[np.float64]


def design_damping(mass: Array, stiffness: Array, ratio: float | Array) -> Array:
    """Damping matrix that gives every mode of mass and stiffness a damping ratio.

    Double diagonalisation: M = Q Q^T and K = Q W^2 Q^T with diagonal W, then D = 2 Q Z W Q^T. Modes
    then move as mass-spring-dampers of their own: with one ratio z a step overshoots by
    exp(-pi z / sqrt(1 - z^2)), 4.6 % at 0.7. A direction without stiffness has no damping.

    Modes belong to no single joint. Ratios that differ are put in as sqrt(z_i z_j) before the
    entries of the matrix for ratio one: it stays positive semidefinite, and equal ratios give the
    exact result.

    Args:
        mass: (n, n), symmetric, positive definite.
        stiffness: (n, n), symmetric, positive semidefinite.
        ratio: damping ratio, 1 for critical damping; a number or (n,).

    Returns:
        (n, n), symmetric, positive semidefinite: it can only take energy, also when it is kept
        while the mass matrix changes.

    Source: Albu-Schäffer, Ott, Frese, Hirzinger 2003, Cartesian Impedance Control of Redundant
    Robots: Recent Results with the DLR-Light-Weight-Arms, ICRA (double diagonalization design).
    """
    lower = np.linalg.cholesky(mass)
    unlower = np.linalg.inv(lower)
    squares, vectors = np.linalg.eigh(unlower @ stiffness @ unlower.T)
    modes = lower @ vectors
    matrix = (modes * (2.0 * np.sqrt(np.maximum(squares, 0.0)))) @ modes.T
    root = np.sqrt(np.broadcast_to(ratio, len(mass)))
    return np.asarray(matrix * root * root[:, None])


def unstable_joint(mass: Array, stiffness: Array, damping: Array, timestep: float) -> int | None:
    """The joint that moves most in an unstable mode of a sampled controller, or None.

    The torques -K q - D dq are held for a step, and velocities are stepped before angles (MuJoCo's
    semi-implicit Euler): the robot is stable where no eigenvalue of that map is beyond one. For one
    mass this is w^2 t^2 + 4 z w t < 4 with w^2 = K / M and D = 2 z w M.

    Args:
        mass: (n, n), kg m2 (kg).
        stiffness: (n, n), Nm/rad (N/m).
        damping: (n, n), Nm s/rad (N s/m).
        timestep: s between two torques.
    """
    n = len(mass)
    pull = timestep * np.linalg.solve(mass, np.hstack([stiffness, damping]))
    step: Array = np.eye(2 * n)
    step[n:] -= pull
    step[:n] += timestep * step[n:]
    values, vectors = np.linalg.eig(step)
    worst = int(np.argmax(np.abs(values)))
    if np.abs(values[worst]) <= 1.0 + 1e-7:
        return None
    return int(np.argmax(np.abs(vectors[n:, worst])))


def too_stiff(joint: str, gain: str, timestep: float) -> DeclarationError:
    """The error for gains that are unstable at a time step.

    Args:
        joint: name of the one that moves most.
        gain: for the message: ` at 500 Nm/rad`, say.
        timestep: s between two torques.
    """
    found = f"joint {joint} is unstable{gain} with a time step of {1e3 * timestep:g} ms"
    return DeclarationError([Problem("stiffness", f"{found}; expected less, or a shorter step")])
