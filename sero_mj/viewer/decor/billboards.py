"""Billboards: panels that face the camera, with the values of every joint.

Source: section 2.1 of Hulin, Hertkorn, Preusche: Interactive Features for Robot Viewers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.frames import Array, Ints
from ...robots.assemble.parts import DoublePart, Owner
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import BillboardLine
from ...robots.declared.scene import Scene
from .card_names import LONGEST, card_names, longest_name, titles
from .cards import NO_SHARE, SMALL, Cards, heights_in_order, owner_groups
from .feature import Feature, Frame
from .font import Font
from .geom_buffer import Kind
from .layout import LEFT, RIGHT
from .panels import PANEL_RGBA, panel_sizes
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
# Of a torque as many decimals are shown as tell this share of that of a full arrow.
_SEEN, _MAX_DECIMALS = 0.01, 4
_OWN_UNIT = (("", 2), ("", 2))  # of `billboard_values` and a robot's own inputs
# Values and labels that a click on an arrow shows (section 2.2).
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}

_LARGEST = "largest seen"  # label of the largest torque seen so far, in place of a limit
_STALE_RGBA = (0.21, 0.21, 0.21, 0.78)
_TINT = 0.30  # fraction of the double's colour in the colour of its panels


class Billboards(Feature):
    """The billboards of one world."""

    order = 10

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        joints = world.joints
        parts = list(world.owners.values())
        self._declared = [declared_lines(part, world.scene) for part in parts]
        # Without declared lines or inputs to show, cards have angles until there are torques.
        self._has_angles = np.array(
            [
                part.declared.billboard_lines is None
                and part.billboard_lines is None
                and [line.value for line in lines] == ["joint_angles"]
                for part, lines in zip(parts, self._declared, strict=True)
            ],
            bool,
        )
        self._formats: dict[int, Formats] = {}
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        is_double = np.array([isinstance(part, DoublePart) for part in parts], bool)
        of_owner = np.where(is_double, np.arange(len(parts)), owner_groups(world))
        self._limb = _limbs(world, of_owner)
        self._close = 0.0  # how far from its robot's middle a limb has no side, picture widths
        group = of_owner[joints.owner]
        every = [np.unique(self._limb[group == each]) for each in np.unique(group)]
        self._limbs_of_groups = [limbs for limbs in every if len(limbs) > 1]
        self._is_in_limbs = np.isin(self._limb, np.concatenate([[-1], *self._limbs_of_groups]))
        self._rank = heights_in_order(_declared_heights(world))
        self._rgba = np.array([_tinted(part) for part in parts]).reshape(-1, 4)[joints.owner]
        self._widths: dict[tuple[int, int], int] = {}
        self._written: dict[int, _Written] = {}  # by joint

    def _formats_for(self, view: PictureView) -> Formats:
        """Returns the lines of all joints, with names as long as the picture has room for."""
        longest = longest_name(view)
        if longest not in self._formats:
            self._formats[longest] = joint_formats(self.world, longest)
        return self._formats[longest]

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
        formats = self._formats_for(view)
        count = np.bincount(joints.owner, np.isfinite(values["torques"]), len(self._has_angles))
        has_torques = (self._has_angles & (count > 0))[joints.owner]
        lines = [
            formats.details[i]
            if toggles.details[i]
            else formats.modelled[i]
            if toggles.modelled[i]
            else formats.torques[i]
            if has_torques[i]
            else formats.declared[i]
            for i in index
        ]
        if toggles.details.any():
            limit = joints.torque_limit
            share = 100 * np.abs(values["torques"]) / limit
            values = {**values, "torque_limit": limit, "torque_share": share}
        texts, widths = self._write(index.tolist(), lines, values, view.font)
        asked = toggles.details | (toggles.clicked & toggles.billboards)
        # Clear of the round arrows of the joint closest to the camera.
        clear = 2.0 * joints.arrow_radius[index].max() / view.pixel_size(float(depth.min()))
        return Cards(
            kind=Kind.BILLBOARD,
            items=index,
            anchors=anchors,
            sizes=panel_sizes(widths, np.array([len(text) for text in texts]), view),
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
        counts = np.maximum(np.bincount(self._limb, is_before), 1.0)
        across = np.bincount(self._limb, np.where(is_before, pixels[:, 0], 0.0)) / counts
        middles = np.zeros(len(counts))
        for limbs in self._limbs_of_groups:
            middles[limbs] = np.median(across[limbs])
        beside = (across - middles)[self._limb]
        moved = self._is_in_limbs & (np.abs(beside) >= self._close * view.width)
        self._close = _CLOSE  # from the first picture on, so that cards do not go to and fro
        self._side[moved] = np.where(beside[moved] < 0, LEFT, RIGHT)
        return self._side

    def _shares(self, frame: Frame) -> Array:
        """Returns the value of every joint's arrow over that of full width, (N,)."""
        joints = self.world.joints
        of_radius = joints.arrow_radius / joints.arrow_width_scale
        full = np.where(np.isfinite(joints.arrow_load), joints.arrow_load, of_radius)
        full = np.where(np.isfinite(frame.arrow_limit), frame.arrow_limit, full)
        return np.nan_to_num(np.abs(frame.arrow_values) / full, nan=NO_SHARE, posinf=0.0)

    def _write(
        self, index: list[int], lines: list[list[Line]], values: Mapping[str, Array], font: Font
    ) -> tuple[list[list[bytes]], Array]:
        """Returns the texts of joints' cards and their widths, (k,), pixels.

        Cards of joints whose numbers did not change are not written anew.
        """
        numbers = {
            key: values[key].tolist() for key in {line.key for each in lines for line in each}
        }
        written = []
        for i, of_joint in zip(index, lines, strict=True):
            shown = [numbers[line.key][i] for line in of_joint]
            last = self._written.get(i)
            if (
                last is None
                or last.lines is not of_joint
                or last.numbers != shown
                or last.height != font.height
            ):
                texts = [line.text(number) for line, number in zip(of_joint, shown, strict=True)]
                width = self._width(of_joint, texts, font)
                last = self._written[i] = _Written(of_joint, shown, font.height, texts, width)
            written.append(last)
        return [each.texts for each in written], np.array([each.width for each in written], float)

    def _width(self, lines: list[Line], texts: list[bytes], font: Font) -> int:
        """Returns the width of a card's text, pixels, constant but for unusually long numbers."""
        key = (font.height, id(lines))
        if key not in self._widths:
            widest = [line.widest.encode("ascii", "replace") for line in lines]
            self._widths[key] = font.block_width(widest)
        width = self._widths[key]
        if any(len(text) > len(line.widest) for text, line in zip(texts, lines, strict=True)):
            width = max(width, font.block_width(texts))
        return width


