"""`Renderer`: what draws pictures besides MuJoCo's classic renderer, and which one draws.

A package adds a renderer by an entry point in the group `sero_mj.renderers`. Its name is the value
of `--renderer`.
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
    """Draws a scene of MuJoCo into arrays.

    Attributes:
        scene: to be filled by `mujoco.mjv_updateScene` before a picture is drawn.
    """

    scene: mujoco.MjvScene

    def follow(self, data: mujoco.MjData) -> None:
        """Takes from a state what the geoms of a scene do not tell: shapes of skins and flexes."""

    def render(self, out: Pixels | None = None) -> Pixels: ...

    def close(self) -> None: ...


class Renderer(ABC):
    """A kind of renderer. Objects are made without arguments.

    Attributes:
        is_for_fine: whether pictures of the quality `fine` take it where none is asked for.
        packages: of Debian and Ubuntu, which it needs.
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
    """Renderers besides the classic one, by name."""
    return {name: kind() for name, kind in load_all(RENDERERS, Renderer).items()}


def choose_renderer(wanted: str | None, quality: Quality, width: int, height: int) -> str:
    """Returns the renderer of a picture; logs in a line where it is not the wanted one.

    Raises:
        RenderError: there is no such renderer.
    """
    if wanted == CLASSIC or (wanted is None and quality != "fine"):
        return CLASSIC  # without importing the others
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
    _tell(wanted, problem)
    return CLASSIC


@cache  # once for all pictures of a process
def _tell(name: str, problem: str) -> None:
    kind = renderers()[name]
    remedy = f"; Debian, Ubuntu: apt install {kind.packages}" if kind.packages else ""
    log.warning("the classic renderer draws, as %s does not run here: %s%s",
                kind.title, problem, remedy)  # fmt: skip
