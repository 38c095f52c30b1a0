"""Billboards: panels that face the camera, with the values of every joint.

Source: section 2.1 of Hulin, Hertkorn, Preusche: Interactive Features for Robot Viewers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..assemble.parts import DoublePart, Owner
from ..assemble.robot_parts import BillboardLine
from ..assemble.scene import Scene
from ..assemble.world_view import WorldView
from ..frames import Array, Ints
from .card_names import card_names, titles
from .cards import Cards, heights_in_order
from .feature import Feature, Frame
from .layout import LEFT, RIGHT
from .panels import PANEL_RGBA, panel_sizes
from .pen import Kind
from .picture_view import PictureView

NO_DATA = b"no data"
NO_LIMIT = b"none"
# Labels of lines on billboards with several lines.
_LABELS = {
    "torques": "msr",
    "commanded_torques": "cmd",
    "torque_error": "err",
    "joint_accelerations": "acc",
    "joint_angles": "pos",
    "billboard_values": "val",
}
_CLOSE = 0.01  # of the picture's width, by which a limb is beside the middle of its robot
_PLAIN_BELOW = 1e6  # above it values are written with an exponent
# Default unit and decimals of a value, for revolute and for prismatic joints.
_UNITS = {
    "torques": (("Nm", 1), ("N", 1)),
    "commanded_torques": (("Nm", 1), ("N", 1)),
    "torque_error": (("Nm", 2), ("N", 2)),
    "joint_accelerations": (("rad/s2", 2), ("m/s2", 2)),
    "joint_angles": (("rad", 3), ("m", 4)),
    "torque_limit": (("Nm", 1), ("N", 1)),
    "torque_share": (("%", 1), ("%", 1)),
}
_OWN_UNIT = (("", 2), ("", 2))  # of `billboard_values` and a robot's own inputs
# Values and labels that a click on an arrow shows (section 2.2).
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}

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
        self._modelled: list[list[Line]] = []  # where torques are the model's
        declared = [declared_lines(part, world.scene) for part in parts]
        # With several robots, joint names alone are ambiguous.
        is_ambiguous = [len(world.robots) > 1 or isinstance(part, DoublePart) for part in parts]
        names = titles(
            [card_names(part.robot.names, part.robot.name) for part in parts],
            [part.declared.name for part in parts],
            is_ambiguous,
        )
        for owner, name, revolute in zip(joints.owner, names, joints.revolute, strict=True):
            lines = declared[owner]
            self._lines.append(billboard_lines(name, lines, not revolute))
            if [line.value for line in lines] == ["joint_angles"]:
                lines = [BillboardLine(value="torques")]
            self._modelled.append(billboard_lines(name, lines, not revolute))
            self._details.append(detail_lines(name, not revolute))
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        several = [len(part.robot.limb_joints) > 1 for part in parts]
        self._is_in_limbs = np.array([*several, False], bool)[joints.owner]
        self._close = 0.0  # how far from its robot's middle a limb has no side, picture widths
        self._limbs_of_owners = [np.unique(joints.limb[part.joints]) for part in parts]
        self._rank = heights_in_order(_declared_heights(world))
        self._rgba = np.array([_tinted(part) for part in parts]).reshape(-1, 4)[joints.owner]
        self._widths: dict[tuple[int, int], int] = {}

    def lay_out(self, frame: Frame) -> None:
        """Adds the billboards that are shown, of joints in the picture.

        Where there are too many, `CardLayout` keeps those of joints and limbs that were clicked on
        and of the most loaded ones.
        """
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
        plain = [
            of_model if is_modelled else lines
            for of_model, lines, is_modelled in zip(
                self._modelled, self._lines, toggles.modelled, strict=True
            )
        ]
        lines = [self._details[i] if toggles.details[i] else plain[i] for i in index]
        if toggles.details.any():
            limit = joints.torque_limit
            share = 100 * np.abs(values["torques"]) / limit
            values = {**values, "torque_limit": limit, "torque_share": share}
        texts = [
            [line.text(float(values[line.key][i])) for line in of_joint]
            for i, of_joint in zip(index, lines, strict=True)
        ]
        asked = toggles.details | (toggles.clicked & toggles.billboards)
        # Clear of the round arrows of the joint closest to the camera.
        clear = 2.0 * joints.arrow_radius[index].max() / view.pixel_size(float(depth.min()))
        return Cards(
            kind=Kind.BILLBOARD,
            items=index,
            anchors=anchors,
            sizes=self._sizes(view, lines, texts),
            texts=texts,
            owners=joints.owner[index],
            side=self._sides(frame)[index],
            rank=self._rank[index],
            share=np.where(asked[index], np.inf, self._shares(frame)[index]),
            clear=clear,
            rgba=np.where(stale[index, None], _STALE_RGBA, self._rgba[index]),
        )

    def _sides(self, frame: Frame) -> Ints:
        """Returns the side of every joint's card, (N,), one for a whole limb.

        It is the limb's in the picture; one in the middle stays where it is.
        """
        if not self._is_in_limbs.any():
            return self._side
        joints, view = self.world.joints, frame.view
        pixels, depth = view.project(frame.data.site_xpos[joints.centre_site])
        is_before = depth > view.near
        counts = np.maximum(np.bincount(joints.limb, is_before), 1.0)
        across = np.bincount(joints.limb, np.where(is_before, pixels[:, 0], 0.0)) / counts
        middles = np.zeros(len(counts))
        for limbs in self._limbs_of_owners:
            middles[limbs] = np.median(across[limbs])
        beside = (across - middles)[joints.limb]
        moved = self._is_in_limbs & (np.abs(beside) >= self._close * view.width)
        self._close = _CLOSE  # from the first picture on, so that cards do not go to and fro
        self._side[moved] = np.where(beside[moved] < 0, LEFT, RIGHT)
        return self._side

    def _shares(self, frame: Frame) -> Array:
        """Returns the value of every joint's arrow over that of full width, (N,); 0 without any."""
        joints = self.world.joints
        of_radius = joints.arrow_radius / joints.arrow_width_scale
        full = np.where(np.isfinite(joints.arrow_load), joints.arrow_load, of_radius)
        full = np.where(np.isfinite(frame.arrow_limit), frame.arrow_limit, full)
        return np.nan_to_num(np.abs(frame.arrow_values) / full, nan=0.0, posinf=0.0)

    def _sizes(self, view: PictureView, lines: list[list[Line]], texts: list[list[bytes]]) -> Array:
        """Returns panel sizes (k, 2), pixels, constant except for unusually long numbers."""
        font, known = view.font, self._widths
        widths = np.empty(len(lines))
        for k, (of_joint, of_text) in enumerate(zip(lines, texts, strict=True)):
            key = (font.height, id(of_joint))
            if key not in known:
                known[key] = font.block_width(
                    [line.widest.encode("ascii", "replace") for line in of_joint]
                )
            widths[k] = known[key]
            if any(len(t) > len(f.widest) for t, f in zip(of_text, of_joint, strict=True)):
                widths[k] = max(widths[k], font.block_width(of_text))
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


