"""Segmentation images, which show the part at each pixel, and depth images.

Arrows and billboards are not rendered. Without multisampling, each pixel belongs to one part.
A segmentation .png file is a palette image whose indices are part numbers, as in PASCAL VOC, or a
16-bit grayscale image if there are more than 256 parts. A .npy file contains int32 values. A depth
.png file is a 16-bit grayscale image in mm, with 0 for the sky and for depths above 65.535 m, as in
ROS (REP 118). A .npy file contains float32 values in m, with inf for the sky.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ...base.errors import Problem, RenderError
from ...base.frames import Array, Ints
from ...robots.assemble.world_view import WorldView
from ..decor.geom_buffer import GeomBuffer
from ..decor.scene_writer import SceneWriter
from .image_files import Pixels, check_writable, writing_to
from .image_options import PASS_ENDINGS
from .picking import picked_drawn, picked_geom

BACKGROUND, FLOOR = "background", "floor"
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_WIREFRAME = int(mujoco.mjtRndFlag.mjRND_WIREFRAME)
_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
# Mapping from types of surfaces that are not geoms to the field of `MjModel` with their number.
_SURFACES = {
    int(mujoco.mjtObj.mjOBJ_SKIN): "nskin",
    int(mujoco.mjtObj.mjOBJ_FLEX): "nflex",
    int(mujoco.mjtObj.mjOBJ_TENDON): "ntendon",
}
_AT_INFINITY = 1.0 - 1e-5  # depth from which a pixel is the sky, fraction of the far plane distance


class Parts:
    """The numbers and names of the parts in segmentation images of a world.

    Attributes:
        names: names of the parts, indexed by part number. Number 0 is `background` (the sky). Other
            parts are links, such as `lwr/link3`, links of doubles, objects, and `floor`. The
            numbers are the same in all images of a scene.
    """

    def __init__(self, world: WorldView) -> None:
        model = world.model
        self._numbers = {BACKGROUND: 0}
        self._of = {(_GEOM, i): self._number(_geom_name(world, i)) for i in range(model.ngeom)}
        for kind, count in _SURFACES.items():
            for i in range(getattr(model, count)):
                name = mujoco.mj_id2name(model, kind, i) or f"{count[1:]}{i}"
                self._of[kind, i] = self._number(name)
        self._of_double: dict[tuple[str, int], int] = {}
        for double in (name for name, part in world.doubles.items() if not part.is_compiled):
            for i in range(model.ngeom):
                if (picked := picked_drawn(world, double, i)) is not None:
                    self._of_double[double, i] = self._number(picked.own_name)
        self._floor = self._number(FLOOR)
        self.names = tuple(self._numbers)

    def _number(self, name: str) -> int:
        return self._numbers.setdefault(name, len(self._numbers))

    def of(self, geom: mujoco.MjvGeom, double: str | None = None) -> int | None:
        """Returns the number of the part that a geom of an `MjvScene` belongs to, or None."""
        if double is not None:
            return self._of_double.get((double, geom.objid))
        if geom.type == _PLANE and geom.objtype == _UNKNOWN:  # the floor of `AddedSurroundings`
            return self._floor
        return self._of.get((geom.objtype, geom.objid))


def _geom_name(world: WorldView, geom: int) -> str:
    model = world.model
    if name := picked_geom(world, geom).own_name:
        return name
    if model.geom_type[geom] == _PLANE:
        return FLOOR
    body: str = model.body(model.geom_bodyid[geom]).name
    return body or f"geom{geom}"


class PassRenderer:
    """A renderer of segmentation and depth images of a world."""

    def __init__(self, world: WorldView, renderer: mujoco.Renderer) -> None:
        self.parts = Parts(world)
        self.scene: mujoco.MjvScene = renderer.scene
        self._renderer: Any = renderer
        self._writer = SceneWriter(renderer.scene)
        self._far = float(world.model.vis.map.zfar * world.model.stat.extent)

    def segmentation(self, buffer: GeomBuffer) -> Ints:
        """Returns the number of the part at each pixel, shape (height, width), int32."""
        self._mark(buffer)
        self._renderer.enable_segmentation_rendering()
        shown = self._renderer.render()[..., 0]
        return np.asarray(np.maximum(shown, 0))  # -1 is the background

    def depth(self, buffer: GeomBuffer) -> Array:
        self._mark(buffer)
        self._renderer.enable_depth_rendering()
        depth: Array = self._renderer.render()
        depth[depth >= _AT_INFINITY * self._far] = np.inf
        return depth

    def close(self) -> None:
        self._renderer.close()

    def _mark(self, buffer: GeomBuffer) -> None:
        scene = self.scene
        scene.flags[_WIREFRAME] = False
        self._writer.mark(buffer)
        ends: list[tuple[int, str | None]] = [(scene.ngeom, None)]
        for drawn in buffer.drawn_doubles:
            self._writer.add_double(drawn)
            ends.append((scene.ngeom, drawn.double))
        start = 0
        for end, double in ends:
            for i in range(start, end):
                geom = scene.geoms[i]
                part = self.parts.of(geom, double)
                if part is None or geom.rgba[3] <= 0:
                    geom.segid = -1  # not drawn
                    continue
                geom.segid, geom.objid = i, part
                geom.rgba[3] = 1.0  # transparent geoms have no depth
            start = end


_MAX_COLOURS = 256  # maximum number of palette colors
_MAX_MM = 65_535


def check_pass_file(path: Path) -> None:
    """Raises RenderError if a file name extension is not for segmentation or depth images."""
    if path.suffix.lower() not in PASS_ENDINGS:
        expected = f"a lossless format, with a name that ends in {' or '.join(PASS_ENDINGS)}"
        raise RenderError(Problem(file=str(path), found=path.suffix, expected=expected))


def palette(count: int) -> Pixels:
    """Returns distinguishable colors for part numbers, shape (count, 3), with black for number 0.

    Source: `VOClabelcolormap` in the development kit of the PASCAL Visual Object Classes Challenge
    2012, which distributes the bits of a number over red, green and blue.
    """
    numbers = np.arange(count)
    colours = np.zeros((count, 3), np.uint8)
    for bit in range(8):
        for channel in range(3):
            of_number = (numbers >> (3 * bit + channel)) & 1
            colours[:, channel] |= (of_number << (7 - bit)).astype(np.uint8)
    return colours


def save_segmentation(path: Path, parts: Ints, names: Sequence[str]) -> Path:
    """Writes a segmentation image to a .png or .npy file, and NAME.parts.json to the same folder.

    Returns:
        path of the JSON file, which lists all `parts`. Each part has `id`, `name`, `colour` (red,
        green and blue; null without a palette) and `pixels` (the number of its pixels).

    Raises:
        RenderError: a file cannot be written, or the extension is neither .png nor .npy.
    """
    check_pass_file(path)
    has_palette = path.suffix.lower() == ".png" and len(names) <= _MAX_COLOURS
    colours = palette(len(names))
    if path.suffix.lower() == ".npy":
        _save_array(path, parts.astype(np.int32))
    else:
        image = Image.fromarray(parts.astype(np.uint8 if has_palette else np.uint16))
        if has_palette:
            image.putpalette(colours.tobytes())
        _save_png(path, image, f"part numbers, whose names are in {path.stem}.parts.json")
    counts = np.bincount(parts.ravel(), minlength=len(names)).tolist()
    legend: list[dict[str, Any]] = [
        {"id": i, "name": name, "colour": colours[i].tolist() if has_palette else None,
         "pixels": counts[i]}
        for i, name in enumerate(names)
    ]  # fmt: skip
    beside = path.with_suffix(".parts.json")
    check_writable(beside)
    with writing_to(beside):
        rows = ",\n  ".join(json.dumps(row) for row in legend)
        text = f'{{"picture": {json.dumps(path.name)}, "parts": [\n  {rows}\n]}}\n'
        beside.write_text(text, encoding="utf-8")
    return beside


def save_depth(path: Path, depth: Array) -> None:
    """Writes a depth image in m, with inf for the sky, to a .png or .npy file.

    Raises:
        RenderError: the file cannot be written, or the extension is neither .png nor .npy.
    """
    check_pass_file(path)
    if path.suffix.lower() == ".npy":
        _save_array(path, depth.astype(np.float32))
        return
    mm = np.round(1000.0 * np.where(np.isfinite(depth), depth, 0.0))
    found = np.where(mm <= _MAX_MM, mm, 0.0).astype(np.uint16)
    _save_png(path, Image.fromarray(found), "depth in mm; 0 for no depth")


def _save_array(path: Path, array: np.ndarray) -> None:
    check_writable(path)
    with writing_to(path):
        np.save(path, array, allow_pickle=False)


def _save_png(path: Path, image: Image.Image, description: str) -> None:
    check_writable(path)
    about = PngInfo()
    about.add_text("Description", description)
    with writing_to(path):
        image.save(path, pnginfo=about)
