"""`Decor`: draws all visual features of a world for given data, toggles and view."""

from __future__ import annotations

import logging

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from ...base.plugins import is_own_class
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT, fade_in, spread_out
from .billboard_layout import LEADER_RGBA, BillboardLayout, owner_groups
from .feature import Drawn, Frame, make_features
from .font import line_of
from .geom_buffer import CAPACITY, GeomBuffer
from .image_view import ImageView
from .panels import Panels, clear_of, draw_panels, labels_at, panel_sizes
from .quantities import arrow_values, joint_values
from .staleness import Staleness
from .toggles import Toggles

log = logging.getLogger(__name__)

_BESIDE = 0.6  # distance of the label from the pointer, fraction of the line height
# Candidate positions of the label: first the lower right, where pointers do not cover it.
_CORNERS = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0]])
# Fraction of white in panels. Without it, panels would be invisible in front of the dark floor.
_LIGHTER = {"light": 0.0, "dark": 0.14}
_HOVER_RGBA = (0.20, 0.20, 0.16, 0.90)


class Decor:
    """All visual features of a world, and the buffer into which they draw each frame."""

    def __init__(self, world: WorldView, capacity: int = CAPACITY) -> None:
        self.buffer = GeomBuffer(capacity)
        self.features: list[Drawn] = [*make_features(world)]
        self.panels: list[Panels] = []
        self._world = world
        self._staleness = Staleness(world)
        self._layout = BillboardLayout(owner_groups(world))
        self._outline = Outline(world)

    def draw(self, data: mujoco.MjData, toggles: Toggles, view: ImageView) -> GeomBuffer:
        """Draws all features of one frame and returns the buffer with its geoms."""
        buffer, world = self.buffer, self._world
        of_model, data = data, world.state(data)
        buffer.clear()
        toggles.apply_inputs(data)
        buffer.hidden = toggles.hidden_geoms()
        buffer.opacity = _opacity(world, of_model)
        buffer.drawn_doubles = world.drawn_doubles(data, toggles.doubles)
        stale = self._staleness.find(data)
        for name, on in zip(world.doubles, toggles.doubles, strict=True):
            if not on:
                stale.pop(name, None)
        values = joint_values(world, data)
        arrows, limit = arrow_values(world, data, values, toggles.arrow_quantity)
        frame = Frame(
            buffer=buffer,
            data=data,
            view=view,
            toggles=toggles,
            shown=toggles.shown(data),
            values=values,
            arrow_values=arrows,
            arrow_limit=limit,
            stale=stale,
            stale_joints=self._staleness.joints(stale),
        )
        self._each("lay_out", frame)
        look = world.scene.view.look
        billboards: list[Panels] = []
        if frame.billboards:
            body = self._outline.points(of_model, buffer.hidden, data.site_xpos, frame.shown.arrows)
            frame.billboards, billboards, note = self._layout.lay_out(
                buffer, view, frame.billboards, *body, frame.corners, LEADER_RGBA[look]
            )
            frame.corners += note
        notes = self._staleness.panels(buffer, data, view, stale)
        panels = [*frame.corners, *billboards]
        panels += clear_of([*frame.panels, *notes], panels, view)
        # Text is added before arrows, so that arrows are dropped if the capacity is exceeded.
        panels += _hover_panel(toggles, view, panels)
        self.panels = draw_panels(buffer, view, panels, _LIGHTER[look])
        self._each("draw", frame)
        return buffer

    def _each(self, step: str, frame: Frame) -> None:
        for feature in [*self.features]:
            try:
                getattr(feature, step)(frame)
            except Exception:
                if is_own_class(type(feature)):
                    raise
                log.exception("%s cannot be drawn and is disabled", type(feature))
                self.features.remove(feature)