@dataclass(frozen=True)
class Line:
    """The format of one line of a joint's billboard."""

    head: str
    form: str
    scientific: str
    scale: float
    decimals: int
    key: str
    widest: str

    def text(self, value: float) -> bytes:
        """Returns the line with its number; `no data` for NaN and infinity."""
        if not math.isfinite(value):
            missing = NO_LIMIT if self.key == "torque_limit" else NO_DATA
            return self.head.encode("ascii") + missing
        # Adding zero converts -0.0, the result of rounding a small negative value, to 0.0.
        value = round(value * self.scale, self.decimals) + 0.0
        form = self.form if abs(value) < _PLAIN_BELOW else self.scientific
        return (self.head + form % value).encode("ascii", "replace")


def declared_lines(part: Owner, scene: Scene) -> list[BillboardLine]:
    """Returns the lines of billboards: as declared, else the inputs routed to the robot or double.

    A double has the lines of its robot, as far as it has values for them.
    """
    declared = part.declared

    def comes(key: str) -> bool:
        if key == "torque_error":  # computed from the two
            return comes("commanded_torques") and comes("torques")
        routed = scene.routed(f"{declared.name}.{key}") is not None
        return routed or getattr(declared, key, None) is not None

    if declared.billboard_lines is not None:
        return declared.billboard_lines
    if part.billboard_lines is not None:
        lines = [line for line in part.billboard_lines if comes(line.value)]
        if lines:
            return lines
    for key in ("billboard_values", "torques"):
        if comes(key):
            return [BillboardLine(value=key)]
    return [BillboardLine(value="joint_angles")]


def billboard_lines(joint: str, declared: list[BillboardLine], prismatic: bool) -> list[Line]:
    """Returns the line formats of one joint's billboard.

    Args:
        joint: its name.
        declared: the declared lines.
        prismatic: whether the joint is prismatic, for units.
    """
    several = len(declared) > 1
    labels = [
        line.label or (_LABELS.get(line.value, line.value) if several else "") for line in declared
    ]
    return [
        _line(joint, k, line.value, label, prismatic, line)
        for k, (line, label) in enumerate(zip(declared, labels, strict=True))
    ]


def detail_lines(joint: str, prismatic: bool) -> list[Line]:
    """Returns the line formats of the precise values of one joint's arrow."""
    return [
        _line(joint, k, key, label, prismatic) for k, (key, label) in enumerate(_DETAILS.items())
    ]


def _line(
    joint: str,
    k: int,
    key: str,
    label: str,
    prismatic: bool,
    declared: BillboardLine | None = None,
) -> Line:
    """Returns the format of line k: the joint's name is on the first, labels are on all."""
    unit, decimals = _UNITS.get(key, _OWN_UNIT)[prismatic]
    scale = 1.0
    if declared is not None:
        unit = unit if declared.unit is None else declared.unit
        decimals = decimals if declared.decimals is None else declared.decimals
        scale = declared.scale
    words = [joint if k == 0 else " " * len(joint), label]
    head = "".join(f"{word}  " for word in words if word)
    tail = (f" {unit}" if unit else "").replace("%", "%%")
    form = f"%{decimals + 5 if decimals else 5}.{decimals}f" + tail
    return Line(head, form, "%10.3e" + tail, scale, decimals, key, head + form % -888.8888)
