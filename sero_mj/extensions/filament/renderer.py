"""`FilamentRenderer`: draws an `MjvScene` by Filament, in place of MuJoCo's classic renderer.

It takes the same scene, with the same camera, geoms, lights and flags. Whether it can be made at
all is to be asked first, see `probe.py`: where Filament cannot draw, it ends the process.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from ...base.frames import Bools
from ...robots.declared.surroundings import PALETTES
from ...viewer.decor.geom_buffer import GEOM
from ...viewer.decor.scene_writer import struct_view
from ...viewer.image.image_files import Pixels
from ...viewer.image.image_options import Quality
from ...viewer.image.mujoco_private import filament
from .flat_triangles import blend, corners_of, is_flat
from .geoms import GeomPool, seen_rgba
from .light import SceneLights, options_model

log = logging.getLogger(__name__)

MOST_OCCLUDED = 300  # frames with occlusion where it costs memory
MAX_GEOMS = 10_000  # of a scene, as of `mujoco.Renderer`
_FLAGS = mujoco.mjtRndFlag


class FilamentRenderer:
    """Draws a scene of MuJoCo into arrays.

    Args:
        doubles: geoms of doubles, (ngeom,), which glow; None for none.
        surroundings: a model of a floor and a sky, for a model without.
        quality: `draft` is without occlusion, `fine` has the softest shadows.
        frames: about how many will be drawn. Occlusion takes 1 MB of memory a frame, for good, of
            Mesa's software renderer (22.3), which compiles a shader for it every time. There it is
            left out of more than `MOST_OCCLUDED` frames, from the first one on if this is known.

    Attributes:
        driver: name of Vulkan's device.

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
        quality: Quality = "normal",
        frames: int = 1,
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
        self._model, self._quality, self._drawn = model, quality, 0
        with _quiet() as said:
            self._context = module.Context(config)
            self._scene = self._context.create_scene(module.SceneParams())
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
        device = re.search(r"Selected physical device '([^']*)'", "".join(said))
        self.driver = device[1] if device else "unknown"
        is_long = self._leaks and frames > MOST_OCCLUDED
        self._has_occlusion = quality != "draft" and not is_long
        self._configure()

    @property
    def _leaks(self) -> bool:
        return "llvmpipe" in self.driver

    def _configure(self) -> None:
        options = options_model(self._model, self._quality, has_occlusion=self._has_occlusion)
        self._scene.configure_from_model(options)

    def follow(self, data: mujoco.MjData) -> None:
        self._geoms.follow(data)

    def render(self, out: Pixels | None = None) -> Pixels:
        """Draws the scene."""
        rows, scene = self._scene_rows(), self.scene
        eye = mujoco.mjv_averageCamera(scene.camera[0], scene.camera[1])
        flat = is_flat(rows, eye)
        leaders = rows[flat]
        self._geoms.update(rows[~flat] if len(leaders) else rows)
        self._lights.update(self.scene)
        if self._drawn == MOST_OCCLUDED and self._has_occlusion and self._leaks:
            self._has_occlusion = False
            log.info("occlusion is left out from frame %d on, to save memory", self._drawn)
            self._configure()
        request = self._request()
        if self._drawn:
            self._draw(request)
        else:
            with _quiet():  # drivers say what they compile
                self._draw(request)
        self._drawn += 1
        if len(leaders):
            rgba = np.array([seen_rgba(row) for row in leaders], float)
            blend(self._pixels, corners_of(leaders, eye, *self._size), rgba)
        if out is None:
            return self._pixels.copy()
        out[:] = self._pixels
        return out

    def _draw(self, request: object) -> None:
        self._context.wait_for_frame(self._context.render([request], [self._read]))

    def _request(self) -> object:
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
        if not hasattr(self, "_context"):
            return
        self._geoms.close()
        self._lights.close()
        del self._read, self._target, self._geoms, self._lights, self._scene, self._context


@contextmanager
def _quiet() -> Iterator[list[str]]:
    said: list[str] = []
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # there is no standard output
        yield said
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 1)
        try:
            yield said
        finally:
            os.dup2(kept, 1)
            os.close(kept)
            file.seek(0)
            said.append(file.read().decode("utf-8", "replace"))
