"""`FilamentRenderer`: renders an `MjvScene` with Filament instead of the classic renderer.

The camera, geoms, lights and flags are those of the scene. Call `probe.filament_problem` first,
because Filament ends the process if it cannot render.
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
from ...viewer.decor.geom_buffer import FIRST_SHAPE
from ...viewer.decor.scene_writer import struct_view
from ...viewer.image.image_files import Pixels
from ...viewer.image.image_options import Quality
from ...viewer.image.mujoco_private import filament
from .flat_triangles import blend, corners_of, is_flat
from .geoms import GeomPool, seen_rgba
from .light import SceneLights, options_model

log = logging.getLogger(__name__)

MAX_OCCLUDED = 300  # maximum number of frames with occlusion if the driver leaks memory
MAX_GEOMS = 10_000  # maximum number of geoms of a scene, as in `mujoco.Renderer`
_FLAGS = mujoco.mjtRndFlag


class FilamentRenderer:
    """A renderer that draws an `MjvScene` into arrays with Filament.

    Args:
        look: `light` or `dark`, the look of the scene.
        doubles: mask of geoms of doubles, which emit light, shape (ngeom,); None for no doubles.
        surroundings: model of a floor and a sky; None if the shown model has its own.
        quality: `draft` for images without occlusion, or `fine` for the softest shadows.
        frames: approximate number of frames that will be rendered. With occlusion, the software
            renderer of Mesa (22.3) compiles a shader for each frame and leaks 1 MB each time. This
            driver renders occlusion in at most `MAX_OCCLUDED` frames, and not at all if `frames`
            is larger.

    Attributes:
        driver: name of the Vulkan device.

    Raises:
        RenderError: this version of MuJoCo has no Filament renderer.
    """

    first_shape: int | None = FIRST_SHAPE

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
            # OpenGL would require a display.
            config.graphics_api = module.GraphicsApi.GRAPHICS_API_VULKAN
        palette = PALETTES[look]
        self._model, self._quality, self._drawn = model, quality, 0
        with _quiet() as output:
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
        device = re.search(r"Selected physical device '([^']*)'", "".join(output))
        self.driver = device[1] if device else "unknown"
        is_long = self._leaks and frames > MAX_OCCLUDED
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
        scene = self.scene
        rows = self._rows[: scene.ngeom]
        eye = mujoco.mjv_averageCamera(scene.camera[0], scene.camera[1])
        flat = is_flat(rows, eye)
        leaders = rows[flat]
        self._geoms.update(rows[~flat] if len(leaders) else rows)
        self._lights.update(self.scene)
        if self._drawn == MAX_OCCLUDED and self._has_occlusion and self._leaks:
            self._has_occlusion = False
            log.info("occlusion is off from frame %d on, to save memory", self._drawn)
            self._configure()
        request = self._request()
        if self._drawn:
            self._draw(request)
        else:
            with _quiet():  # drivers print messages about compilation
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

    def close(self) -> None:
        if not hasattr(self, "_context"):
            return
        self._geoms.close()
        self._lights.close()
        del self._read, self._target, self._geoms, self._lights, self._scene, self._context


@contextmanager
def _quiet() -> Iterator[list[str]]:
    output: list[str] = []
    sys.stdout.flush()
    try:
        stdout = os.dup(1)
    except OSError:  # there is no standard output
        yield output
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 1)
        try:
            yield output
        finally:
            os.dup2(stdout, 1)
            os.close(stdout)
            file.seek(0)
            output.append(file.read().decode("utf-8", "replace"))
