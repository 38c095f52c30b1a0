"""Smart arrows: Cartesian forces, torques and velocities at their point of action.

A straight arrow shows the magnitude by its length. A round arrow shows it by its width, and rotates
about the vector by the right-hand rule. The legend states the scale. Arrows longer or wider than
`longest` are drawn with this size. Such straight arrows are dark, and such round arrows are
striped. Source: section 2.4 of the paper.
"""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...robots.assemble.world_view import WorldView
from .arrow_shapes import draw_round, draw_straight
from .billboard_layout import BillboardGroup, heights_in_order
from .billboards import NO_DATA
from .feature import Feature, Frame
from .font import line_of
from .geom_buffer import GREY, Kind
from .image_view import ImageView
from .panels import panel_sizes
from .quantities import IMPLAUSIBLE_FACTOR
from .round_arrows import TURNING_SPEED

SHORTEST = 0.004  # m; shorter arrows are not drawn, because their direction is noise
# Reference direction of `frames_along`. It is not close to any axis, along which many forces act.
_FROM = np.array([0.36, 0.48, 0.80])
# Rotation whose z axis is `_FROM`.
_START = np.array([[0.8, 0.48, 0.36], [-0.6, 0.64, 0.48], [0.0, -0.6, 0.80]])
_HALF_TURN = 2.0 * np.outer(_START[:, 0], _START[:, 0]) - np.eye(3)
_WIDTH_OF_LENGTH = 0.09
_WIDTHS = (0.008, 0.024)  # m
_CLOSE = 0.02  # m; hysteresis for arrows that would end inside a link and thus end at their point
_MAX_GROUP = 2  # highest visible group of geoms


class SmartArrows(Feature):
    """The visual feature that draws the smart arrows of a world and panels with their values."""

    order = 20

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._billboards = _VectorBillboards(world)
        self._links = _Links(world)
        self._ends_there = np.zeros(len(world.arrows.names), bool)

    def lay_out(self, frame: Frame) -> None:
        if not frame.shown.vectors.any():
            return
        world, names = self.world, self.world.arrows.names
        components, vectors = arrow_vectors(world, frame.data)
        stale = frame.is_stale(names)
        self._choose_ends(frame.data, vectors)
        draw_smart_arrows(frame, world, vectors, stale, self._ends_there)
        ages = [frame.stale.get(name, "") for name in names]
        reach = drawn_sizes(world, vectors)
        group = self._billboards.lay_out(
            frame.data, frame.shown.cards, frame.view, components, reach, ages
        )
        if group is not None:
            frame.billboards.append(group)

    def _choose_ends(self, data: mujoco.MjData, vectors: Array) -> None:
        table = self.world.arrows
        straight = (~table.is_round & np.isfinite(vectors).all(axis=1)).nonzero()[0]
        sizes = np.linalg.norm(vectors[straight], axis=1)
        length = np.minimum(table.scale[straight] * sizes, table.longest[straight])
        steps = vectors[straight] * (length / np.maximum(sizes, 1e-12))[:, None]
        points = data.site_xpos[table.site[straight]]
        inside, near = self._links.contain(data, points + steps)
        inside &= ~self._links.contain(data, points - steps)[0]
        self._ends_there[straight] = inside | (self._ends_there[straight] & near)


class _Links:
    def __init__(self, world: WorldView) -> None:
        model = world.model
        bodies = [body for part in world.robots.values() for body in part.bodies]
        is_link = np.isin(model.geom_bodyid, bodies) & (model.geom_rgba[:, 3] > 0)
        geoms = (is_link & (model.geom_group <= _MAX_GROUP)).nonzero()[0]
        self._bodies = model.geom_bodyid[geoms]
        self._rotation = np.empty((len(geoms), 3, 3))
        for geom, rotation in zip(geoms, self._rotation, strict=True):
            mujoco.mju_quat2Mat(rotation.reshape(9), model.geom_quat[geom])
        middles, self._half = np.hsplit(model.geom_aabb[geoms], 2)
        self._middles = model.geom_pos[geoms] + np.einsum("gij,gj->gi", self._rotation, middles)

    def contain(self, data: mujoco.MjData, points: Array) -> tuple[Bools, Bools]:
        turns = data.xmat[self._bodies].reshape(-1, 3, 3)
        middles = data.xpos[self._bodies] + np.einsum("gij,gj->gi", turns, self._middles)
        away = np.einsum("gij,kgi->kgj", turns @ self._rotation, points[:, None] - middles)
        inside, near = (
            (np.abs(away) < self._half + more).all(axis=2).any(axis=1) for more in (0.0, _CLOSE)
        )
        return inside, near


