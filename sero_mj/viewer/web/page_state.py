"""`PageState`: what a page draws of a frame, as sections of its state; the browser lays text out.

Poses, values and decor are those of windows. What windows place by pixels (cards, labels, notes)
goes to the page as text with the place in the world that it belongs to.
"""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from ..decor.cards import Cards
from ..decor.feature import Frame
from ..decor.geom_buffer import GeomBuffer, Kind
from ..decor.panels import Panels
from ..decor.picture_view import PictureView
from ..image.scene_decor import SceneDecor
from ..player.capture import (
    body_opacity,
    body_poses,
    capture_pose,
    line_text,
    player_geoms,
    shown_bodies,
)
from ..player.copied_bodies import CopiedBodies
from ..player.encode import METRE_STEP, ROTATION_STEP, arrow_looks, encode
from ..player.items import poses, quaternions_of
from ..player.labels import labels_of
from ..player.soft import SoftParts
from .sections import Sections

_KEYS = ["joint_angles"]  # values of joints that the page computes with
_WORDS = re.compile(r" {2,}")  # between the columns of a line
_TEXT_DIGITS = 4  # of places of text, m


class PageState:
    """Collects frames of a world's decor, as the last of its features, and puts them on a page.

    Args:
        world: the compiled scene.
        sections: of the page.

    Attributes:
        count: number of geoms of decor in the last frame.
    """

    def __init__(self, world: WorldView, sections: Sections) -> None:
        self._world, self._sections = world, sections
        self._bodies = shown_bodies(world)
        self._copies = CopiedBodies(world)
        self._soft = SoftParts(world.model)
        self._frame: Frame | None = None
        self._depth = 1.0  # of the robots in the picture, m
        self._cards: list[dict[str, Any]] = []
        self._notes: list[list[str]] = []
        self._beside: list[Panels] = []  # text that belongs to a place in the picture
        self.count = 0

    def begin(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, needed: float, title: str
    ) -> None:
        """Puts what does not change: shapes, joints, cameras.

        Args:
            data: the world's state, with frames up to date.
            camera: of the first picture.
            needed: width over height of a picture that it needs, see `needed_aspect`.
            title: of the page.
        """
        self._sections.put("valueKeys", _KEYS)
        self._sections.put("run", encode(capture_pose(self._world, data, camera, needed), title))

    # ---- a feature of decor, see `Drawn`

    def lay_out(self, frame: Frame) -> None:
        """Takes text that belongs beside the robots or into the corners."""
        _, depth = frame.view.project(frame.data.xpos[self._bodies])
        ahead = depth[depth > frame.view.near]
        self._depth = float(np.median(ahead)) if len(ahead) else 1.0
        self._cards = [card for group in frame.cards for card in self._cards_of(frame, group)]
        self._notes = [
            [line_text(line) for line in lines] for each in frame.corners for lines in each.texts
        ]
        # Names have places of their own, see `labels_of`.
        names = (Kind.NAME, Kind.PART)
        self._beside = [each for each in frame.panels if each.kind not in names]
        for groups in (frame.corners, frame.cards, frame.panels):
            groups.clear()

    def draw(self, frame: Frame) -> None:
        """Takes the frame, with all geoms."""
        self._frame = frame

    # ---- sections

    def put(self, data: mujoco.MjData, decor: SceneDecor) -> None:
        """Puts the frame that decor has drawn last.

        Args:
            data: the world's state, with frames up to date.
            decor: of the page.
        """
        frame, put = self._frame, self._sections.put
        if frame is None:  # decor was not drawn: there is no picture yet
            return
        put("time", round(float(frame.data.time), 4))
        put("values", np.array([frame.values[key] for key in _KEYS]))
        put("arrowValues", np.asarray(frame.arrow_values, np.float64))
        put("stale", frame.stale_joints.astype(np.uint8))
        put("arrowOn", frame.shown.arrows.astype(np.uint8))
        put("arrowLook", arrow_looks(self._world, frame.arrow_limit))
        put("cards", self._cards)
        put("notes", self._notes)
        hover = frame.toggles.hover
        if hover is not None:
            text, (x, y) = hover
            put("hover", {"text": text, "x": round(x, 1), "y": round(frame.view.height - y, 1)})
        else:
            put("hover", None)
        put("selected", -1 if frame.toggles.selected is None else int(frame.toggles.selected))
        self._put_bodies(data, frame.buffer)
        toggles = frame.toggles
        put("shading", {"transparent": toggles.transparent, "wireframe": toggles.wireframe})
        soft = self._soft.take(data)
        if len(soft.vertices):
            put("soft", soft.vertices.astype(np.float32))
        rows = np.concatenate([soft.tendons, decor.drawing.rows(data, toggles)])
        self._put_geoms(frame.buffer, rows)
        # What is left is said of stale data; the last one is the name beside the pointer.
        notes = decor.panels[: len(decor.panels) - (hover is not None)]
        self._put_labels(frame, [*self._beside, *notes])

    def _put_geoms(self, buffer: GeomBuffer, of_model: np.ndarray) -> None:
        rows, kinds, items = player_geoms(buffer, self._world.joints.revolute)
        what = np.zeros((len(rows) + len(of_model), 3), np.int32)
        what[: len(rows), 0], what[: len(rows), 1] = kinds, items
        rows = np.concatenate([rows, of_model])
        what[:, 2] = rows["type"]
        self.count = len(rows)
        rotations, sizes = poses(rows)
        parts = [
            np.array([len(rows)], np.uint32),
            what,
            rows["pos"].astype(np.float32),
            rotations.astype(np.float32),
            sizes.astype(np.float32),
            np.round(np.clip(rows["rgba"], 0, 1) * 255).astype(np.uint8),
        ]
        self._sections.put("items", b"".join(part.tobytes() for part in parts))

    def _put_labels(self, frame: Frame, beside: list[Panels]) -> None:
        found: list[tuple[str, Any, int, int]] = []
        for (what, item), (text, place) in labels_of(self._world, frame).items():
            found.append((text, place, Kind.NAME if what == "name" else Kind.NONE, item))
        for panels in beside:
            items = np.zeros(len(panels.texts), int) if panels.items is None else panels.items
            for lines, centre, item in zip(panels.texts, panels.centres, items, strict=True):
                text = "\n".join(line_text(line) for line in lines)
                found.append((text, self._in_world(frame.view, centre), panels.kind, int(item)))
        self._sections.put(
            "labels",
            [
                [text, *_rounded(place), int(kind), item]
                for text, place, kind, item in found
                if text
            ],
        )

    def _put_bodies(self, data: mujoco.MjData, buffer: GeomBuffer) -> None:
        """Puts poses and looks of all bodies."""
        put, bodies, model = self._sections.put, self._bodies, self._world.model
        # Rounded as files are: what trembles by less is not sent.
        places, turns, faint = body_poses(data, bodies, self._copies, buffer.drawn_doubles)
        places = np.round(places / METRE_STEP) * METRE_STEP
        turns = np.round(turns / ROTATION_STEP).astype(np.int16)
        put("poses", places.astype(np.float32).tobytes() + turns.tobytes())
        opacity = body_opacity(model, buffer)
        opacity[data.xpos[:, 2] < OUT_OF_SIGHT[2] / 2] = 0.0
        opacity = np.concatenate([opacity[bodies], faint])
        put("opacity", np.round(255 * opacity).astype(np.uint8))
        grey = np.concatenate([_bodies_of(model, buffer.grey)[bodies], np.zeros_like(faint)])
        put("grey", grey.astype(np.uint8))
        if not self._world.has_sites:
            put("sites", self._sites(data))

    def _in_world(self, view: PictureView, pixel: Array) -> Array:
        """A place in the world at a pixel, as far away as the robots."""
        return view.at(np.asarray(pixel, float), self._depth)

    def _sites(self, data: mujoco.MjData) -> bytes:
        """Poses of the centres of all joints, which are no sites of the model."""
        state, rows = self._world.state(data), self._world.joints.centre_site
        turns = quaternions_of(np.asarray(state.site_xmat[rows]))
        parts = [state.site_xpos[rows], turns]
        return b"".join(each.astype(np.float32).tobytes() for each in parts)

    def _cards_of(self, frame: Frame, cards: Cards) -> list[dict[str, Any]]:
        """What the page shows of cards: text, the place in the world, and how important it is."""
        joints, found = self._world.joints, []
        is_of_joint = cards.kind == Kind.BILLBOARD
        for k, item in enumerate(cards.items.tolist()):
            place = (
                frame.data.site_xpos[joints.centre_site[item]]
                if is_of_joint
                else self._in_world(frame.view, cards.anchors[k])
            )
            title, lines = card_lines(cards.texts[k])
            share = float(cards.share[k])
            value = float(frame.arrow_values[item]) if is_of_joint else 0.0
            found.append(
                {
                    "kind": int(cards.kind),
                    "item": item,
                    "at": _rounded(place),
                    "title": title,
                    "lines": lines,
                    "share": round(share, 3) if np.isfinite(share) and share >= 0 else None,
                    "always": bool(np.isposinf(share)),
                    "sign": _sign(value),
                    "stale": bool(is_of_joint and frame.stale_joints[item]),
                }
            )
        return found


def card_lines(texts: list[bytes]) -> tuple[str, list[list[str]]]:
    """Returns title, and label and value of every line, of a card's text.

    The first line begins with the title; columns are two spaces apart or more.
    """
    title, lines = "", []
    for number, text in enumerate(texts):
        words = _WORDS.split(line_text(text).strip())
        if number == 0 and max(len(words), len(texts)) > 1:
            title = words.pop(0)
        if words:
            lines.append([" ".join(words[:-1]), words[-1]])
    return title, lines


def _bodies_of(model: mujoco.MjModel, geoms: Bools | None) -> Bools:
    """Which bodies have one of these geoms, (nbody,)."""
    found = np.zeros(model.nbody, bool)
    if geoms is not None:
        found[model.geom_bodyid[geoms]] = True
    return found


def _rounded(place: Any) -> list[float]:
    numbers: list[float] = (np.round(np.asarray(place, float), _TEXT_DIGITS) + 0.0).tolist()
    return numbers


def _sign(value: float) -> str:
    return "positive" if value > 0 else "negative" if value < 0 else ""
