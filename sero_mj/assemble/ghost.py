"""`Ghost`: a transparent double that is drawn from a pose of its own, not compiled in."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray


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