def arrow_vectors(world: WorldView, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns the vectors that smart arrows show, as received and in world coordinates.

    Returns:
        two arrays of components, shape (K, 3) each, in SI units. Components are NaN for no data and
        for values above `IMPLAUSIBLE_FACTOR` times the value of the longest arrow.
    """
    table = world.arrows
    components = data.userdata[table.slots]
    with np.errstate(invalid="ignore"):  # treated as errors of the source, as with joint torques
        believable = (
            np.abs(components) <= IMPLAUSIBLE_FACTOR * (table.longest / table.scale)[:, None]
        )
    known = (data.userdata[table.has] > 0) & believable.all(axis=1)
    components[~known] = np.nan
    rotation = data.site_xmat[table.components_site].reshape(-1, 3, 3).copy()
    rotation[table.components_site < 0] = np.eye(3)
    return components, np.einsum("kij,kj->ki", rotation, components)


def draw_smart_arrows(
    frame: Frame, world: WorldView, vectors: Array, stale: Bools, ends_there: Bools
) -> None:
    """Draws all smart arrows that are switched on, have data and are longer than `SHORTEST`.

    Args:
        vectors: vectors in world coordinates, shape (K, 3), in SI units, NaN for no data.
        stale: mask of the arrows without fresh data, which are drawn in gray, shape (K,).
        ends_there: mask of the straight arrows that end at their point of action instead of
            starting there, shape (K,).
    """
    table, buffer, data = world.arrows, frame.buffer, frame.data
    magnitude = np.linalg.norm(vectors, axis=1)
    size = table.scale * magnitude
    with np.errstate(invalid="ignore"):
        index = (frame.shown.vectors & (size > SHORTEST) & np.isfinite(size)).nonzero()[0]
        over = size > table.longest
    if not len(index):
        return
    rgba = table.rgba.copy()
    rgba[stale, :3] = GREY
    size = np.minimum(size, table.longest)
    axes = frames_along(vectors[index] / magnitude[index][:, None])
    straight = ~table.is_round[index]
    turning = index[~straight]
    if len(turning):
        draw_round(
            buffer, Kind.VECTOR, turning,
            centre=data.site_xpos[table.site[turning]],
            axes=axes[~straight],
            phase=np.full(len(turning), TURNING_SPEED * data.time),
            sign=np.ones(len(turning)),
            radius=table.radius[turning],
            width=size[turning],
            rgba=rgba[turning],
            striped=over[turning],
        )  # fmt: skip
    index, axes = index[straight], axes[straight]
    length = size[index]
    back = np.where(ends_there[index], length, 0.0)
    draw_straight(
        buffer, Kind.VECTOR, index,
        start=data.site_xpos[table.site[index]] - back[:, None] * axes[:, :, 2],
        axes=axes,
        length=length,
        width=np.clip(_WIDTH_OF_LENGTH * length, *_WIDTHS),
        rgba=rgba[index],
        over=over[index],
    )  # fmt: skip


def drawn_sizes(world: WorldView, vectors: Array) -> Array:
    """Returns how far each smart arrow extends from its point of action, shape (K,), m."""
    table = world.arrows
    magnitude = np.nan_to_num(np.linalg.norm(vectors, axis=1))
    length = np.minimum(table.scale * magnitude, table.longest)
    return np.asarray(np.where(table.is_round, table.radius + length / 2, length))


def frames_along(directions: Array) -> Array:
    """Returns rotations, shape (k, 3, 3), whose z axes have the directions of k unit vectors.

    The rotations are continuous except at -`_FROM`, so that noise does not make an arrow jump.
    """
    along = directions @ _FROM
    axis = np.cross(_FROM, directions)
    skew = np.zeros((len(directions), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]] = axis
    skew[:, [1, 2, 0], [2, 0, 1]] = -axis
    # This is the smallest rotation from `_FROM` to the direction (Rodrigues).
    opposite = along < -1.0 + 1e-9
    rotation = np.eye(3) + skew + skew @ skew / np.where(opposite, 1.0, 1.0 + along)[:, None, None]
    rotation[opposite] = _HALF_TURN
    return np.asarray(rotation @ _START)


class _VectorBillboards:
    def __init__(self, world: WorldView) -> None:
        self._world = world
        heights = world.state(world.make_data()).site_xpos[world.arrows.site, 2]
        self._rank = heights_in_order(heights)

    def lay_out(
        self,
        data: mujoco.MjData,
        shown: Bools,
        view: ImageView,
        components: Array,
        reach: Array,
        stale: list[str],
    ) -> BillboardGroup | None:
        index = shown.nonzero()[0]
        if not len(index):
            return None
        anchors, depth = view.project(data.site_xpos[self._world.arrows.site[index]])
        inside = view.sees(anchors, depth)
        index, anchors, depth = index[inside], anchors[inside], depth[inside]
        if not len(index):
            return None
        texts = [self._text(int(i), components[i], stale[i]) for i in index]
        widest = np.array([view.font.block_width(lines) for lines in texts])
        return BillboardGroup(
            kind=Kind.CARD,
            items=index,
            anchors=anchors,
            sizes=panel_sizes(widest, np.array([len(lines) for lines in texts]), view),
            texts=texts,
            owners=np.full(len(index), -1),
            side=(index + 1) % 2,
            rank=self._rank[index],
            share=np.full(len(index), np.inf),
            clear=float((reach[index] / view.pixel_size(1.0) / depth).max()),
        )

    def _text(self, i: int, components: Array, stale: str) -> list[bytes]:
        name = self._world.arrows.names[i]
        arrow = self._world.scene.arrows[name]
        lines = [f"{name}: {arrow.kind.replace('_', ' ')}"]
        if np.isfinite(components).all():
            width, decimals = arrow.decimals + 5, arrow.decimals
            numbers = {"x": components[0], "y": components[1], "z": components[2]}
            numbers["size"] = np.linalg.norm(components)
            lines += [
                f"  {label:4} {round(float(value), decimals) + 0.0:{width}.{decimals}f} "
                f"{arrow.unit_text}"
                for label, value in numbers.items()
            ]
        else:
            lines.append("  " + NO_DATA.decode())
        lines.append(f"  in {arrow.components_in}")
        if stale:
            lines.append(f"  {stale}")
        return [line_of(line) for line in lines]