def _opacity(world: WorldView, data: mujoco.MjData) -> Array | None:
    compiled = [part for part in world.doubles.values() if part.is_compiled]
    if not compiled:
        return None
    factors = np.ones(world.model.nbody)
    for part in compiled:
        # A double fades in as it leaves its robot.
        links, own = part.bodies, part.of.bodies
        factors[links] = fade_in(data.xpos[links], data.xmat[links], data.xpos[own], data.xmat[own])
        if part.path is not None:
            factors[links] *= spread_out(data.xpos[links], part.robot.arrow_radii)
    return np.asarray(factors[world.model.geom_bodyid])


def _hover_panel(toggles: Toggles, view: ImageView, others: list[Panels]) -> list[Panels]:
    if toggles.hover is None:
        return []
    text, pixel = toggles.hover
    lines = [[line_of(text)]]
    width = np.array([view.font.width(lines[0][0])])
    size = panel_sizes(width, 1, view)[0]
    centres = np.array(pixel) + (size / 2 + _BESIDE * view.font.height) * _CORNERS
    centres, sizes = labels_at(view, centres, lines * len(_CORNERS))
    covered = np.zeros(len(_CORNERS))
    for panels in others:
        overlap = (sizes[0] + panels.sizes) / 2 - np.abs(centres[:, None] - panels.centres)
        covered += np.maximum(overlap, 0.0).prod(axis=2).sum(axis=1)
    best = covered.argmin()  # the first candidate if several are equal
    return [Panels(centres[best : best + 1], sizes[:1], lines, _HOVER_RGBA, in_front=True)]


class Outline:
    """The approximate shape of all robots and doubles, which billboards avoid.

    Each geom is approximated by a capsule along its longest side, with points at both ends and in
    the middle.
    """

    def __init__(self, world: WorldView) -> None:
        model = world.model
        owner = np.full(model.ngeom, -1)
        for i, part in enumerate(world.owners.values()):
            owner[np.isin(model.geom_bodyid, part.bodies)] = i
        owner[(model.geom_group > 2) | (model.geom_rgba[:, 3] <= 0)] = -1
        self._geoms = (owner >= 0).nonzero()[0]
        centre, half = np.hsplit(model.geom_aabb[self._geoms], 2)
        longest = half.argmax(axis=1)
        self._radii = np.sort(half, axis=1)[:, 1]
        along = np.eye(3)[longest] * (half.max(axis=1) - self._radii)[:, None]
        self._offsets = np.stack([centre - along, centre, centre + along], axis=1)
        self._owners = owner[self._geoms]
        self._joints = world.joints

    def points(
        self,
        data: mujoco.MjData,
        hidden: Bools | None,
        sites: Array,
        arrows: Bools,
    ) -> tuple[Array, Array, Ints]:
        """Returns points on robots and doubles, with the radius and the owner of each point.

        Args:
            hidden: mask of the geoms that are not shown, shape (ngeom,); None if all are shown.
            sites: positions of all sites, `site_xpos`, m.
            arrows: mask of the joints whose arrows are part of the outline, shape (N,).

        Returns:
            points, shape (m, 3), m; radii, shape (m,), m; indices of robots or doubles, shape (m,).
        """
        rotation = data.geom_xmat[self._geoms].reshape(-1, 1, 3, 3)
        points = data.geom_xpos[self._geoms, None] + (rotation @ self._offsets[..., None])[..., 0]
        is_shown = points[:, 0, 2] > OUT_OF_SIGHT[2] / 2  # False for doubles without a pose
        if hidden is not None:
            is_shown &= ~hidden[self._geoms]
        joints = self._joints
        of_links, of_arrows = points[is_shown].reshape(-1, 3), sites[joints.centre_site[arrows]]
        radii = np.repeat(self._radii[is_shown], 3), joints.arrow_radius[arrows]
        owners = np.repeat(self._owners[is_shown], 3), joints.owner[arrows]
        return np.concatenate([of_links, of_arrows]), np.concatenate(radii), np.concatenate(owners)
