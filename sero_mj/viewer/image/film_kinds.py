"""File name extensions of films and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class FilmKind:
    """Encoding of films with one file name extension.

    Attributes:
        codec: of FFmpeg.
        options: of the codec; chosen to be fast compared to rendering.
        has_palette: whether frames are limited to 256 colours.
        fps: default frames per second.
        most_fps: maximum frames per second that programs can show.
    """

    codec: str
    options: Mapping[str, str]
    has_palette: bool = False
    fps: float = 30.0
    most_fps: float = float("inf")


_VP9 = {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "5", "row-mt": "1"}
FILMS = {
    ".mp4": FilmKind("libx264", {"crf": "18", "preset": "veryfast"}),
    ".webm": FilmKind("libvpx-vp9", _VP9),
    ".gif": FilmKind("gif", {}, has_palette=True, fps=20.0, most_fps=50.0),
}
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
PASS_ENDINGS = (".png", ".npy")  # of segmentation and depth
