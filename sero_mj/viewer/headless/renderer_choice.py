"""Which of MuJoCo's renderers draws a picture: the classic one, or Filament where it runs."""

from __future__ import annotations

import logging
from functools import cache
from typing import get_args

import numpy as np

from ...base.errors import Problem, RenderError
from ...base.frames import Bools
from ...robots.assemble.world_view import WorldView
from ..added_surroundings import AddedSurroundings, added_surroundings
from .filament.probe import PACKAGES, filament_problem
from .filament.renderer import FilamentRenderer
from .picture_options import Quality, RendererName

log = logging.getLogger(__name__)

RENDERERS: tuple[str, ...] = get_args(RendererName)


def choose_renderer(
    wanted: RendererName | None, quality: Quality, width: int, height: int
) -> RendererName:
    """Returns the renderer of a picture; logs in a line where it is not the wanted one.

    Args:
        wanted: None for Filament where it runs for the quality `fine`, else the classic one.
        quality: of the picture.
        width: of what is drawn, pixels.
        height: likewise.

    Raises:
        RenderError: there is no such renderer.
    """
    if wanted is not None and wanted not in RENDERERS:
        raise RenderError(Problem("renderer", found=wanted, expected=", ".join(RENDERERS)))
    if wanted == "classic" or (wanted is None and quality != "fine"):
        return "classic"
    problem = filament_problem(width, height)
    if problem is None:
        return "filament"
    _tell(problem)
    return "classic"


@cache  # once for all pictures of a process
def _tell(problem: str) -> None:
    log.warning(
        "the classic renderer draws, as Filament does not run here: %s; Debian, Ubuntu: apt "
        "install %s", problem, PACKAGES,
    )  # fmt: skip


def make_filament(
    world: WorldView, width: int, height: int, quality: Quality, *, frames: int = 1
) -> tuple[FilamentRenderer, AddedSurroundings | None]:
    """Returns Filament's renderer for a world, and the surroundings that it adds, if any.

    Args:
        world: what to render.
        width: pixels.
        height: pixels.
        quality: of the picture.
        frames: about how many will be drawn, see `FilamentRenderer`.
    """
    surroundings = added_surroundings(world, None)
    renderer = FilamentRenderer(
        world.model, width, height, look=world.scene.view.look, doubles=_doubles(world),
        surroundings=None if surroundings is None else surroundings.model, quality=quality,
        frames=frames,
    )  # fmt: skip
    return renderer, surroundings


def _doubles(world: WorldView) -> Bools:
    """Returns the geoms of the model that belong to doubles, (ngeom,)."""
    bodies = [double.bodies.ravel() for double in world.doubles.values()]
    found = np.concatenate(bodies) if bodies else np.zeros(0, np.intp)
    return np.asarray(np.isin(world.model.geom_bodyid, found))
