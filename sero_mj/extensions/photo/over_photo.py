"""`PhotoPainter`: draws arrows, axes and other visual features over photos of the real robot.

The invisible model of the robot hides what is behind the robot. The scene is rendered twice, with a
black and with a white robot and background. The first image contains the colors of the visual
features. The difference between both images determines their transparency. This is exact for smooth
edges and transparent geoms in all OpenGL implementations.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Bools
from ...robots.assemble.world_view import WorldView
from ...viewer.decor.font import Font
from .photo_camera import PhotoCamera, PhotoView, PlaneImage, Size

Pixels = NDArray[np.uint8]
Draw = Callable[[], Pixels]
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
_BACKGROUND_DEPTH = 0.9  # depth of the background, fraction of the far plane distance
# Flags that are switched off: effects of surroundings and lights, and wireframes.
_FLAGS = ("mjRND_SHADOW", "mjRND_REFLECTION", "mjRND_SKYBOX", "mjRND_FOG", "mjRND_HAZE",
          "mjRND_WIREFRAME")  # fmt: skip


class PhotoPainter:
    """A painter that draws visual features over the photos of one camera.

    Args:
        largest: maximum width and height of the rendered image, pixels.
        scale: number of rendered pixels per pixel of the photo, along each side.

    Attributes:
        size: width and height of the rendered image, pixels.
    """

    def __init__(
        self, world: WorldView, camera: PhotoCamera, largest: Size, scale: int = 1
    ) -> None:
        self.camera = camera
        self._plane = PlaneImage(camera, largest, scale)
        self.size = self._plane.size
        doubles = [double.bodies.ravel() for double in world.doubles.values()]
        bodies = np.concatenate(doubles) if doubles else np.zeros(0, np.intp)
        self._is_double: Bools = np.isin(world.model.geom_bodyid, bodies)
        self._is_floor: Bools = world.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE

    def look(
        self,
        scene: mujoco.MjvScene,
        font: Font,
        inset: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> PhotoView:
        """Sets the camera of a scene to that of the photos, and hides the floor."""
        self._plane.look(scene)
        for name in _FLAGS:
            scene.flags[int(getattr(mujoco.mjtRndFlag, name))] = 0
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == _GEOM and geom.objid >= 0 and self._is_floor[geom.objid]:
                # Planes are infinite, but a tiny sphere behind the camera is invisible.
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 1e-6)
                geom.pos = scene.camera[0].pos - scene.camera[0].forward
        near = float(scene.camera[0].frustum_near)
        return PhotoView.of_camera(self.camera, near, font, inset)

    def over(self, photo: Pixels, scene: mujoco.MjvScene, draw: Draw) -> Pixels:
        """Returns a photo with the visual features of a scene.

        Args:
            photo: pixels of the photo in the image size of the camera, shape (height, width, 3).
            draw: function that renders the scene in `size`, top row first.
        """
        masked = self._masked(scene)
        for geom in masked:
            geom.matid = geom.texid = -1
            geom.specular = geom.reflectance = 0.0
            # The color of geoms with this category does not depend on light in Filament.
            geom.category, geom.objtype = _DECOR, _UNKNOWN
        _colour(masked, 0.0)
        black = self._plane.to_photo(draw().copy(), 0)
        _colour(masked, 1.0)
        white = self._plane.to_photo(draw(), 255)
        out = photo.astype(np.uint16)
        out *= np.maximum(white, black) - black
        out += 127
        out //= 255
        out += black
        return np.minimum(out, 255).astype(np.uint8)

    def _masked(self, scene: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
        geoms = [
            geom
            for geom in scene.geoms[: scene.ngeom]
            if geom.category != _DECOR
            and not (geom.objtype == _GEOM and geom.objid >= 0 and self._is_double[geom.objid])
        ]
        if scene.ngeom == scene.maxgeom:
            scene.ngeom -= 1  # the background is required
        camera, background = scene.camera[0], scene.geoms[scene.ngeom]
        distance = _BACKGROUND_DEPTH * camera.frustum_far
        forward, up = np.array(camera.forward, float), np.array(camera.up, float)
        axes = np.column_stack([np.cross(forward, up), up, -forward])
        scale = distance / camera.frustum_near
        wide = abs(camera.frustum_center) + camera.frustum_width
        high = max(abs(camera.frustum_bottom), abs(camera.frustum_top))
        size = 1.1 * scale * np.array([wide, high, 1e-3 * camera.frustum_near])
        mujoco.mjv_initGeom(
            background,
            mujoco.mjtGeom.mjGEOM_BOX,
            size,
            np.array(camera.pos, float) + distance * forward,
            axes.ravel(),
            np.ones(4, np.float32),
        )
        background.category = _DECOR
        scene.ngeom += 1
        return [*geoms, background]


def _colour(geoms: list[mujoco.MjvGeom], brightness: float) -> None:
    for geom in geoms:
        geom.rgba, geom.emission = np.array([*[brightness] * 3, 1.0]), brightness
