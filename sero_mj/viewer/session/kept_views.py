"""Saved views: one file for every scene, in the user's state folder."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from platformdirs import user_state_path

from ...base.errors import UsageError
from ...robots.declared.scene import Scene
from .view_state import ViewState

log = logging.getLogger(__name__)

_MAX_BYTES = 1_000_000  # that are read, so no more are written


def file_of(scene: Scene) -> Path:
    """Returns the file of a scene's view: by its file or name, and its robots."""
    name = scene.name if scene.file is None else str(scene.file.resolve())
    name = "\n".join([name, *scene.robots, *scene.doubles])
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    stem = "".join(c if c.isalnum() else "_" for c in Path(scene.argument).stem)[:40]
    return state_folder() / "views" / f"{stem}-{digest}.json"


def state_folder() -> Path:
    """Returns the user's state folder."""
    return user_state_path("sero-mj", appauthor=False)


def write_state(path: Path, data: bytes) -> None:
    """Writes a file of that folder atomically; logs failures."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        log.info("not kept: %s: %s", path, error)


def keep_view(
    scene: Scene, state: ViewState, layout: Mapping[str, bool], tools: Mapping[str, Any]
) -> None:
    """Saves a view for the next start, without what tools keep if it is too long; logs failures."""
    view = state._replace(time=None).to_text()
    path, kept = file_of(scene), {"view": view, "layout": dict(layout), "tools": dict(tools)}
    if len(text := json.dumps(kept).encode()) > _MAX_BYTES:
        log.warning("%s: the state of tools is not saved: it is too long", path)
        text = json.dumps({**kept, "tools": {}}).encode()
    write_state(path, text)


def find_view(scene: Scene) -> tuple[ViewState, dict[str, bool], dict[str, Any]] | None:
    """Returns a saved view, the layout, and what tools have kept; None for none.

    Raises:
        UsageError: the file is damaged.
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
        raise UsageError(f"{path}: found no view ({error}); --fresh makes a new one") from None
