"""Recent views with their last pictures, in the user's state folder."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from ...base import paths
from ..image.film import Pixels
from .kept_views import state_folder, write_state

MOST = 8
PICTURE_SIZE = (480, 300)  # pixels


class RecentView(NamedTuple):
    """A recent view.

    Attributes:
        scene: a shipped name, or the absolute path of a file.
        replay: the absolute path of the recording played; empty for none.
    """

    scene: str
    replay: str = ""

    @property
    def picture(self) -> Path:
        digest = hashlib.sha256("\n".join(self).encode()).hexdigest()[:16]
        return state_folder() / "recent" / f"{digest}.jpg"

    @property
    def is_shipped(self) -> bool:
        return paths.shipped_file(self.scene) is not None

    @property
    def is_there(self) -> bool:
        files = [Path(name) for name in self if name]
        return all(file.exists() for file in (files[1:] if self.is_shipped else files))


def recent_views() -> list[RecentView]:
    """Returns recent views that still exist, latest first."""
    return [view for view in _read() if view.is_there]


def remember_view(view: RecentView, pixels: Pixels | None) -> None:
    """Saves a view as the latest."""
    before = [each for each in _read() if each != view]
    kept = [view, *before[: MOST - 1]]
    if pixels is not None:
        stream = io.BytesIO()
        cut_to(Image.fromarray(pixels), PICTURE_SIZE).save(stream, "JPEG", quality=88)
        write_state(view.picture, stream.getvalue())
    write_state(_file(), json.dumps([each._asdict() for each in kept]).encode())
    for each in before[MOST - 1 :]:
        each.picture.unlink(missing_ok=True)


def cut_to(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Returns the middle of a picture in another size, pixels."""
    scale = max(size[0] / image.width, size[1] / image.height)
    wide, high = size[0] / scale, size[1] / scale
    left, top = (image.width - wide) / 2, (image.height - high) / 2
    return image.resize(size, Image.Resampling.LANCZOS, (left, top, left + wide, top + high))


def _file() -> Path:
    return state_folder() / "recent.json"


def _read() -> list[RecentView]:
    try:
        found = json.loads(_file().read_bytes())
        views = [RecentView(str(each["scene"]), str(each["replay"])) for each in found]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [view for view in views if "\0" not in view.scene + view.replay][:MOST]
