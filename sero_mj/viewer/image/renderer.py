"""`Renderer`: base class of renderers that extensions add to the classic renderer of MuJoCo.

A package adds a renderer with an entry point in the group `sero_mj.renderers`. Users select it by
the name of the entry point (`--renderer`).
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from functools import cache
from typing import ClassVar, Protocol

import mujoco

from ...base.errors import Problem, RenderError
from ...base.plugins import RENDERERS, load_all
from ...robots.assemble.world_view import WorldView
from .added_surroundings import AddedSurroundings
from .image_files import Pixels
from .image_options import Quality

log = logging.getLogger(__name__)

CLASSIC = "classic"


class SceneRenderer(Protocol):
    """A renderer that draws an `MjvScene` into arrays.

    Attributes:
        scene: scene that the caller fills with `mujoco.mjv_updateScene` before each frame.
        first_shape: `dataid` of the first mesh of `arrow_shapes` in scenes; None if the renderer
            does not have these meshes.
    """

    scene: mujoco.MjvScene
    first_shape: int | None

    def follow(self, data: mujoco.MjData) -> None:
        """Called before each frame with its state, from which skins and flexes are drawn."""

    def render(self, out: Pixels | None = None) -> Pixels: ...

    def close(self) -> None: ...


class Renderer(ABC):
    """A kind of renderer that an extension adds. One instance is created without arguments.

    Attributes:
        title: name of the renderer in messages.
        is_for_fine: whether this renderer is the default for images of quality `fine`.
        packages: names of the Debian and Ubuntu packages that this renderer needs.
    """

    title: ClassVar[str]
    is_for_fine: ClassVar[bool] = False
    packages: ClassVar[str] = ""

    @abstractmethod
    def problem(self, width: int, height: int) -> str | None:
        """Returns why this machine cannot render images of this size, or None if it can."""

    @abstractmethod
    def make(
        self, world: WorldView, width: int, height: int, quality: Quality, *, frames: int = 1
    ) -> tuple[SceneRenderer, AddedSurroundings | None]:
        """Returns a renderer, and a floor and lights to add to each frame if the world has none."""


@cache
def renderers() -> dict[str, Renderer]:
    """Returns the renderers of all extensions as a mapping from their names."""
    return {name: kind() for name, kind in load_all(RENDERERS, Renderer).items()}


def choose_renderer(wanted: str | None, quality: Quality, width: int, height: int) -> str:
    """Returns the name of the renderer for an image.

    Args:
        wanted: requested name (default: a renderer for the quality). If this renderer is not
            available, a warning is logged, and the classic renderer is used.

    Raises:
        RenderError: no renderer has the requested name.
    """
    if wanted == CLASSIC or (wanted is None and quality != "fine"):
        return CLASSIC  # this avoids the import of extensions
    known = renderers()
    if wanted is None:
        wanted = next((name for name, each in known.items() if each.is_for_fine), CLASSIC)
    if wanted == CLASSIC:
        return CLASSIC
    if wanted not in known:
        raise RenderError(Problem("renderer", found=wanted, expected=", ".join([CLASSIC, *known])))
    problem = known[wanted].problem(width, height)
    if problem is None:
        return wanted
    _warn(wanted, problem)
    return CLASSIC


@cache  # once per process
def _warn(name: str, problem: str) -> None:
    kind = renderers()[name]
    remedy = f"; Debian, Ubuntu: apt install {kind.packages}" if kind.packages else ""
    log.warning("%s is not available, so the classic renderer is used: %s%s",
                kind.title, problem, remedy)  # fmt: skip
