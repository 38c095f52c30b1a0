"""`AddedSurroundings`: a floor, a sky and lights for models without them.

The classic renderer of MuJoCo draws an `MjvScene` with the textures and meshes of an `MjrContext`.
Both are created from the same model. The surroundings are a separate model. Its lights and floor
are copied into the scene, and its textures into the context, so that the model and the data of the
user do not change. Filament has no such context and renders both models.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...robots.assemble.world_view import WorldView

_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
_MAX_GEOMS = 4


def added_surroundings(
    world: WorldView, context: mujoco.MjrContext | None
) -> AddedSurroundings | None:
    """Returns the surroundings that are added to each frame, or None if the world has its own."""
    own = world.surroundings()
    return None if own is None else AddedSurroundings(own, world.model, context)


class AddedSurroundings:
    """A floor, a sky and lights, which `add` copies into an `MjvScene` before it is rendered."""

    def __init__(
        self, own: mujoco.MjModel, model: mujoco.MjModel, context: mujoco.MjrContext | None
    ) -> None:
        self.model = own
        # The floor ends at the far plane of the shown model.
        own.stat.extent, own.vis.map.zfar = model.stat.extent, model.vis.map.zfar
        self._material = -1 if context is None else _lend_textures(own, model, context)
        self._scene = mujoco.MjvScene(own, maxgeom=_MAX_GEOMS)
        data, option, camera = mujoco.MjData(own), mujoco.MjvOption(), mujoco.MjvCamera()
        mujoco.mj_forward(own, data)
        mujoco.mjv_updateScene(own, data, option, None, camera, _ALL, self._scene)

    def add(self, scene: mujoco.MjvScene) -> None:
        own = self._scene
        if own.nlight:
            scene.nlight = own.nlight
        eye = scene.camera[0]
        for source, light in zip(own.lights[: own.nlight], scene.lights, strict=False):
            _copy(source, light)
            if light.headlight:
                light.pos, light.dir = eye.pos, eye.forward
        for geom in own.geoms[: min(own.ngeom, scene.maxgeom - scene.ngeom)]:
            floor = scene.geoms[scene.ngeom]
            _copy(geom, floor)
            # Without this, clicks would select the geom of the shown model with the same number.
            floor.objtype, floor.objid, floor.matid = _UNKNOWN, -1, self._material
            scene.ngeom += 1


def _copy(source: Any, target: Any) -> None:
    for name in dir(source):
        if not name.startswith("_"):
            setattr(target, name, getattr(source, name))


def _lend_textures(own: mujoco.MjModel, model: mujoco.MjModel, context: mujoco.MjrContext) -> int:
    buffer = context.currentBuffer
    own.vis.global_.offwidth = own.vis.global_.offheight = 16
    own.vis.quality.shadowsize = own.vis.quality.offsamples = 0
    lender = mujoco.MjrContext(own, mujoco.mjtFontScale.mjFONTSCALE_100)
    first, count = context.ntexture, lender.ntexture
    context.texture[first : first + count] = lender.texture[:count]
    context.textureType[first : first + count] = lender.textureType[:count]
    context.ntexture = first + count
    lender.ntexture = 0
    at = int(model.nmat)
    if own.nmat and at < len(context.mat_texuniform):
        roles = int(mujoco.mjtTextureRole.mjNTEXROLE)
        texture = lender.mat_texid[:roles]
        context.mat_texid[at * roles : (at + 1) * roles] = np.where(
            texture < 0, -1, texture + first
        )
        context.mat_texrepeat[2 * at : 2 * at + 2] = lender.mat_texrepeat[:2]
        context.mat_texuniform[at] = lender.mat_texuniform[0]
    else:
        at = -1  # a floor without texture
    if own.ngeom:
        # The shown model has no planes, so these lists are empty.
        context.basePlane, context.rangePlane = lender.basePlane, lender.rangePlane
        lender.basePlane = lender.rangePlane = 0
    lender.free()
    mujoco.mjr_setBuffer(buffer, context)
    return at
