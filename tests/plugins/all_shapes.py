"""An external package whose visual feature draws a geom of every type, in a row along y.

Its pyproject.toml has:

    [project.entry-points."sero_mj.decor"]
    shapes = "all_shapes:AllShapes"
"""

from __future__ import annotations

import mujoco
import numpy as np

from sero_mj.viewer.decor.feature import Feature, Frame

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
APART = 0.5  # m
SIZES = {
    "SPHERE": (0.15, 0.15, 0.15), "CAPSULE": (0.07, 0.07, 0.12), "ELLIPSOID": (0.15, 0.08, 0.2),
    "CYLINDER": (0.1, 0.1, 0.15), "BOX": (0.15, 0.1, 0.05), "ARROW": (0.06, 0.06, 0.5),
    "ARROW1": (0.06, 0.06, 0.5), "ARROW2": (0.06, 0.06, 0.5), "LINE": (3, 3, 0.2),
    "LINEBOX": (0.15, 0.1, 0.1), "TRIANGLE": (0.4, 0.4, 0.0),
}  # fmt: skip


class AllShapes(Feature):
    """The shapes, and a label."""

    def draw(self, frame: Frame) -> None:
        """Draws them."""
        for k, (name, size) in enumerate(SIZES.items()):
            rows = frame.buffer.take(1, int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")))
            rows["pos"], rows["mat"], rows["size"] = (0.0, APART * k, 0.0), TURN, size
            rows["rgba"], rows["emission"] = (0.2 + 0.07 * k, 0.9 - 0.06 * k, 0.3, 1.0), 1.0
        label = frame.buffer.take(1, int(mujoco.mjtGeom.mjGEOM_LABEL))
        label["pos"], label["label"], label["rgba"] = (0.0, 1.0, 0.3), b"third <b>one</b>", 1.0
        label["mat"], label["size"] = np.eye(3), 0.1
