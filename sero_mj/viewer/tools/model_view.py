"""`ModelView`: switches for the contacts, inertias, joints and names that MuJoCo draws."""

from __future__ import annotations

from typing import ClassVar

from ..decor.toggles import PART_NAMES
from ..session.tool import Tool
from ..session.widgets import Widgets

_SECOND = 8.6  # left edge of the second widget of a line, in text heights
_WIDTH = 8.6  # width of the drop-down list, in text heights
# Each entry has the name of a switch, a label and a tooltip.
_LINES = (
    (
        ("contacts", "contacts", "contact points, with contact forces if they are known"),
        (
            "inertias",
            "inertias",
            "boxes of equal mass and inertia; turn on transparent to see them",
        ),
    ),
    (
        ("joint_axes", "joints", "joints of the model and their axes"),
        ("centres_of_mass", "centers of mass", "center of mass of each robot or free object"),
    ),
    (
        ("transparent", "transparent", "draw moving bodies transparently"),
        ("wireframe", "wireframe", "edges of the triangles"),
    ),
)


class ModelView(Tool):
    """Tool with the panel section Model, whose check boxes set attributes of `Toggles`."""

    order: ClassVar[int] = 75

    def build(self, ui: Widgets) -> None:
        if not ui.header("Model"):
            return
        toggles = self.shown.toggles
        for line in _LINES:
            for number, (name, words, meaning) in enumerate(line):
                if number:
                    ui.same_line(_SECOND)
                changed, is_on = ui.check(words, getattr(toggles, name))
                ui.tip(meaning)
                if changed:
                    setattr(toggles, name, is_on)
        ui.width(_WIDTH)
        changed, chosen = ui.choose("displayed names", toggles.part_names, PART_NAMES)
        if changed:
            toggles.part_names = chosen
