"""`FilamentRenderer`: draws an `MjvScene` by Filament, in place of MuJoCo's classic renderer.

It takes the same scene, with the same camera, geoms, lights and flags. Whether it can be made at
all is to be asked first, see `filament_probe`: where Filament cannot draw, it ends the process.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from ...base.frames import Bools
from ...robots.declared.surroundings import PALETTES
from ..decor.geom_buffer import GEOM
from ..decor.scene_writer import struct_view
from ..mujoco_private import filament
from .filament_geoms import GeomPool
from .filament_light import SceneLights, options_model
from .film import Pixels

MAX_GEOMS = 10_000  # of a scene, as of `mujoco.Renderer`
_FLAGS = mujoco.mjtRndFlag


class FilamentRenderer:
    """Draws a scene of MuJoCo into arrays.

    Args:
        model: what is shown.
        width: of the picture, pixels.
        height: of the picture, pixels.
        look: name of the palette of the surroundings, which has their light.
        doubles: geoms of doubles, (ngeom,), which glow; None for none.
        surroundings: a model of a floor and a sky, for a model without.
        is_draft: without occlusion and soft shadows.

    Attributes:
        scene: to be filled by `mujoco.mjv_updateScene` before a picture is drawn.

    Raises:
        RenderError: this MuJoCo has no Filament.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int,
        height: int,
        *,
        look: str = "light",
        doubles: Bools | None = None,
        surroundings: mujoco.MjModel | None = None,
        is_draft: bool = False,
    ) -> None:
        module = self._module = filament()
        self.scene = mujoco.MjvScene(model, maxgeom=MAX_GEOMS)
        self._rows = struct_view(self.scene)
        self._size = (width, height)
        config = module.ContextConfig()
        if sys.platform == "linux":
            # OpenGL would need a display.
            config.graphics_api = module.GraphicsApi.GRAPHICS_API_VULKAN
        palette = PALETTES[look]
        with _quiet():
            self._context = module.Context(config)
            self._scene = self._context.create_scene(module.SceneParams())
            self._scene.configure_from_model(options_model(model, is_draft=is_draft))
            models = [model] if surroundings is None else [model, surroundings]
            if doubles is None:
                doubles = np.zeros(model.ngeom, bool)
            self._geoms = GeomPool(
                self._context, self._scene, models, doubles, is_dark=look == "dark"
            )
            self._lights = SceneLights(self._context, self._scene, model, look, palette)
            sky = self._geoms.skybox
            if sky is not None:
                self._scene.set_skybox(sky)
            target = module.RenderTargetConfig(color_format=module.PixelFormat.PIXEL_FORMAT_RGB8)
            self._target = self._context.create_render_target(target)
            self._target.resize(width, height)
        self._pixels: Pixels = np.zeros((height, width, 3), np.uint8)
        self._read = module.ReadRequest(target=self._target)
        self._read.set_buffer(self._pixels)
        self._has_drawn = False

    def follow(self, data: mujoco.MjData) -> None:
        """Takes what a scene's geoms do not tell from a state: the shapes of skins and flexes."""
        self._geoms.follow(data)

    def render(self, out: Pixels | None = None) -> Pixels:
        """Draws the scene.

        Args:
            out: output array, (height, width, 3), uint8; None for a new one.

        Returns:
            picture (height, width, 3), uint8, top row first.
        """
        self._geoms.update(self._scene_rows())
        self._lights.update(self.scene)
        request = self._request()
        if self._has_drawn:
            self._draw(request)
        else:
            with _quiet():  # drivers say what they compile
                self._draw(request)
            self._has_drawn = True
        if out is None:
            return self._pixels.copy()
        out[:] = self._pixels
        return out

    def _draw(self, request: object) -> None:
        self._context.wait_for_frame(self._context.render([request], [self._read]))

    def _request(self) -> object:
        """What to draw: the middle between the scene's cameras, with the scene's flags."""
        request, scene, module = self._module.RenderRequest(), self.scene, self._module
        request.scene, request.target = self._scene, self._target
        request.viewport.width, request.viewport.height = self._size
        eye = mujoco.mjv_averageCamera(scene.camera[0], scene.camera[1])
        request.camera = module.Camera(
            **{
                name: getattr(eye, name)
                for name in ("pos", "forward", "up", "frustum_center", "frustum_width",
                             "frustum_bottom", "frustum_top", "frustum_near", "frustum_far")
            },
            orthographic=bool(eye.orthographic),
        )  # fmt: skip
        if scene.flags[_FLAGS.mjRND_WIREFRAME]:
            request.draw_mode = module.DrawMode.DRAW_MODE_WIREFRAME
        request.shadows = bool(scene.flags[_FLAGS.mjRND_SHADOW])
        request.reflections = bool(scene.flags[_FLAGS.mjRND_REFLECTION])
        request.skybox = bool(scene.flags[_FLAGS.mjRND_SKYBOX])
        request.haze = bool(scene.flags[_FLAGS.mjRND_HAZE])
        return request

    def _scene_rows(self) -> np.ndarray:
        count = self.scene.ngeom
        if self._rows is not None:
            return self._rows[:count]
        rows = np.zeros(count, GEOM)
        for row, geom in zip(rows, self.scene.geoms, strict=False):
            for name in GEOM.names or ():
                row[name] = getattr(geom, name)
        return rows

    def close(self) -> None:
        """Frees the context; it must be the last of its parts to go."""
        if not hasattr(self, "_context"):
            return
        self._geoms.close()
        self._lights.close()
        del self._read, self._target, self._geoms, self._lights, self._scene, self._context


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps Filament's messages about its start, which it writes to standard output, to itself."""
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # there is no standard output
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
