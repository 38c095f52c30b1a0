"""The legend, which shows the quantities that arrows represent, and their scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...base.frames import Array, Bools, round_down_1_2_5
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from .feature import Feature, Frame
from .font import line_of
from .image_view import ImageView
from .panels import PADDING, Panels, panel_sizes
from .round_arrows import FULL_WIDTH, WIDEST, drawn_widths
from .smart_arrows import SHORTEST, arrow_vectors
from .toggles import Toggles

_RGBA = (0.09, 0.11, 0.14, 0.6)
# Names of the colors in `round_arrows`. A test compares them.
_SIGNS = b"orange: + about z, blue: -"
_LARGEST_SHARE = 0.10  # maximum fraction of the image that the legend covers
_MARGIN = 0.5  # distance from the image border, fraction of the line height
_MODELLED = "gravity torque of the model"
_WORDS = {
    "torques": ("joint torque", "torque limit"),
    "torque_error": ("torque error, commanded - measured", "torque limit"),
    "joint_accelerations": ("joint acceleration", "acceleration limit"),
    "singularity": ("direction towards the singularity", "at the singularity"),
    "torque_without_gravity": ("torque minus the model's gravity torque", "torque limit"),
    "torque_without_friction": ("torque minus the model's friction", "torque limit"),
}
_STATED_LENGTH = 0.1  # m; scales of smart arrows state a round value of about this length
_MAX_NAMES = 32  # maximum length of the list of names before a note or a scale, characters
# Inputs that are required for each quantity.
_NEEDED = {
    "torques": ("torques",),
    "torque_error": ("torques", "commanded_torques"),
    "joint_accelerations": ("joint_accelerations",),
    "singularity": (),
    "torque_without_gravity": ("torques",),
    "torque_without_friction": ("torques",),
}
# Quantities that are forces for prismatic joints.
_TORQUES = ("torques", "torque_error", "torque_without_gravity", "torque_without_friction")
_LARGEST = "largest seen so far"
_UNLIMITED = "width grows with the value"
_BY_LOAD = f"width grows up to {WIDEST / FULL_WIDTH:g} times gravity's load"
# The scale has a bar before each percentage, which is as wide as an arrow at that load.
_SHARES = np.array([0.1, 0.5, 1.0])
SCALE = ("     10 %", "     50 %", "     ")  # followed by the name of the limit
_BAR_WIDTH, _BAR_HEIGHT = 0.4, 0.8  # fractions of the line height


def arrows_line(quantity: str, has_sliding: bool) -> str:
    """Returns the line of the legend that names the quantity of round arrows."""
    return _arrows_line(quantity, _WORDS[quantity][0], has_sliding)


def _arrows_line(quantity: str, what: str, has_sliding: bool) -> str:
    return f"round arrows: {what}{', or force' * (has_sliding and quantity in _TORQUES)}"


class Legend(Feature):
    """The visual feature that explains the arrows by panels in the lower left corner.

    Each quantity has its own panel. Notes of the scene and its robots are shown below these panels.

    Attributes:
        is_steady: whether explanations stay visible after their arrows have disappeared.
    """

    order = 40
    is_steady = True

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._key: object = None
        self._panels: list[Panels] = []
        self._notes = _notes(world)
        self._drawn = np.zeros(len(world.arrows.names), bool)  # smart arrows drawn so far
        self._joints = np.arange(len(world.joints.names))
        self._routed = _routed(world)
        self._known = np.zeros_like(self._routed)  # arrows drawn so far, by quantity and joint

    def lay_out(self, frame: Frame) -> None:
        """Adds the legend if it is switched on and there are arrows or notes to explain."""
        frame.corners += self._shown(frame)

    def _shown(self, frame: Frame) -> list[Panels]:
        toggles, view, limit = frame.toggles, frame.view, frame.arrow_limit
        self._note_drawn(frame)
        arrows = toggles.arrows & self._expected(frame)
        is_needed = arrows.any() or (toggles.vectors & self._drawn).any() or self._notes
        if not toggles.legend or not is_needed:
            return []
        key = (
            arrows.tobytes(),
            toggles.arrow_quantity.tobytes(),
            toggles.modelled.tobytes(),
            (toggles.vectors & self._drawn).tobytes(),
            view.font.height,
            view.width,
            view.height,
            view.inset,
        )
        if key != self._key:  # changes only with the toggles, the image and the drawn arrows
            self._key, self._panels = key, self._laid_out(toggles, arrows, view, limit)
        return self._panels

    def _expected(self, frame: Frame) -> Bools:
        joints, of_quantity = self.world.joints, (frame.toggles.arrow_quantity, self._joints)
        drawn = drawn_widths(joints, frame.arrow_values, frame.arrow_limit) > 0.0
        drawn &= frame.toggles.arrows
        self._known[of_quantity] |= np.isin(joints.owner, joints.owner[drawn])
        return np.asarray((self._routed | self._known)[of_quantity])

    def _note_drawn(self, frame: Frame) -> None:
        if not self.is_steady:
            self._drawn[:] = self._known[:] = False
        new = frame.shown.vectors & ~self._drawn
        if new.any():
            sizes = np.linalg.norm(arrow_vectors(self.world, frame.data)[1], axis=1)
            self._drawn |= new & (np.nan_to_num(sizes) * self.world.arrows.scale > SHORTEST)

    def _laid_out(
        self, toggles: Toggles, arrows: Bools, view: ImageView, limit: Array
    ) -> list[Panels]:
        margin = _MARGIN * view.font.height
        scales = self._scales(toggles)
        texts = [lines for lines in (self._notes, scales) if lines]
        of_torque = toggles.arrow_quantity == ARROW_QUANTITIES.index("torques")
        kinds = [
            (code, arrows & (toggles.arrow_quantity == code) & of_model)
            for code in sorted(set(toggles.arrow_quantity[arrows].tolist()))
            for of_model in (~(toggles.modelled & of_torque), toggles.modelled & of_torque)
        ]
        for code, shown in kinds:
            if not shown.any():
                continue
            quantity = ARROW_QUANTITIES[code]
            what, width = _WORDS[quantity]
            if quantity == "torque_error":
                what = self._difference(shown) or what
            if (toggles.modelled & of_torque)[shown].any():
                what = _MODELLED
            without = shown & ~np.isfinite(limit)
            has_scale = bool((shown & ~without).any())
            has_load = np.isfinite(self.world.joints.arrow_load[without]).any()
            unlimited = _BY_LOAD if has_load else _UNLIMITED
            if not has_scale:
                width = unlimited
            elif quantity in _TORQUES and (largest := self.world.joints.is_largest[shown]).any():
                width = _LARGEST if largest.all() else f"{width}, or {_LARGEST}"
            scale = "".join(SCALE) + width if has_scale else width
            has_sliding = not self.world.joints.revolute[shown].all()
            first = _arrows_line(quantity, what, has_sliding).encode()
            lines = [first, _SIGNS, scale.encode()]
            if has_scale and without.any():
                lines.insert(2, f"{self._who(shown, without)}: {unlimited}".encode())
            texts.append(lines)
        widths = np.array([max(view.font.width(line) for line in lines) for lines in texts])
        sizes = panel_sizes(widths, np.array([len(lines) for lines in texts]), view)
        # Panels that would cover too much of a small image are omitted.
        room = _LARGEST_SHARE * view.width * view.height
        count = int((np.cumsum(sizes.prod(axis=1)) < room).sum())
        if not count:
            return []
        below = np.concatenate([[0.0], np.cumsum(sizes[:-1, 1] + margin)])
        centres = view.free[0] + margin + sizes / 2
        centres[:, 1] += below
        panels = Panels(centres[:count], sizes[:count], texts[:count], _RGBA)
        of_arrows = np.arange(count) >= bool(self._notes)
        notes, scaled = panels.only(~of_arrows), panels.only(of_arrows)
        scaled = replace(scaled, bars=_bars(scaled, view), of_arrows=True)
        return [each for each in (notes, scaled) if each.texts]

    def _who(self, shown: Bools, without: Bools) -> str:
        owners = self.world.joints.owner
        names = list(self.world.owners)
        mine = set(owners[without].tolist()) - set(owners[shown & ~without].tolist())
        is_all = bool(np.isin(owners[without], list(mine)).all())
        robots = _named([names[k] for k in sorted(mine)]) if is_all else ""
        return robots or "without a limit"

    def _difference(self, shown: Bools) -> str:
        owners = list(self.world.owners.values())
        names = {
            line.label
            for k in np.unique(self.world.joints.owner[shown])
            for line in owners[k].declared.billboard_lines or ()
            if line.value == "torque_error" and line.label
        }
        return f"difference of torques, {names.pop()}" if len(names) == 1 else ""

    def _scales(self, toggles: Toggles) -> list[bytes]:
        scene = self.world.scene
        lines: dict[str, list[str]] = {}
        kinds: dict[str, dict[str, None]] = {}
        shown = toggles.vectors & self._drawn
        for name in np.array(self.world.arrows.names, object)[shown]:
            arrow = scene.arrows[name]
            value = round_down_1_2_5(_STATED_LENGTH / arrow.metres_per_unit)
            size = 1e3 * value * arrow.metres_per_unit
            word = "wide" if arrow.is_round else "long"
            scale = f"{size:g} mm {word} = {value:g} {arrow.unit_text}"
            lines.setdefault(scale, []).append(name)
            kinds.setdefault(scale, {})[arrow.kind.replace("_", " ")] = None
        texts = [
            f"{_named(names) or ', '.join(kinds[scale]) + ' arrows'}: {scale}"
            for scale, names in lines.items()
        ]
        return [line_of(text) for text in texts]


def _routed(world: WorldView) -> Bools:
    found = np.zeros((len(ARROW_QUANTITIES), len(world.joints.names)), bool)
    for name, part in world.owners.items():
        for code, quantity in enumerate(ARROW_QUANTITIES):
            found[code, part.joints] = all(
                world.scene.routed(f"{name}.{key}") is not None for key in _NEEDED[quantity]
            )
    return found


def _notes(world: WorldView) -> list[bytes]:
    robots = world.scene.robots
    lines = [world.scene.note]
    for note in dict.fromkeys(robot.note for robot in robots.values()):
        names = [name for name, robot in robots.items() if robot.note == note]
        if len(names) == len(robots):
            lines.append(note)
        elif note:
            lines.append(f"{_named(names) or f'{len(names)} robots'}: {note}")
    unique = dict.fromkeys(line for line in lines if line)
    return [line_of(line) for line in unique]


def _named(names: list[str]) -> str:
    listed = ", ".join(names)
    return listed if len(names) == 1 or len(listed) <= _MAX_NAMES else ""


def _bars(panels: Panels, view: ImageView) -> Array:
    line = view.font.height
    ends = np.array([view.font.width("".join(SCALE[:k]) + SCALE[-1]) for k in range(len(SCALE))])
    bars = []
    for centre, size, texts in zip(panels.centres, panels.sizes, panels.texts, strict=True):
        if texts[-1].startswith(SCALE[0].encode()):
            left, bottom = centre - size / 2 + PADDING * line * np.array([1.0, 0.5])
            for end, share in zip(ends, _SHARES, strict=True):
                height = _BAR_HEIGHT * line * np.sqrt(share)
                x = left + end - 1.85 * _BAR_WIDTH * line
                bars.append([x, bottom + 0.1 * line, _BAR_WIDTH * line, height])
    return np.array(bars).reshape(-1, 4)
