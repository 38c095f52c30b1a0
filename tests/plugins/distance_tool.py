"""A plug-in: the key G measures the distance between two clicked points.

Its pyproject.toml has:

    [project.entry-points."sero_mj.tools"]
    distance = "distance_tool:Distance"
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np

from sero_mj.viewer.decor.feature import Frame
from sero_mj.viewer.decor.panels import Panels, labels_at
from sero_mj.viewer.session.tool import Action, Shown, Tool
from sero_mj.viewer.session.widgets import Widgets

THICKNESS, COLOUR = 0.004, (0.95, 0.35, 0.10, 1.0)  # m


class Distance(Tool):
    """Draws a line between two points, with its length."""

    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "g": ("measure", "measure: click on two points")
    }

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self.is_on = False
        self.points: list[np.ndarray] = []

    def actions(self) -> Mapping[str, Action]:
        return {"measure": self._begin}

    def _begin(self) -> str:
        self.is_on, self.points = not self.is_on, []
        return "click on the first point" if self.is_on else "no longer measures"

    def click(self, picked: Any, at: tuple[float, float]) -> str | None:
        point = self.shown.decor.point_at(self.shown.data, at) if self.is_on else None
        if point is None:
            return None
        self.points = [*self.points[-1:], point]
        return self._text() if len(self.points) == 2 else "click on the second point"

    def _text(self) -> str:
        return f"{1e3 * np.linalg.norm(self.points[1] - self.points[0]):.1f} mm"

    def build(self, ui: Widgets) -> None:
        if ui.button("stop measuring" if self.is_on else "measure"):
            self.shown.say(self._begin())

    def lay_out(self, frame: Frame) -> None:
        if len(self.points) == 2:
            middle = frame.view.project(np.mean(self.points, axis=0))[0]
            texts = [[self._text().encode()]]
            label = labels_at(frame.view, middle[None], texts)
            frame.panels.append(Panels(*label, texts))

    def draw(self, frame: Frame) -> None:
        if len(self.points) < 2:
            return
        (row,) = frame.buffer.take(1, int(mujoco.mjtGeom.mjGEOM_CAPSULE))
        way = self.points[1] - self.points[0]
        quat, rotation = np.zeros(4), np.zeros(9)
        mujoco.mju_quatZ2Vec(quat, way)
        mujoco.mju_quat2Mat(rotation, quat)
        row["pos"], row["mat"] = np.mean(self.points, axis=0), rotation.reshape(3, 3)
        row["size"] = (THICKNESS, THICKNESS, np.linalg.norm(way) / 2)
        row["rgba"] = COLOUR
