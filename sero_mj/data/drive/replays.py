"""Recordings in the place of a scene's sources."""

from __future__ import annotations

from contextlib import suppress

from ...base.errors import SeroError
from ...robots.declared.scene import Scene
from ..receive.source import Source
from .wiring import wired_source


def topics_of(scene: Scene) -> dict[str, Source]:
    """Returns what a scene's sources read of recorded messages, without wrongly declared ones."""
    found: dict[str, Source] = {}
    for name, declared in scene.sources.items():
        with suppress(SeroError):
            source = wired_source(scene, name, declared).of_messages
            if source is not None:
                found[name] = source
    return found