@dataclass(frozen=True)
class _Written:
    """What a joint's card says.

    Attributes:
        lines: their formats.
        numbers: of the lines.
        height: of the font, pixels.
        texts: of the lines.
        width: of the text, pixels.
    """

    lines: list[Line]
    numbers: list[float]
    height: int
    texts: list[bytes]
    width: int


@dataclass(frozen=True)
class Formats:
    """The lines of every joint's billboard.

    Attributes:
        declared: as declared, or what its robot has inputs for.
        torques: where these have come without being declared.
        modelled: where these are the model's.
        details: that a click on its arrow shows.
    """

    declared: list[list[Line]]
    torques: list[list[Line]]
    modelled: list[list[Line]]
    details: list[list[Line]]


def joint_formats(world: WorldView, longest: int = LONGEST) -> Formats:
    """Returns the lines of all joints, with names of at most `longest` characters."""
    joints, parts = world.joints, list(world.owners.values())
    declared = [declared_lines(part, world.scene) for part in parts]
    # With several robots, joint names alone are ambiguous.
    is_ambiguous = [len(world.robots) > 1 or isinstance(part, DoublePart) for part in parts]
    names = titles(
        [card_names(part.robot.names, part.robot.name) for part in parts],
        [part.declared.name for part in parts],
        is_ambiguous,
        longest,
    )
    full = np.where(np.isfinite(joints.torque_limit), joints.torque_limit, joints.arrow_load)
    found = Formats([], [], [], [])
    for k, (name, owner) in enumerate(zip(names, joints.owner, strict=True)):
        kind = (not joints.revolute[k], float(full[k]))
        lines = declared[owner]
        is_angle = [line.value for line in lines] == ["joint_angles"]
        torques = [BillboardLine(value="torques")] if is_angle else lines
        found.declared.append(billboard_lines(name, lines, *kind))
        found.torques.append(billboard_lines(name, torques, *kind))
        of_model = [
            line.model_copy(update={"label": "model"}) if line.value == "torques" else line
            for line in torques
        ]
        found.modelled.append(billboard_lines(name, of_model, *kind))
        found.details.append(detail_lines(name, *kind, is_largest=bool(joints.is_largest[k])))
    return found


