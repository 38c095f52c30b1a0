"""Stores the list of recent views, their preview images, and the saved view of each scene."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from platformdirs import user_state_path

from ...base import paths
from ...base.errors import UsageError
from ...robots.declared.scene import Scene
from ..image.image_files import Pixels
from .view_state import ViewState

MAX_VIEWS = 8
IMAGE_SIZE = (480, 300)  # pixels


class RecentView(NamedTuple):
    """A scene or recording that the user has opened.

    Attributes:
        scene: name of an included scene, or absolute path of a file.
        replay: absolute path of the played recording, or an empty string.
    """

    scene: str
    replay: str = ""

    @property
    def image(self) -> Path:
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
    """Returns the recent views whose files still exist, with the latest one first."""
    return [view for view in _read() if view.is_there]


def remember_view(view: RecentView, pixels: Pixels | None) -> None:
    """Saves a view as the most recent one, with a preview image if `pixels` is not None."""
    before = [each for each in _read() if each != view]
    views = [view, *before[: MAX_VIEWS - 1]]
    if pixels is not None:
        stream = io.BytesIO()
        cut_to(Image.fromarray(pixels), IMAGE_SIZE).save(stream, "JPEG", quality=88)
        write_state(view.image, stream.getvalue())
    write_state(_file(), json.dumps([each._asdict() for each in views]).encode())
    for each in before[MAX_VIEWS - 1 :]:
        each.image.unlink(missing_ok=True)


def cut_to(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Scales an image to a size in pixels, and crops its sides if the aspect ratio differs."""
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
    return [view for view in views if "\0" not in view.scene + view.replay][:MAX_VIEWS]


log = logging.getLogger(__name__)

_MAX_BYTES = 1_000_000  # maximum size of a saved view


def file_of(scene: Scene) -> Path:
    """Returns the path of a scene's saved view, which depends on its file or name and robots."""
    name = scene.name if scene.file is None else str(scene.file.resolve())
    name = "\n".join([name, *scene.robots, *scene.doubles])
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    stem = "".join(c if c.isalnum() else "_" for c in Path(scene.argument).stem)[:40]
    return state_folder() / "views" / f"{stem}-{digest}.json"


def state_folder() -> Path:
    """Returns the directory for recent and saved views of the user."""
    return user_state_path("sero-mj", appauthor=False)


def write_state(path: Path, data: bytes) -> None:
    """Writes a file in the state directory atomically, and logs a failure."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        log.info("cannot save %s: %s", path, error)


def save_view(
    scene: Scene, state: ViewState, layout: Mapping[str, bool], tools: Mapping[str, Any]
) -> None:
    """Saves a view for the next start of the scene, and logs a failure.

    If the file would be too long, the states of tools are omitted.
    """
    view = state._replace(time=None).to_text()
    path, saved = file_of(scene), {"view": view, "layout": dict(layout), "tools": dict(tools)}
    if len(text := json.dumps(saved).encode()) > _MAX_BYTES:
        log.warning("%s: the states of tools are not saved, because they are too long", path)
        text = json.dumps({**saved, "tools": {}}).encode()
    write_state(path, text)


def load_view(scene: Scene) -> tuple[ViewState, dict[str, bool], dict[str, Any]] | None:
    """Returns a scene's saved view, layout and states of tools, or None if there is none.

    Raises:
        UsageError: the file has invalid contents.
    """
    path = file_of(scene)
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES)
    except OSError:
        return None
    try:
        found = json.loads(text)
        layout = {str(name): bool(on) for name, on in found["layout"].items()}
        return ViewState.from_text(found["view"]), layout, dict(found.get("tools", {}))
    except (ValueError, KeyError, TypeError, AttributeError, UsageError) as error:
        raise UsageError(
            f"{path}: not a valid view ({error}); use --fresh to ignore the file"
        ) from None
