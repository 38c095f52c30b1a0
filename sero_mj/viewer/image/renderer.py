"""`Renderer`: renderers other than MuJoCo's classic renderer, and their selection.

A package adds a renderer with an entry point in the group `sero_mj.renderers`. Its name is the
value of `--renderer`.
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
    """Renders a scene of MuJoCo into arrays.

    Attributes:
        scene: to be filled by `mujoco.mjv_updateScene` before rendering.
    """

    scene: mujoco.MjvScene

    def follow(self, data: mujoco.MjData) -> None:
        """Takes the shapes of skins and flexes from a state, which the geoms of a scene lack."""

    def render(self, out: Pixels | None = None) -> Pixels: ...

    def close(self) -> None: ...


class Renderer(ABC):
    """A kind of renderer, created without arguments.

    Attributes:
        is_for_fine: whether it is the default for images of quality `fine`.
        packages: packages that it needs on Debian and Ubuntu.
    """

    title: ClassVar[str]
    is_for_fine: ClassVar[bool] = False
    packages: ClassVar[str] = ""

    @abstractmethod
    def problem(self, width: int, height: int) -> str | None: ...

    @abstractmethod
    def make(
        self, world: WorldView, width: int, height: int, quality: Quality, *, frames: int = 1
    ) -> tuple[SceneRenderer, AddedSurroundings | None]:
        """Returns a renderer for a world, and the surroundings that it adds, if any."""


@cache
def renderers() -> dict[str, Renderer]:
    """Returns the renderers of extensions by name."""
    return {name: kind() for name, kind in load_all(RENDERERS, Renderer).items()}


def choose_renderer(wanted: str | None, quality: Quality, width: int, height: int) -> str:
    """Returns the name of the renderer for an image; logs a warning if it is not the wanted one.

    Raises:
        RenderError: there is no such renderer.
    """
    if wanted == CLASSIC or (wanted is None and quality != "fine"):
        return CLASSIC  # without importing extensions
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