def _tinted(part: object) -> Array:
    """Returns the colour of a panel (4,); panels of doubles are tinted in the double's colour."""
    rgba = np.array(PANEL_RGBA)
    if isinstance(part, DoublePart):
        rgba[:3] += _TINT * (part.double.rgba[:3] - rgba[:3])
    return rgba


def _limbs(world: WorldView, groups: Ints) -> Ints:
    """Returns the limb whose cards stand together with every joint's, (N,).

    A limb that is small beside the one that carries it counts with that: fingers with their arm.
    All robots that stand with another one are one limb: the fingers of a hand.

    Args:
        world: the compiled scene.
        groups: index of the robot with which every robot and double stands, (len(owners),).
    """
    joints = world.joints
    centres = world.state(world.make_data()).site_xpos[joints.centre_site]
    limb = joints.limb.copy()
    for part in world.owners.values():
        first = part.joints.start
        n = part.joints.stop - first
        carriers = part.robot.carriers
        below = first + (np.arange(n) if carriers is None else carriers[:n]) - 1
        on_base = below < first
        below[on_base] = (first + np.arange(n))[on_base]
        own = joints.limb[part.joints]
        steps = np.linalg.norm(centres[part.joints] - centres[below], axis=1)
        lengths = np.bincount(own, np.where(joints.limb[below] == own, steps, 0.0))
        for k in np.flatnonzero(joints.limb[below] != own):  # the first joints of limbs
            if lengths[own[k]] < SMALL * lengths[joints.limb[below[k]]]:
                limb[part.joints][own == own[k]] = limb[below[k]]
    is_carried = groups != np.arange(len(groups))
    for group in np.unique(groups[is_carried]):
        limb[(is_carried & (groups == group))[joints.owner]] = limb.max() + 1
    return limb


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


def billboard_lines(
    joint: str, declared: list[BillboardLine], prismatic: bool, full: float = np.inf
) -> list[Line]:
    """Returns the line formats of one joint's billboard.

    Args:
        joint: its name.
        declared: the declared lines.
        prismatic: whether the joint is prismatic, for units.
        full: torque of an arrow of full width, Nm or N, for decimals; inf where unknown.
    """
    several = len(declared) > 1
    labels = [
        line.label or (_LABELS.get(line.value, line.value) if several else "") for line in declared
    ]
    return [
        _line(joint, k, line.value, label, prismatic, full, line)
        for k, (line, label) in enumerate(zip(declared, labels, strict=True))
    ]


def detail_lines(
    joint: str, prismatic: bool, full: float = np.inf, *, is_largest: bool = False
) -> list[Line]:
    """Returns the line formats of all values of one joint's arrow, see `billboard_lines`.

    Args:
        joint: its name.
        prismatic: whether the joint is prismatic.
        full: torque of an arrow of full width.
        is_largest: whether its limit is the largest torque seen so far, which its line then says.
    """
    labels = {**_DETAILS, "torque_limit": _LARGEST} if is_largest else _DETAILS
    return [
        _line(joint, k, key, label, prismatic, full)
        for k, (key, label) in enumerate(labels.items())
    ]


def _line(
    joint: str,
    k: int,
    key: str,
    label: str,
    prismatic: bool,
    full: float,
    declared: BillboardLine | None = None,
) -> Line:
    """Returns the format of line k: the joint's name is on the first, labels are on all."""
    unit, decimals = _UNITS.get(key, _OWN_UNIT)[prismatic]
    if unit in ("Nm", "N") and 0 < full < np.inf:
        decimals = min(max(decimals, math.ceil(-math.log10(_SEEN * full))), _MAX_DECIMALS)
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
