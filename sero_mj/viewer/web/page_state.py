"""`PageState`: writes the displayed state of each frame to the `Sections` of a page.

Pages show the same poses, values and overlays as windows. Text that windows place in pixels
(billboards, labels, notes) is sent with a position in the world, and the browser lays it out.
"""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..decor.billboard_layout import BillboardGroup
from ..decor.feature import Frame
from ..decor.geom_buffer import Kind
from ..decor.image_view import ImageView
from ..decor.panels import Panels
from ..image.scene_decor import SceneDecor
from ..player.capture import capture_pose
from ..player.encode import METRE_STEP, ROTATION_STEP, arrow_looks, encode
from ..player.frame import FrameTaker, line_text
from ..player.packing import poses, quaternions_of, types_of
from .sections import Sections

_KEYS = ["joint_angles"]  # names of the joint values that pages need
_COLUMNS = re.compile(r" {2,}")  # separator between the columns of a line
_TEXT_DIGITS = 4  # number of decimals of text positions in m


class PageState(FrameTaker):
    """Writes each displayed frame to the `Sections` of a page.

    Attributes:
        count: number of geoms of overlays in the last frame.
    """

    def __init__(self, world: WorldView, sections: Sections) -> None:
        super().__init__(world, world.joints.revolute)
        self._world, self._sections = world, sections
        self._depth = 1.0  # median depth of the robots, m
        self._shown_billboards: list[dict[str, Any]] = []
        self.count = 0

    def begin(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, needed: float, title: str
    ) -> None:
        """Writes the constant sections: shapes, joints and cameras."""
        self._sections.put("valueKeys", _KEYS)
        self._sections.put("run", encode(capture_pose(self._world, data, camera, needed), title))

    def lay_out(self, frame: Frame) -> None:
        super().lay_out(frame)
        _, depth = frame.view.project(frame.data.xpos[self.bodies])
        visible = depth[depth > frame.view.near]
        self._depth = float(np.median(visible)) if len(visible) else 1.0
        self._shown_billboards = [
            each for group in self.billboards for each in self._billboards_of(frame, group)
        ]

    def put(self, data: mujoco.MjData, decor: SceneDecor) -> None:
        """Writes the last drawn frame, which must show the state in `data`."""
        frame, put = self.frame, self._sections.put
        if frame is None:  # No frame has been drawn yet.
            return
        found, toggles = self.take(data), frame.toggles
        put("time", round(float(frame.data.time), 4))
        put("values", np.array([found.values[key] for key in _KEYS]))
        put("arrowValues", np.asarray(found.arrows, np.float64))
        put("stale", found.stale.astype(np.uint8))
        put("arrowOn", frame.shown.arrows.astype(np.uint8))
        put("arrowLook", arrow_looks(self._world, found.limit))
        put("cards", self._shown_billboards)
        put("notes", [lines for _, lines in self.corners])
        hover = toggles.hover
        if hover is not None:
            text, (x, y) = hover
            put("hover", {"text": text, "x": round(x, 1), "y": round(frame.view.height - y, 1)})
        else:
            put("hover", None)
        put("selected", -1 if toggles.selected is None else int(toggles.selected))
        # Poses are rounded as in files, so that tiny changes are not sent.
        places = np.round(found.poses[:, :3] / METRE_STEP) * METRE_STEP
        turns = np.round(found.poses[:, 3:] / ROTATION_STEP).astype(np.int16)
        put("poses", places.astype(np.float32).tobytes() + turns.tobytes())
        put("opacity", np.round(255 * found.opacity).astype(np.uint8))
        put("grey", found.grey.astype(np.uint8))
        if not self._world.has_sites:
            put("sites", self._sites(data))
        put("shading", {"transparent": toggles.transparent, "wireframe": toggles.wireframe})
        if len(found.soft.vertices):
            put("soft", found.soft.vertices.astype(np.float32))
        rows = np.concatenate([found.soft.tendons, decor.drawing.rows(data, toggles)])
        self._put_geoms(*found.geoms, rows)
        # The remaining panels are notes about stale data. The last one is the name at the pointer.
        notes = decor.panels[: len(decor.panels) - (hover is not None)]
        self._put_labels(frame.view, found.labels, [*self.beside, *notes])

    def _put_geoms(
        self, rows: np.ndarray, kinds: np.ndarray, items: np.ndarray, of_model: np.ndarray
    ) -> None:
        what = np.zeros((len(rows) + len(of_model), 3), np.int32)
        what[: len(rows), 0], what[: len(rows), 1] = kinds, items
        rows = np.concatenate([rows, of_model])
        what[:, 2] = types_of(rows)
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

    def _put_labels(self, view: ImageView, labels: dict[Any, Any], beside: list[Panels]) -> None:
        found: list[tuple[str, Any, int, int]] = []
        for (what, item), (text, place) in labels.items():
            found.append((text, place, Kind.NAME if what == "name" else Kind.NONE, item))
        for panels in beside:
            items = np.zeros(len(panels.texts), int) if panels.items is None else panels.items
            for lines, centre, item in zip(panels.texts, panels.centres, items, strict=True):
                text = "\n".join(line_text(line) for line in lines)
                found.append((text, self._in_world(view, centre), panels.kind, int(item)))
        self._sections.put(
            "labels",
            [
                [text, *_rounded(place), int(kind), item]
                for text, place, kind, item in found
                if text
            ],
        )

    def _in_world(self, view: ImageView, pixel: Array) -> Array:
        """Returns the world position of a pixel at the depth of the robots."""
        return view.at(np.asarray(pixel, float), self._depth)

    def _sites(self, data: mujoco.MjData) -> bytes:
        state, rows = self._world.state(data), self._world.joints.centre_site
        turns = quaternions_of(np.asarray(state.site_xmat[rows]))
        parts = [state.site_xpos[rows], turns]
        return b"".join(each.astype(np.float32).tobytes() for each in parts)

    def _billboards_of(self, frame: Frame, group: BillboardGroup) -> list[dict[str, Any]]:
        joints, found = self._world.joints, []
        is_of_joint = group.kind == Kind.BILLBOARD
        for k, item in enumerate(group.items.tolist()):
            place = (
                frame.data.site_xpos[joints.centre_site[item]]
                if is_of_joint
                else self._in_world(frame.view, group.anchors[k])
            )
            title, lines = billboard_lines(group.texts[k])
            share = float(group.share[k])
            value = float(frame.arrow_values[item]) if is_of_joint else 0.0
            found.append(
                {
                    "kind": int(group.kind),
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


def billboard_lines(texts: list[bytes]) -> tuple[str, list[list[str]]]:
    """Splits the text of a billboard into its title, and the label and value of each line.

    Two or more spaces separate columns. The first column is the title.
    """
    title, lines = "", []
    for number, text in enumerate(texts):
        words = _COLUMNS.split(line_text(text).strip())
        if number == 0 and max(len(words), len(texts)) > 1:
            title = words.pop(0)
        if words:
            lines.append([" ".join(words[:-1]), words[-1]])
    return title, lines


def _rounded(place: Any) -> list[float]:
    numbers: list[float] = (np.round(np.asarray(place, float), _TEXT_DIGITS) + 0.0).tolist()
    return numbers


def _sign(value: float) -> str:
    return "positive" if value > 0 else "negative" if value < 0 else ""
