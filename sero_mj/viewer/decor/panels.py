"""Translucent panels with text, laid out in pixels, in front of the scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools, Ints
from .font import line_of
from .geom_buffer import GeomBuffer, Kind, place_triangles
from .image_view import ImageView
from .layout import place_clear

PANEL_RGBA = (0.09, 0.11, 0.14, 0.78)
# Depths in units of the near plane distance. Text is in front of panels, leaders and the scene.
_PANEL_DEPTH, _LEADER_DEPTH = 1.5, 1.6
_FRONT_DEPTH = 1.3  # depth of panels in front of other panels
_BAR_DEPTH = 1.45
_TEXT_NEARER = 0.1
BAR_RGBA = (0.93, 0.93, 0.93, 1.0)
_UPPER_LEFT = np.array([-0.5, 0.5])
_LEADER_BASE = 0.22  # width of a leader at its panel, fraction of the line height
_BENT = 0.6  # width of a bent leader, fraction of the width of a straight one
PADDING = 0.35  # space between text and the left or right edge, fraction of the line height


def panel_sizes(text_widths: Array, lines: NDArray[np.intp] | int, view: ImageView) -> Array:
    """Returns the widths and heights of panels with text, shape (k, 2), pixels.

    Args:
        text_widths: width of the widest line of each panel, shape (k,), pixels.
        lines: number of lines of each panel, shape (k,), or one number for all panels.
    """
    line = view.font.height
    sizes = np.empty((len(text_widths), 2))
    sizes[:, 0] = text_widths + 2 * PADDING * line
    sizes[:, 1] = np.asarray(lines) * line + PADDING * line
    return sizes


@dataclass(frozen=True, eq=False)
class Panels:
    """A set of k panels with text, positioned in pixels.

    Attributes:
        texts: lines of each panel, top line first.
        rgba: one color for all panels, or one color for each, shape (k, 4).
        items: index of the item that each panel describes, shape (k,).
        in_front: whether the panels cover other panels. Covered text is not drawn.
        has_values: whether the lines contain values, which may be aligned in columns.
        bars: light bars on the panels, shape (m, 4), pixels. The columns are left, bottom, width
            and height.
        of_arrows: whether the panels only explain arrows, so that images without arrows omit them.
    """

    centres: Array
    sizes: Array
    texts: list[list[bytes]]
    rgba: tuple[float, float, float, float] | Array = PANEL_RGBA
    kind: Kind = Kind.NONE
    items: NDArray[np.intp] | None = None
    in_front: bool = False
    has_values: bool = False
    bars: Array | None = None
    of_arrows: bool = False

    def only(self, shown: Bools) -> Panels:
        return replace(
            self,
            centres=self.centres[shown],
            sizes=self.sizes[shown],
            texts=[text for text, is_shown in zip(self.texts, shown, strict=True) if is_shown],
            rgba=self.rgba[shown] if isinstance(self.rgba, np.ndarray) else self.rgba,
            items=None if self.items is None else self.items[shown],
        )


def labels_at(view: ImageView, centres: Array, texts: list[list[bytes]]) -> tuple[Array, Array]:
    """Returns the centers and sizes of labels, with centers moved so that labels are visible."""
    widths = np.array([max(view.font.width(line) for line in lines) for lines in texts], float)
    sizes = panel_sizes(widths, np.array([len(lines) for lines in texts]), view)
    half = sizes / 2
    low, high = view.free
    return np.clip(centres, low + half, np.maximum(high - half, low + half)), sizes


def labels_below(places: Array, names: list[str], view: ImageView) -> tuple[Panels, Ints] | None:
    """Returns labels with the names of the points in the image, and the indices of these points.

    A label is below its point. `places` has all points, shape (k, 3), m. Returns None if no point
    is in the image.
    """
    pixels, depth = view.project(places)
    visible = view.sees(pixels, depth).nonzero()[0]
    if not len(visible):
        return None
    lines = [[line_of(names[k])] for k in visible.tolist()]
    centres, sizes = labels_at(view, pixels[visible] - [0.0, view.font.height], lines)
    return Panels(centres, sizes, lines), visible


def clear_of(labels: list[Panels], others: list[Panels], view: ImageView) -> list[Panels]:
    """Returns labels that are moved so that they overlap neither each other nor other panels.

    Names of frames are omitted if there is no room, because overlapping text is unreadable.

    Args:
        labels: labels to move. The first ones are placed first.
        others: panels with fixed positions.
    """
    if not labels:
        return []
    taken = np.concatenate(
        [np.hstack([p.centres - p.sizes / 2, p.centres + p.sizes / 2]) for p in others]
        or [np.zeros((0, 4))]
    )
    is_name = np.concatenate([np.full(len(each.texts), each.kind == Kind.NAME) for each in labels])
    centres, has_room = place_clear(
        np.concatenate([label.centres for label in labels]),
        np.concatenate([label.sizes for label in labels]),
        taken,
        *view.free,
        is_needed=~is_name,
    )
    ends = np.cumsum([len(label.texts) for label in labels])
    parts = zip(labels, np.split(centres, ends[:-1]), np.split(has_room, ends[:-1]), strict=True)
    return [
        replace(label, centres=at).only(fits | (label.kind != Kind.NAME))
        for label, at, fits in parts
    ]


def draw_panels(
    buffer: GeomBuffer, view: ImageView, groups: list[Panels], lighter: float = 0.0
) -> list[Panels]:
    """Draws all panels of a frame in one vectorized pass.

    Args:
        groups: panels to draw.
        lighter: fraction of white that is added to the colors of the panels.

    Returns:
        the drawn panels from back to front. Lines that other panels cover are empty. The list is
        empty if the panels exceed the capacity of the buffer.
    """
    groups = sorted((group for group in groups if group.texts), key=lambda group: group.in_front)
    if not groups:
        return []
    centres = np.concatenate([group.centres for group in groups])
    sizes = np.concatenate([group.sizes for group in groups])
    texts = [lines for group in groups for lines in group.texts]
    in_front: NDArray[np.bool_] = np.array([g.in_front for g in groups for _ in g.texts], bool)
    depth = np.where(in_front, _FRONT_DEPTH, _PANEL_DEPTH)[:, None] * view.near
    first, start = buffer.count, 0
    rows = buffer.take(len(texts), int(mujoco.mjtGeom.mjGEOM_BOX))
    if not len(rows):
        return []
    for group in groups:
        stop = start + len(group.texts)
        rows["rgba"][start:stop] = group.rgba
        if group.items is not None:
            buffer.kinds[first + start : first + stop] = group.kind
            buffer.items[first + start : first + stop] = group.items
        start = stop
    rows["rgba"][:, :3] += lighter * (1.0 - rows["rgba"][:, :3])
    rows["pos"] = view.at(centres, depth)
    rows["mat"] = view.facing
    pixel = view.pixel_size(depth)
    rows["size"][:, :2] = sizes * (pixel / 2)
    rows["size"][:, 2:] = pixel / 10
    rows["emission"] = 1.0

    line = view.font.height
    panel = np.array([k for k, lines in enumerate(texts) for _ in lines])
    row = np.array([j for lines in texts for j in range(len(lines))])
    lines = [text for lines in texts for text in lines]
    starts = (centres + sizes * _UPPER_LEFT)[panel]
    starts[:, 0] += PADDING * line
    starts[:, 1] -= (PADDING / 2 + 1 + row) * line
    visible = np.ones(len(lines), bool)
    if in_front.any():
        visible = ~_covered(view, starts, lines, centres[in_front], sizes[in_front])
        visible |= in_front[panel]
    drawn = _as_drawn(groups, rows["rgba"].astype(float), visible)
    starts, panel = starts[visible], panel[visible]
    lines = [text for text, is_visible in zip(lines, visible, strict=True) if is_visible]
    _draw_lines(buffer, view, starts, lines, depth[panel])
    for group in groups:
        if group.bars is not None:
            _draw_bars(buffer, view, group.bars)
    buffer.text = slice(first, buffer.count)
    return drawn


def _draw_lines(
    buffer: GeomBuffer, view: ImageView, starts: Array, lines: list[bytes], depth: Array
) -> None:
    labels = buffer.take(len(starts), int(mujoco.mjtGeom.mjGEOM_LABEL))
    if not len(labels):
        return
    labels["pos"] = view.at(starts, depth - _TEXT_NEARER * view.near)
    labels["mat"] = view.facing
    labels["size"] = view.pixel_size(depth)
    labels["rgba"] = 1.0
    labels["label"] = [line.decode("utf-8", "replace").encode("ascii", "replace") for line in lines]


def _draw_bars(buffer: GeomBuffer, view: ImageView, bars: Array) -> None:
    rows = buffer.take(len(bars), int(mujoco.mjtGeom.mjGEOM_BOX))
    if not len(rows):
        return
    depth = _BAR_DEPTH * view.near
    rows["pos"] = view.at(bars[:, :2] + bars[:, 2:] / 2, depth)
    rows["mat"] = view.facing
    rows["size"][:, :2] = bars[:, 2:] * view.pixel_size(depth) / 2
    rows["size"][:, 2] = view.pixel_size(depth) / 10
    rows["rgba"] = BAR_RGBA
    rows["emission"] = 1.0


def _as_drawn(groups: list[Panels], rgba: Array, visible: Bools) -> list[Panels]:
    stops, each = np.cumsum([len(group.texts) for group in groups]), iter(visible.tolist())
    return [
        replace(
            group,
            rgba=rgba[stop - len(group.texts) : stop],
            texts=[[t if next(each) else b"" for t in lines] for lines in group.texts],
        )
        for group, stop in zip(groups, stops, strict=True)
    ]


def _covered(
    view: ImageView, starts: Array, lines: list[bytes], centres: Array, sizes: Array
) -> NDArray[np.bool_]:
    text = np.stack(
        [view.font.line_widths(lines), np.full(len(lines), float(view.font.height))], axis=1
    )
    apart = np.abs(starts[:, None] + text[:, None] / 2 - centres)
    is_under = np.all(apart < (text[:, None] + sizes) / 2, axis=2)
    return np.asarray(is_under.any(axis=1))


def draw_leaders(
    buffer: GeomBuffer,
    view: ImageView,
    starts: Array,
    bends: Array,
    ends: Array,
    rgba: tuple[float, ...],
) -> None:
    """Draws leaders as thin triangles. The first section of a bent leader has constant width."""
    base = max(_LEADER_BASE * view.font.height, 3.0)
    is_bent = (bends != starts).any(axis=1)
    _draw_tips(buffer, view, starts[~is_bent], ends[~is_bent], base, rgba)
    if is_bent.any():
        first, turn = starts[is_bent], bends[is_bent]
        _draw_tips(buffer, view, turn, ends[is_bent], _BENT * base, rgba)
        # The first section consists of two triangles, one from each of its ends.
        for one, other in ((first, turn), (turn, first)):
            _draw_tips(buffer, view, one, other, _BENT * base, rgba, at_corner=True)


def _draw_tips(
    buffer: GeomBuffer,
    view: ImageView,
    starts: Array,
    ends: Array,
    base: float,
    rgba: tuple[float, ...],
    *,
    at_corner: bool = False,
) -> None:
    rows = buffer.take(len(starts), int(mujoco.mjtGeom.mjGEOM_TRIANGLE))
    if not len(rows):
        return
    depth = _LEADER_DEPTH * view.near
    along = ends - starts
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-3)
    along /= length[:, None]
    across = along[:, ::-1] * (1.0, -1.0)
    # All three corners are projected, because lens distortion bends straight lines.
    first = starts - across * (base / 2)
    tip = ends - across * (base / 2) if at_corner else ends
    pixels = np.concatenate((first, first + across * base, tip))
    place_triangles(rows, *view.at(pixels, depth).reshape(3, -1, 3).swapaxes(1, 2))
    rows["rgba"] = rgba
    rows["emission"] = 1.0
