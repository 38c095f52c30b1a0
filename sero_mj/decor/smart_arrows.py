"""Smart arrows: Cartesian forces, torques and velocities, drawn where they act (section 2.4).

A straight arrow begins at its point and is as long as its scale says; a round one turns about its
direction by the right-hand rule and is as wide. The scale is stated in the legend. What is
larger than `longest` is drawn so long and dark, or so wide and striped.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world_view import WorldView
from .feature import Feature, Frame
from .pen import ARROW_SIZE_OF_LENGTH, GREY, Kind, Pen
from .quantities import IMPLAUSIBLE_FACTOR
from .ribbons import TURNING_SPEED, Ribbons, draw_ribbons
from .round_arrows import DARKER
from .vector_cards import VectorCards

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SHORTEST = 0.004  # m; what is shorter is not drawn, for its direction is noise
_SEGMENTS = 30
# Where directions are turned from: near no axis, for forces and torques often lie along one.
_FROM = np.array([0.36, 0.48, 0.80])
_START = np.array([[0.8, 0.48, 0.36], [-0.6, 0.64, 0.48], [0.0, -0.6, 0.80]])  # its z is _FROM
_HALF_TURN = 2.0 * np.outer(_START[:, 0], _START[:, 0]) - np.eye(3)
_HALF_WIDTH_OF_LENGTH = 0.045
_HALF_WIDTHS = (0.004, 0.012)  # m


class SmartArrows(Feature):
    """The smart arrows of one world, and the cards with their numbers."""

    order = 20

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._cards = VectorCards(world)

    def lay_out(self, frame: Frame) -> None:
        """Draws the arrows, and adds the cards of those that were clicked on."""
        if not frame.shown.vectors.any():
            return
        world, names = self.world, self.world.arrows.names
        components, vectors = arrow_vectors(world, frame.data)
        stale = frame.is_stale(names)
        draw_smart_arrows(frame.pen, world, frame.data, frame.shown.vectors, vectors, stale)
        ages = [frame.stale.get(name, "") for name in names]
        reach = drawn_sizes(world, vectors)
        cards = self._cards.cards(
            frame.data, frame.shown.cards, frame.view, components, reach, ages
        )
        if cards is not None:
            frame.cards.append(cards)


def arrow_vectors(world: WorldView, data: mujoco.MjData) -> tuple[Array, Array]:
    """What every smart arrow shows.

    Returns:
        components as received (K, 3), and the same in the world's directions (K, 3); NaN where
        there is no data, or a value `IMPLAUSIBLE_FACTOR` times what the longest arrow shows.
    """
    table = world.arrows
    components = data.userdata[table.slots]
    with np.errstate(invalid="ignore"):  # as with joints: a fault of its source, no measurement
        believable = (
            np.abs(components) <= IMPLAUSIBLE_FACTOR * (table.longest / table.scale)[:, None]
        )
    known = (data.userdata[table.has] > 0) & believable.all(axis=1)
    components[~known] = np.nan
    rotation = data.site_xmat[table.components_site].reshape(-1, 3, 3).copy()
    rotation[table.components_site < 0] = np.eye(3)
    return components, np.einsum("kij,kj->ki", rotation, components)


def draw_smart_arrows(
    pen: Pen, world: WorldView, data: mujoco.MjData, shown: Bools, vectors: Array, stale: Bools
) -> None:
    """Draws every smart arrow that is shown, has data and is long enough to have a direction.

    Args:
        pen: where to.
        world: the compiled scene.
        data: its state.
        shown: which ones to draw, (K,).
        vectors: in the world's directions, (K, 3), NaN for no data.
        stale: which ones have no fresh data and are grey, (K,).
    """
    table = world.arrows
    magnitude = np.linalg.norm(vectors, axis=1)
    size = table.scale * magnitude
    with np.errstate(invalid="ignore"):
        index = (shown & (size > SHORTEST) & np.isfinite(size)).nonzero()[0]
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
        ribbons = Ribbons(
            items=turning,
            centre=data.site_xpos[table.site[turning]],
            axes=axes[~straight],
            phase=np.full(len(turning), TURNING_SPEED * data.time),
            sign=np.ones(len(turning)),
            radius=table.radius[turning],
            width=size[turning],
            rgba=rgba[turning],
            striped=over[turning],
        )
        draw_ribbons(pen, Kind.VECTOR, ribbons, _SEGMENTS)
    index, axes = index[straight], axes[straight]
    rows = pen.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW), Kind.VECTOR, index)
    if not len(rows):
        return
    length = size[index]
    rgba[over, :3] *= DARKER
    rows["pos"] = data.site_xpos[table.site[index]]
    rows["mat"] = axes
    rows["size"][:, :2] = np.clip(_HALF_WIDTH_OF_LENGTH * length, *_HALF_WIDTHS)[:, None]
    rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length
    rows["rgba"] = rgba[index]


def drawn_sizes(world: WorldView, vectors: Array) -> Array:
    """How far every smart arrow reaches from its point (K,), m; 0 where there is no data."""
    table = world.arrows
    magnitude = np.nan_to_num(np.linalg.norm(vectors, axis=1))
    length = np.minimum(table.scale * magnitude, table.longest)
    return np.asarray(np.where(table.is_round, table.radius + length / 2, length))


def frames_along(directions: Array) -> Array:
    """Rotations (k, 3, 3) whose z are unit vectors (k, 3).

    They are continuous but at the opposite of `_FROM`, so that noise does not make an arrow jump.
    """
    along = directions @ _FROM
    axis = np.cross(_FROM, directions)
    skew = np.zeros((len(directions), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]] = axis
    skew[:, [1, 2, 0], [2, 0, 1]] = -axis
    # The smallest rotation that takes one onto the other (Rodrigues).
    opposite = along < -1.0 + 1e-9
    rotation = np.eye(3) + skew + skew @ skew / np.where(opposite, 1.0, 1.0 + along)[:, None, None]
    rotation[opposite] = _HALF_TURN
    return np.asarray(rotation @ _START)
