"""Billboards: panels with the values of every joint that face the camera (section 2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..assemble.parts import DoublePart
from ..assemble.world_view import WorldView
from ._lines import Line, billboard_lines, declared_lines, detail_lines
from .cards import Cards, heights_in_order
from .feature import Feature, Frame
from .panels import PANEL_RGBA, panel_sizes
from .pen import Kind
from .picture_view import PictureView

Array = NDArray[np.float64]

_STALE_RGBA = (0.21, 0.21, 0.21, 0.78)
_TINT = 0.30  # fraction of the double's colour in the colour of its panels


class Billboards(Feature):
    """The billboards of one world."""

    order = 10

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        joints = world.joints
        parts = list(world.owners.values())
        self._lines: list[list[Line]] = []
        self._details: list[list[Line]] = []
        declared = [declared_lines(part, world.scene) for part in parts]
        for owner, joint, revolute in zip(joints.owner, joints.names, joints.revolute, strict=True):
            name, part = joint, parts[owner]
            # With several robots, joint names alone are ambiguous.
            if len(world.robots) > 1 or isinstance(part, DoublePart):
                name = f"{part.declared.name} {joint}"
            self._lines.append(billboard_lines(name, declared[owner], not revolute))
            self._details.append(detail_lines(name, not revolute))
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        self._rank = heights_in_order(_declared_heights(world))
        self._rgba = np.array([_tinted(part) for part in parts]).reshape(-1, 4)[joints.owner]
        self._widths: dict[tuple[int, int], int] = {}

    def lay_out(self, frame: Frame) -> None:
        """Adds the billboards that are shown, of joints in the picture."""
        cards = self._cards(frame)
        if cards is not None:
            frame.cards.append(cards)

    def _cards(self, frame: Frame) -> Cards | None:
        data, view, toggles, values = frame.data, frame.view, frame.toggles, frame.values
        stale = frame.stale_joints
        joints = self.world.joints
        index = frame.shown.billboards.nonzero()[0]
        if not len(index):
            return None
        anchors, depth = view.project(data.site_xpos[joints.centre_site[index]])
        inside = view.sees(anchors, depth)
        index, anchors, depth = index[inside], anchors[inside], depth[inside]
        if not len(index):
            return None
        lines = [self._details[i] if toggles.details[i] else self._lines[i] for i in index]
        if toggles.details.any():
            limit = joints.torque_limit
            share = 100 * np.abs(values["torques"]) / limit
            values = {**values, "torque_limit": limit, "torque_share": share}
        texts = [
            [line.text(float(values[line.key][i])) for line in of_joint]
            for i, of_joint in zip(index, lines, strict=True)
        ]
        # Clear of the round arrows of the joint closest to the camera.
        clear = 2.0 * joints.arrow_radius[index].max() / view.pixel_size(float(depth.min()))
        return Cards(
            kind=Kind.BILLBOARD,
            items=index,
            anchors=anchors,
            sizes=self._sizes(view, lines, texts),
            texts=texts,
            side=self._side[index],
            rank=self._rank[index],
            clear=clear,
            rgba=np.where(stale[index, None], _STALE_RGBA, self._rgba[index]),
        )

    def _sizes(self, view: PictureView, lines: list[list[Line]], texts: list[list[bytes]]) -> Array:
        """Returns panel sizes (k, 2), pixels, constant except for unusually long numbers."""
        font, known = view.font, self._widths
        widths = np.empty(len(lines))
        for k, (of_joint, of_text) in enumerate(zip(lines, texts, strict=True)):
            key = (font.height, id(of_joint))
            if key not in known:
                known[key] = max(font.width(line.widest) for line in of_joint)
            widths[k] = known[key]
            for text, line in zip(of_text, of_joint, strict=True):
                if len(text) > len(line.widest):
                    widths[k] = max(widths[k], font.width(text))
        return panel_sizes(widths, np.array([len(of_joint) for of_joint in lines]), view)


def _tinted(part: object) -> Array:
    """Returns the colour of a panel (4,); panels of doubles are tinted in the double's colour."""
    rgba = np.array(PANEL_RGBA)
    if isinstance(part, DoublePart):
        rgba[:3] += _TINT * (part.double.rgba[:3] - rgba[:3])
    return rgba


def _declared_heights(world: WorldView) -> Array:
    """Returns the height of every joint in the declared pose (N,), m; doubles as their robots."""
    data = world.state(world.make_data())
    joints = world.joints
    heights = np.array(data.site_xpos[joints.centre_site, 2])
    for part in world.doubles.values():
        heights[part.joints] = heights[part.of.joints][: part.joints.stop - part.joints.start]
    return heights
