"""`Filament`: adds the Filament renderer of MuJoCo as a value of `--renderer`."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...base.frames import Bools
from ...robots.assemble.world_view import WorldView
from ...viewer.image.added_surroundings import AddedSurroundings, added_surroundings
from ...viewer.image.image_options import Quality
from ...viewer.image.renderer import Renderer
from .probe import PACKAGES, filament_problem
from .renderer import FilamentRenderer


class Filament(Renderer):
    """The Filament renderer, with soft shadows, occlusion and materials, on Vulkan."""

    title: ClassVar[str] = "Filament"
    is_for_fine: ClassVar[bool] = True
    packages: ClassVar[str] = PACKAGES

    def problem(self, width: int, height: int) -> str | None:
        return filament_problem(width, height)

    def make(
        self, world: WorldView, width: int, height: int, quality: Quality, *, frames: int = 1
    ) -> tuple[FilamentRenderer, AddedSurroundings | None]:
        surroundings = added_surroundings(world, None)
        renderer = FilamentRenderer(
            world.model, width, height, look=world.scene.view.look, doubles=_doubles(world),
            surroundings=None if surroundings is None else surroundings.model, quality=quality,
            frames=frames,
        )  # fmt: skip
        return renderer, surroundings


def _doubles(world: WorldView) -> Bools:
    bodies = [double.bodies.ravel() for double in world.doubles.values()]
    found = np.concatenate(bodies) if bodies else np.zeros(0, np.intp)
    return np.asarray(np.isin(world.model.geom_bodyid, found))
