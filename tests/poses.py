"""Poses composed of rotations and translations, to check tables of joints."""

from __future__ import annotations

import math

import numpy as np


def rot(axis: int, angle: float) -> np.ndarray:
    """Returns a rotation by an angle (rad) about x, y or z (0, 1, 2) as a frame."""
    turn = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn[a, a], turn[a, b], turn[b, a], turn[b, b] = c, -s, s, c
    return turn


def move(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Returns a translation (m) as a frame."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def chain(*steps: np.ndarray) -> np.ndarray:
    """Returns the product of frames, from left to right."""
    return np.linalg.multi_dot([*steps, np.eye(4)])
