"""`ModelView`: contacts, inertias, joints and names of the model, and how it is drawn."""

from __future__ import annotations

from typing import ClassVar

from ..decor.toggles import PART_NAMES
from ..session.tool import Tool
from ..session.widgets import Widgets

_SECOND = 8.6  # where a second widget of a line begins, of the text's height
_WIDTH = 8.6  # of the list
# Switch, words, and what they mean.
_LINES = (
    (
        ("contacts", "contacts", "where geoms touch; with the forces, where they are known"),
        ("inertias", "inertias", "boxes of the same mass and inertia; best seen with transparent"),
    ),
    (
        ("joint_axes", "joints", "the model's joints and their axes"),
        ("centres_of_mass", "centres of mass", "of every robot or object that moves on its own"),
    ),
    (
        ("transparent", "transparent", "of what moves"),
        ("wireframe", "wireframe", "edges of the triangles that surfaces are made of"),
    ),
)


class ModelView(Tool):
    """The section Model of the panel; its switches are in `Toggles`, as all others are."""

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
        changed, chosen = ui.choose("names", toggles.part_names, PART_NAMES)
        if changed:
            toggles.part_names = chosen
