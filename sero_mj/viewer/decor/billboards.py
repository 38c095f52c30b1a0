"""Billboards: panels that face the camera and show the values of each joint.

Source: section 2.1 of Hulin, Hertkorn, Preusche: Interactive Features for Robot Viewers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DoublePart, Owner
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES, BillboardLine
from ...robots.declared.scene import Scene
from ...robots.declared.torque_units import NM, N, TorqueUnit
from .billboard_layout import FEWEST, GAP, NO_SHARE, BillboardGroup, heights_in_order
from .feature import Feature, Frame
from .font import Font, line_of
from .geom_buffer import Kind
from .image_view import ImageView
from .joint_titles import LONGEST, longest_name, short_joint_names, shortened, titles
from .layout import LEFT, RIGHT, is_narrow
from .limb_billboards import billboard_limbs
from .panels import PANEL_RGBA, panel_sizes
from .toggles import Toggles

NO_DATA = b"no data"
NO_LIMIT = b"none"
# Labels of the values on billboards with several lines.
_LABELS = {
    "torques": "msr",
    "commanded_torques": "cmd",
    "torque_error": "err",
    "joint_accelerations": "acc",
    "joint_angles": "pos",
    "billboard_values": "val",
}
# Distance of a limb from the middle of its robot at which its billboards change sides, fraction of
# the image width.
_CLOSE = 0.01
_PLAIN_BELOW = 1e6  # value from which numbers are written with an exponent
# Default unit and number of decimals of each value, for revolute and for prismatic joints.
_UNITS = {
    "joint_accelerations": (("rad/s2", 2), ("m/s2", 2)),
    "joint_angles": (("rad", 3), ("m", 4)),
    "torque_share": (("%", 1), ("%", 1)),
}
# Default number of decimals of torques. Their unit is declared by the robot.
_TORQUES = {"torques": 1, "commanded_torques": 1, "torque_error": 2, "torque_limit": 1}
# Torques have enough decimals to resolve this fraction of the torque at full arrow width.
_RESOLUTION, _MAX_DECIMALS, _ROUNDING = 0.01, 4, 1e-9
_OWN_UNIT = (("", 2), ("", 2))  # format of `billboard_values` and of inputs that a robot declares
# Values and labels that a click on an arrow shows (section 2.2).
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}

_LARGEST = "largest seen"  # label if the largest torque so far replaces the limit
_STALE_RGBA = (0.21, 0.21, 0.21, 0.78)
_FILLED = 0.55  # fraction of both sides that billboards may fill before limbs are collapsed
_TINT = 0.30  # fraction of the color of a double in the color of its billboards


class Billboards(Feature):
    """The visual feature that shows the billboards of the joints of a world."""

    order = 10

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        joints = world.joints
        parts = list(world.owners.values())
        declared = [declared_lines(part, world.scene) for part in parts]
        # Default lines show angles until torques arrive, and torque errors if arrows show them.
        defaults = [
            "" if has_chosen_lines(part) or len(lines) > 1 else lines[0].value
            for part, lines in zip(parts, declared, strict=True)
        ]
        self._has_angles = np.array([value == "joint_angles" for value in defaults], bool)
        self._has_torques = np.array([value == "torques" for value in defaults], bool)

        self._formats: dict[int, Formats] = {}
        self._names: dict[int, _LimbNames] = {}
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        self._limbs = limbs = billboard_limbs(world)
        self._limb = limbs.beside
        self._close = 0.0  # becomes `_CLOSE` after the first frame, in which every limb gets a side
        group = limbs.groups[joints.owner]
        every = [np.unique(self._limb[group == each]) for each in np.unique(group)]
        self._limbs_of_groups = [limbs for limbs in every if len(limbs) > 1]
        self._is_in_limbs = np.isin(self._limb, np.concatenate([[-1], *self._limbs_of_groups]))
        self._rank = heights_in_order(_declared_heights(world))
        self._rgba = np.array([_tinted(part) for part in parts]).reshape(-1, 4)[joints.owner]
        self._widths: dict[tuple[int, int], int] = {}

        self._limb_widths: dict[tuple[int, int], int] = {}  # maps (font, limb) to width

    def _formats_for(self, view: ImageView) -> Formats:
        longest = longest_name(view)
        if longest not in self._formats:
            self._formats[longest] = joint_formats(self.world, longest)
        return self._formats[longest]

    def lay_out(self, frame: Frame) -> None:
        """Adds the billboards of the joints that are in the image.

        If there are too many billboards, one billboard replaces those of a whole limb, except for
        joints that were clicked. `BillboardLayout` then selects the billboards of clicked joints
        and of the joints with the largest loads.
        """
        group = self._of_joints(frame)
        if group is None:
            return
        if len(self._limbs.names) > 1:
            room = _room_for(group.sizes, frame.view)
            collapsed = self._limbs.collapsed(group.items, np.isinf(group.share), room)
            if collapsed.any():
                frame.billboards.append(self._of_limbs(frame, group.only(collapsed)))
                group = group.only(~collapsed)
        if group.texts:
            frame.billboards.append(group)

    def _of_limbs(self, frame: Frame, group: BillboardGroup) -> BillboardGroup:
        names, view = self._limb_names(frame.view), frame.view
        of_joint = self._limbs.of_joint
        limb = of_joint[group.items]
        numbers, first = np.unique(limb, return_index=True)
        mine = [(limb == number).nonzero()[0] for number in numbers]
        largest = [rows[group.share[rows].argmax()] for rows in mine]
        texts, widths = [], np.empty(len(numbers))
        for k, (number, rows, top) in enumerate(zip(numbers.tolist(), mine, largest, strict=True)):
            lines = [line_of(f"{names.limbs[number]}  {len(rows)} joints")]
            if group.share[top] > NO_SHARE:
                joint = int(group.items[top])
                value = group.texts[top][0].rsplit(b"  ", 1)[-1].strip()
                if np.isfinite(frame.arrow_limit[joint]):
                    value = b"%.0f %%" % (100 * group.share[top])
                label = line_of(names.joints[joint])
                lines.append(b"max " + label + b"  " + value)
            # Widths do not shrink, because the most loaded joint changes.
            key = (view.font.height, number)
            widths[k] = max(self._limb_widths.get(key, 0), view.font.block_width(lines))
            self._limb_widths[key] = int(widths[k])
            texts.append(lines)
        stale = np.array([frame.stale_joints[group.items[rows]].all() for rows in mine])
        return replace(
            group,
            kind=Kind.LIMB,
            items=np.array([(of_joint == number).argmax() for number in numbers], np.intp),
            anchors=np.array([group.anchors[rows].mean(axis=0) for rows in mine]),
            sizes=panel_sizes(widths, np.array([len(lines) for lines in texts]), view),
            texts=texts,
            owners=group.owners[first],
            side=group.side[first],
            rank=np.array([group.rank[rows].mean() for rows in mine]),
            share=group.share[largest],
            rgba=np.where(stale[:, None], _STALE_RGBA, self._rgba[group.items[first]]),
        )

    def _limb_names(self, view: ImageView) -> _LimbNames:
        longest = longest_name(view)
        if longest not in self._names:
            limbs, world = self._limbs, self.world
            joints = joint_titles(world, LONGEST)
            plain = [
                _without_start(title, limbs.names[limb])
                for title, limb in zip(joints, limbs.of_joint, strict=True)
            ]
            self._names[longest] = _LimbNames(
                shortened(limbs.names, longest), shortened(plain, longest)
            )
        return self._names[longest]

    def _of_joints(self, frame: Frame) -> BillboardGroup | None:
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
        are_errors = (has_torques | self._has_torques[joints.owner]) & shows_errors(toggles)
        lines = [
            formats.details[i]
            if toggles.details[i]
            else formats.modelled[i]
            if toggles.modelled[i]
            else formats.errors[i]
            if are_errors[i]
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
        is_clicked = toggles.details | (toggles.clicked & toggles.billboards)
        # Keep clear of the round arrow of the joint closest to the camera.
        clear = 2.0 * joints.arrow_radius[index].max() / view.pixel_size(float(depth.min()))
        return BillboardGroup(
            kind=Kind.BILLBOARD,
            items=index,
            anchors=anchors,
            sizes=panel_sizes(widths, np.array([len(text) for text in texts]), view),
            texts=texts,
            owners=joints.owner[index],
            side=self._sides(frame)[index],
            rank=self._rank[index],
            share=np.where(is_clicked[index], np.inf, self._shares(frame)[index]),
            clear=clear,
            rgba=np.where(stale[index, None], _STALE_RGBA, self._rgba[index]),
        )

    def _sides(self, frame: Frame) -> Ints:
        if not self._is_in_limbs.any():
            return self._side
        # All billboards of a limb are on the limb's side of the image. Near the middle, the side
        # does not change.
        joints, view = self.world.joints, frame.view
        pixels, depth = view.project(frame.data.site_xpos[joints.centre_site])
        is_before = depth > view.near
        counts = np.maximum(np.bincount(self._limb, is_before), 1.0)
        x = np.bincount(self._limb, np.where(is_before, pixels[:, 0], 0.0)) / counts
        middles = np.zeros(len(counts))
        for limbs in self._limbs_of_groups:
            middles[limbs] = np.median(x[limbs])
        beside = (x - middles)[self._limb]
        moved = self._is_in_limbs & (np.abs(beside) >= self._close * view.width)
        self._close = _CLOSE  # prevents billboards from alternating between the sides
        self._side[moved] = np.where(beside[moved] < 0, LEFT, RIGHT)
        return self._side

    def _shares(self, frame: Frame) -> Array:
        joints = self.world.joints
        of_radius = joints.arrow_radius / joints.arrow_width_scale
        full = np.where(np.isfinite(joints.arrow_load), joints.arrow_load, of_radius)
        full = np.where(np.isfinite(frame.arrow_limit), frame.arrow_limit, full)
        return np.nan_to_num(np.abs(frame.arrow_values) / full, nan=NO_SHARE, posinf=0.0)

    def _write(
        self,
        index: list[int],
        lines: list[list[LineFormat]],
        values: Mapping[str, Array],
        font: Font,
    ) -> tuple[list[list[bytes]], Array]:
        numbers = {
            key: values[key].tolist() for key in {line.key for each in lines for line in each}
        }
        texts = [
            [line.text(numbers[line.key][i]) for line in of_joint]
            for i, of_joint in zip(index, lines, strict=True)
        ]
        widths = [self._width(*each, font) for each in zip(lines, texts, strict=True)]
        return texts, np.array(widths, float)

    def _width(self, lines: list[LineFormat], texts: list[bytes], font: Font) -> int:
        key = (font.height, id(lines))
        if key not in self._widths:
            widest = [line_of(line.widest) for line in lines]
            self._widths[key] = font.block_width(widest)
        width = self._widths[key]
        if any(len(text) > len(line.widest) for text, line in zip(texts, lines, strict=True)):
            width = max(width, font.block_width(texts))
        return width


class _LimbNames(NamedTuple):
    limbs: list[str]
    joints: list[str]


@dataclass(frozen=True)
class Formats:
    """Alternative line formats for the billboards of all joints. Each list has one entry per joint.

    Attributes:
        declared: declared lines, or lines that show the inputs of the robot.
        torques: lines that are used if torques are received but not declared.
        modelled: lines that are used if the torques are computed from the model.
        errors: lines that are used if arrows show torque errors.
        details: lines that are shown after a click on an arrow.
    """

    declared: list[list[LineFormat]]
    torques: list[list[LineFormat]]
    modelled: list[list[LineFormat]]
    errors: list[list[LineFormat]]
    details: list[list[LineFormat]]


def joint_titles(world: WorldView, longest: int) -> list[str]:
    """Returns the billboard title of each joint, with names of at most `longest` characters."""
    parts = list(world.owners.values())
    # Joint names alone are ambiguous if there are several robots.
    is_ambiguous = [len(world.robots) > 1 or isinstance(part, DoublePart) for part in parts]
    return titles(
        [short_joint_names(part.robot.names, part.robot.name) for part in parts],
        [part.declared.name for part in parts],
        is_ambiguous,
        longest,
    )


def joint_formats(world: WorldView, longest: int = LONGEST) -> Formats:
    """Returns the billboard formats of all joints, with names of at most `longest` characters."""
    joints, names = world.joints, joint_titles(world, longest)
    declared = [declared_lines(part, world.scene) for part in world.owners.values()]
    full = np.where(np.isfinite(joints.torque_limit), joints.torque_limit, joints.arrow_load)
    found = Formats([], [], [], [], [])
    for k, (name, owner) in enumerate(zip(names, joints.owner, strict=True)):
        kind = (not joints.revolute[k], joints.torque_units[k], float(full[k]))
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
        found.errors.append([_line(name, 0, "torque_error", _LABELS["torque_error"], *kind)])
        found.details.append(detail_lines(name, *kind, is_largest=bool(joints.is_largest[k])))
    return found


def _tinted(part: object) -> Array:
    rgba = np.array(PANEL_RGBA)
    if isinstance(part, DoublePart):
        rgba[:3] += _TINT * (part.double.rgba[:3] - rgba[:3])
    return rgba


def _room_for(sizes: Array, view: ImageView) -> int:
    (left, bottom), (right, top) = view.free
    gap = GAP * view.font.height
    if is_narrow(sizes, gap, right - left):
        return FEWEST
    return int(_FILLED * 2 * (top - bottom) / (float(np.median(sizes[:, 1])) + gap))


def _without_start(title: str, limb: str) -> str:
    rest = title.removeprefix(limb).lstrip("_ /")
    return rest or title


def _declared_heights(world: WorldView) -> Array:
    data = world.state(world.make_data())
    joints = world.joints
    heights = np.array(data.site_xpos[joints.centre_site, 2])
    for part in world.doubles.values():
        heights[part.joints] = heights[part.of.joints][: part.joints.stop - part.joints.start]
    return heights


@dataclass(frozen=True)
class LineFormat:
    """The format of one line of a billboard: its text before the number, and the number format."""

    head: str
    form: str
    scientific: str
    scale: float
    decimals: int
    key: str
    widest: str

    def text(self, value: float) -> bytes:
        if not math.isfinite(value):
            missing = NO_LIMIT if self.key == "torque_limit" else NO_DATA
            return line_of(self.head) + missing
        # Adding zero converts -0.0, the result of rounding, to 0.0.
        value = round(value * self.scale, self.decimals) + 0.0
        form = self.form if abs(value) < _PLAIN_BELOW else self.scientific
        return line_of(self.head + form % value)


def has_chosen_lines(part: Owner) -> bool:
    """Returns whether a robot or double declares billboard lines instead of using the defaults."""
    return part.declared.billboard_lines is not None or part.billboard_lines is not None


def shows_errors(toggles: Toggles) -> Bools:
    """Returns a mask of the joints whose visible arrows show torque errors, shape (N,)."""
    shown = toggles.arrow_quantity == ARROW_QUANTITIES.index("torque_error")
    return np.asarray(toggles.arrows & shown)


def declared_lines(part: Owner, scene: Scene) -> list[BillboardLine]:
    """Returns the billboard lines of a robot or double: declared lines, or lines for its inputs.

    A double without declared lines has those lines of its robot for which it has values.
    """
    declared = part.declared

    def comes(key: str) -> bool:
        if key == "torque_error":  # computed from measured and commanded torques
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
    joint: str, declared: list[BillboardLine], prismatic: bool, torque: TorqueUnit, full: float
) -> list[LineFormat]:
    """Returns the formats of the declared lines on the billboard of a joint.

    Args:
        joint: title of the joint.
        full: torque at full arrow width, Nm or N; inf if unknown. It determines the number of
            decimals.
    """
    several = len(declared) > 1
    labels = [
        line.label or (_LABELS.get(line.value, line.value) if several else "") for line in declared
    ]
    return [
        _line(joint, k, line.value, label, prismatic, torque, full, line)
        for k, (line, label) in enumerate(zip(declared, labels, strict=True))
    ]


def detail_lines(
    joint: str, prismatic: bool, torque: TorqueUnit, full: float, *, is_largest: bool = False
) -> list[LineFormat]:
    """Returns the formats of the lines that a click on the arrow of a joint shows.

    Args:
        full: torque at full arrow width, Nm or N; inf if unknown.
        is_largest: whether the limit is the largest torque so far, which changes its label.
    """
    labels = {**_DETAILS, "torque_limit": _LARGEST} if is_largest else _DETAILS
    return [
        _line(joint, k, key, label, prismatic, torque, full)
        for k, (key, label) in enumerate(labels.items())
    ]


def _line(
    joint: str,
    k: int,
    key: str,
    label: str,
    prismatic: bool,
    torque: TorqueUnit,
    full: float,
    declared: BillboardLine | None = None,
) -> LineFormat:
    scale = 1.0
    if key in _TORQUES:
        if declared is not None and (declared.unit is not None or declared.scale != 1.0):
            torque = N if prismatic else NM
        (scale, unit), decimals = torque, _TORQUES[key]
        if 0 < full < np.inf:
            needed = math.ceil(-math.log10(_RESOLUTION * scale * full) - _ROUNDING)
            decimals = min(max(decimals, needed), _MAX_DECIMALS)
    else:
        unit, decimals = _UNITS.get(key, _OWN_UNIT)[prismatic]
    if declared is not None:
        unit = unit if declared.unit is None else declared.unit
        decimals = decimals if declared.decimals is None else declared.decimals
        scale *= declared.scale
    words = [joint if k == 0 else " " * len(joint), label]
    head = "".join(f"{word}  " for word in words if word)
    tail = (f" {unit}" if unit else "").replace("%", "%%")
    form = f"%{decimals + 5 if decimals else 5}.{decimals}f" + tail
    return LineFormat(head, form, "%10.3e" + tail, scale, decimals, key, head + form % -888.8888)
