"""Segmentation and depth on disk, by the conventions of those who train on pictures.

- Segmentation as .png: a picture with a palette, whose index is the part's number, as in PASCAL
  VOC; with more than 256 parts, 16 bits of grey. As .npy: int32. NAME.parts.json names the parts.
- Depth as .png: 16 bits of grey, mm, 0 where nothing is or it is farther than 65.535 m, as ROS
  (REP 118) and depth cameras have it. As .npy: float32, m, infinite for the sky.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ...base.errors import Problem, RenderError
from ...base.frames import Array, Ints
from .film import Pixels, check_writable, writing_to
from .film_kinds import PASS_ENDINGS

_MOST_COLOURS = 256  # of a palette
_MOST_MM = 65_535


def check_pass_file(path: Path) -> None:
    """Raises RenderError if the extension is not that of a segmentation or depth picture."""
    if path.suffix.lower() not in PASS_ENDINGS:
        expected = f"a name that ends in {', '.join(PASS_ENDINGS)}: others change numbers"
        raise RenderError(Problem(file=str(path), found=path.suffix, expected=expected))


def palette(count: int) -> Pixels:
    """Returns colours that tell numbers apart, (count, 3); black for 0.

    Source: `VOClabelcolormap` of the development kit of the PASCAL Visual Object Classes Challenge
    2012, which spreads the bits of a number over red, green and blue.
    """
    numbers = np.arange(count)
    colours = np.zeros((count, 3), np.uint8)
    for bit in range(8):
        for channel in range(3):
            of_number = (numbers >> (3 * bit + channel)) & 1
            colours[:, channel] |= (of_number << (7 - bit)).astype(np.uint8)
    return colours


def save_segmentation(path: Path, parts: Ints, names: Sequence[str]) -> Path:
    """Writes which part every pixel shows, and NAME.parts.json beside it.

    Args:
        path: .png or .npy.

    Returns:
        the file with the names: `parts`, each with `id`, `name`, `colour` (as in the picture, red,
        green, blue; null without a palette) and its count of `pixels`.

    Raises:
        RenderError: a file cannot be written, or has another extension.
    """
    check_pass_file(path)
    has_palette = path.suffix.lower() == ".png" and len(names) <= _MOST_COLOURS
    colours = palette(len(names))
    if path.suffix.lower() == ".npy":
        _save_array(path, parts.astype(np.int32))
    elif has_palette:
        picture = Image.fromarray(parts.astype(np.uint8))
        picture.putpalette(colours.tobytes())
        _save_png(path, picture, f"numbers of parts, named in {path.stem}.parts.json")
    else:
        picture = Image.fromarray(parts.astype(np.uint16))
        _save_png(path, picture, f"numbers of parts, named in {path.stem}.parts.json")
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
    """Writes how far away every pixel is.

    Args:
        path: .png or .npy.

    Raises:
        RenderError: the file cannot be written, or has another extension.
    """
    check_pass_file(path)
    if path.suffix.lower() == ".npy":
        _save_array(path, depth.astype(np.float32))
        return
    mm = np.round(1000.0 * np.where(np.isfinite(depth), depth, 0.0))
    found = np.where(mm <= _MOST_MM, mm, 0.0).astype(np.uint16)
    _save_png(path, Image.fromarray(found), "depth, mm; 0 for none")


def _save_array(path: Path, array: np.ndarray) -> None:
    check_writable(path)
    with writing_to(path):
        np.save(path, array, allow_pickle=False)


def _save_png(path: Path, picture: Image.Image, description: str) -> None:
    check_writable(path)
    about = PngInfo()
    about.add_text("Description", description)
    with writing_to(path):
        picture.save(path, pnginfo=about)
