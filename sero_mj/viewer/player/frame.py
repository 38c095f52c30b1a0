"""`FrameTaker`: captures the frames of live pages and exported files for the player."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from ..decor.billboard_layout import BillboardGroup
from ..decor.feature import Frame
from ..decor.geom_buffer import GeomBuffer, Kind
from ..decor.joint_titles import frame_titles
from ..decor.legend import SCALE
from ..decor.panels import Panels
from ..decor.part_names import named_parts
from .copied_bodies import CopiedBodies
from .model import drawn_bodies
from .soft import SoftFrame, SoftParts

_LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
Labels = dict[
    tuple[str, int], tuple[str, Array]
]  # text and position, shape (3,), m, by kind and index of the item


class CapturedFrame(NamedTuple):
    """One state for the player, with B bodies, G copied bodies of doubles and N joints.

    Attributes:
        poses: positions in m and unit quaternions, shape (B + G, 7).
        opacity: opacity factor of each body, shape (B + G,); 0 for bodies out of sight.
        grey: mask of the bodies with stale data, shape (B + G,), bool.
        soft: tendons and flexes.
        values: mapping from names of quantities to joint values, shape (N,); NaN for no data.
        arrows: displayed values of the joints' arrows, shape (N,).
        limit: joint values at which arrows have full width, shape (N,); inf for no limit.
        stale: mask of the joints without recent data, shape (N,), bool.
        geoms: geoms of overlays as rows of `GEOM`, with the kind and item of each row. Text and
            the arrows that the player draws are omitted.
        labels: texts and positions of the labels.
        note: text in the corners of the image, without the legend.
        legend: text of the legend.
        arrow_texts: mapping from the indices of smart arrows to their texts.
    """

    poses: Array
    opacity: Array
    grey: Bools
    soft: SoftFrame
    values: dict[str, Array]
    arrows: Array
    limit: Array
    stale: Bools
    geoms: tuple[np.ndarray, np.ndarray, np.ndarray]
    labels: Labels
    note: str
    legend: str
    arrow_texts: dict[int, str]


class FrameTaker:
    """The last feature of a `Decor`, which captures the output of all other features.

    Args:
        own_arrows: mask of the joints whose arrow the player draws, shape (N,), bool.

    Attributes:
        corners: texts in the corners of the image, each as a flag and a list of lines. The flag is
            whether the text belongs to the legend.
        beside: text panels that are placed at a pixel, except names of frames and parts.
    """

    def __init__(self, world: WorldView, own_arrows: Bools) -> None:
        self._world, self._own_arrows = world, own_arrows
        self.bodies, self.copies = shown_bodies(world), CopiedBodies(world)
        self._soft = SoftParts(world.model)
        self.corners: list[tuple[bool, list[str]]] = []
        self.billboards: list[BillboardGroup] = []
        self.beside: list[Panels] = []
        self.frame: Frame | None = None

    def lay_out(self, frame: Frame) -> None:
        self.corners = [
            (group.of_arrows, [line_text(line) for line in lines])
            for group in frame.corners
            for lines in group.texts
        ]
        self.billboards = [*frame.billboards]
        # `labels_of` handles names.
        self.beside = [each for each in frame.panels if each.kind not in (Kind.NAME, Kind.PART)]
        for groups in (frame.corners, frame.billboards, frame.panels):
            groups.clear()

    def draw(self, frame: Frame) -> None:
        self.frame = frame

    def take(self, data: mujoco.MjData) -> CapturedFrame:
        """Returns the last drawn frame. `data` must contain the state that the frame shows."""
        world, frame = self._world, self.frame
        assert frame is not None
        buffer, model = frame.buffer, world.model
        poses, faint = body_poses(data, self.bodies, self.copies, frame)
        opacity = np.concatenate([_body_opacity(model, buffer)[self.bodies], faint])
        opacity[poses[:, 2] < OUT_OF_SIGHT[2] / 2] = 0.0
        grey = np.zeros(model.nbody, bool)
        if buffer.grey is not None:
            grey[model.geom_bodyid[buffer.grey]] = True
        note, legend = (
            "\n\n".join("\n".join(lines) for of_arrows, lines in self.corners if of_arrows == each)
            for each in (False, True)
        )
        return CapturedFrame(
            poses=poses,
            opacity=opacity,
            grey=np.concatenate([grey[self.bodies], np.zeros(len(faint), bool)]),
            soft=self._soft.take(data),
            values=frame.values,
            arrows=frame.arrow_values,
            limit=frame.arrow_limit,
            stale=frame.stale_joints,
            geoms=self._geoms(buffer),
            labels=labels_of(world, frame),
            note=note,
            legend=legend,
            arrow_texts={
                int(item): "\n".join(map(line_text, lines))
                for group in self.billboards
                if group.kind == Kind.CARD
                for item, lines in zip(group.items, group.texts, strict=True)
            },
        )

    def _geoms(self, buffer: GeomBuffer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        kinds, items = buffer.kinds[: buffer.count], buffer.items[: buffer.count]
        is_arrow = kinds == Kind.ARROW
        kept = ~is_arrow
        kept[is_arrow] = ~self._own_arrows[items[is_arrow]]
        # The player lays out panels itself.
        kept[buffer.text] = False
        kept &= buffer.rows["type"][: buffer.count] != _LABEL
        index = kept.nonzero()[0]
        return buffer.rows[index], kinds[index], items[index]


def body_poses(
    data: mujoco.MjData, bodies: Ints, copies: CopiedBodies, frame: Frame | None
) -> tuple[Array, Array]:
    """Returns the poses of bodies and copies, shape (B + G, 7), and the opacity of copies, (G,).

    Copies that `frame` does not draw have opacity 0.
    """
    drawn = [] if frame is None else frame.buffer.drawn_doubles
    places, turns, opacity = copies.poses(drawn)
    own = np.hstack([data.xpos[bodies], data.xquat[bodies]])
    return np.concatenate([own, np.hstack([places, turns])]), opacity


def _body_opacity(model: mujoco.MjModel, buffer: GeomBuffer) -> Array:
    found = np.ones(model.nbody)
    if buffer.opacity is not None:
        np.minimum.at(found, model.geom_bodyid, buffer.opacity)
    if buffer.hidden is not None:
        found[model.geom_bodyid[buffer.hidden]] = 0.0
    return found


def line_text(line: bytes) -> str:
    """Decodes a line of text. The bars of the legend's scale are replaced by words."""
    text = line.decode("latin-1").rstrip()
    scale = "".join(SCALE)
    return f"full width: {text.removeprefix(scale)}" if text.startswith(scale) else text


def shown_bodies(world: WorldView) -> Ints:
    """Returns the ids of the bodies with visible parts, joints or cameras, shape (B,)."""
    model = world.model
    own = [drawn_bodies(model), model.cam_bodyid]
    if world.has_sites:
        own.append(model.site_bodyid[world.joints.centre_site])
    return np.unique(np.concatenate(own)).astype(np.intp)


def labels_of(world: WorldView, frame: Frame) -> Labels:
    """Returns the labels of a frame: maps kind and index of an item to its text and position."""
    frames, buffer = world.frames, frame.buffer
    found: Labels = {}
    titles = frame_titles(tuple(frames.names))
    for i in frame.shown.frame_names.nonzero()[0].tolist():
        found["name", i] = titles[i], np.array(frame.data.site_xpos[frames.site[i]])
    parts, places = named_parts(world, frame.data, frame.toggles.part_names)
    found |= {("part", k): (parts[k], places[k]) for k in range(len(parts))}
    rows = buffer.rows[: buffer.count]
    has_text = rows["label"] != b""
    has_text[buffer.text] = False  # The player lays out the text of panels.
    for k, row in enumerate(rows[has_text]):
        found["geom", k] = row["label"].decode("latin-1"), np.array(row["pos"], float)
    return found
