"""`ModelDrawing`: draws contacts, inertias, joints and centers of mass of a model with MuJoCo.

MuJoCo adds geoms for these parts. Transparency and wireframes are options of MuJoCo scenes.
"""

from __future__ import annotations

import copy
import logging
from functools import cached_property

import mujoco
import numpy as np

from ...base.errors import SeroError
from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from .geom_buffer import ARROW_SIZE_OF_LENGTH, GEOM
from .scene_writer import struct_view
from .toggles import Toggles

log = logging.getLogger(__name__)

# Mapping from switches to flags of `mjtVisFlag`. Contacts include their forces if they are known.
_FLAGS = {
    "contacts": "mjVIS_CONTACTPOINT",
    "inertias": "mjVIS_INERTIA",
    "joint_axes": "mjVIS_JOINT",
    "centres_of_mass": "mjVIS_COM",
}
_TRANSPARENT = int(mujoco.mjtVisFlag.mjVIS_TRANSPARENT)
_FORCE = int(mujoco.mjtVisFlag.mjVIS_CONTACTFORCE)
_WIREFRAME = int(mujoco.mjtRndFlag.mjRND_WIREFRAME)
_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_JOINT = int(mujoco.mjtObj.mjOBJ_JOINT)
_JOINT_SIZE = (0.22, 0.22, 3.2)  # size of arrows of joints, in radii of the torque arrows
_SPHERE, _UNKNOWN = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtObj.mjOBJ_UNKNOWN)
_MIN_MASS = 1e-6  # kg
# Sizes in mean body sizes. With the default sizes of MuJoCo, these parts hide arms and contacts.
_SIZES = {
    "contactwidth": 0.13, "contactheight": 0.03, "forcewidth": 0.04, "com": 0.15,
    "jointlength": 0.9, "jointwidth": 0.07,
}  # fmt: skip
_INERTIA_RGBA = (0.8, 0.2, 0.2, 0.25)  # the default color of MuJoCo is opaque and hides the arm
_WEIGHT_LENGTH = 0.25  # arrow length of the total weight of a model, fraction of its extent
_GLOW = 0.35  # minimum emission, the same as in `GeomBuffer`
_CAPACITY = 4000


class ModelDrawing:
    """A renderer of the model parts that the switches of `Toggles` select, for one world."""

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._surfaces, self._parts = mujoco.MjvOption(), mujoco.MjvOption()
        self._parts.flags[:] = 0
        for group in ("geom", "site", "tendon", "flex", "skin"):  # surfaces are already drawn
            getattr(self._parts, f"{group}group")[:] = 0
        self._perturb = mujoco.MjvPerturb()
        self._own: mujoco.MjvScene | None = None
        self._views: tuple[mujoco.MjvScene, np.ndarray] | None = None

    @cached_property
    def _model(self) -> mujoco.MjModel:
        try:
            found = copy.copy(self._world.weighed())
        except (SeroError, ValueError) as error:
            log.warning("inertias are not shown: %s", error)
            found = copy.copy(self._world.model)
            found.body_mass[:] = found.body_subtreemass[:] = 0.0
        _set_sizes(found)
        return found

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self._model)

    @cached_property
    def _radii(self) -> Array:
        # Arrow radii of all joints of the model, shape (njnt,), m; 0 for joints without an arrow.
        world, model = self._world, self._world.model
        radii = np.zeros(model.njnt)
        for part in world.robots.values():
            joints = np.searchsorted(model.jnt_qposadr, part.qpos)  # in the order of `qpos`
            radii[joints] = world.joints.arrow_radius[part.joints]
        return radii

    def fill(
        self,
        data: mujoco.MjData,
        toggles: Toggles,
        camera: mujoco.MjvCamera,
        scene: mujoco.MjvScene,
    ) -> None:
        """Fills a scene with the surfaces and the selected parts of the world for a camera."""
        self._surfaces.flags[_TRANSPARENT] = toggles.transparent
        scene.flags[_WIREFRAME] = toggles.wireframe
        model = self._world.model
        mujoco.mjv_updateScene(model, data, self._surfaces, None, camera, _ALL, scene)
        self.add(data, toggles, scene)

    def rows(self, data: mujoco.MjData, toggles: Toggles) -> np.ndarray:
        """Returns the geoms of the selected parts, without surfaces, as an array of type `GEOM`."""
        if not _has_parts(toggles):
            return np.zeros(0, GEOM)
        if self._own is None:
            self._own = mujoco.MjvScene(self._world.model, maxgeom=_CAPACITY)
        self._own.ngeom = 0
        self.add(data, toggles, self._own)
        return self._rows_of(self._own)[: self._own.ngeom].copy()

    def add(self, data: mujoco.MjData, toggles: Toggles, scene: mujoco.MjvScene) -> None:
        """Appends the geoms of the selected parts to a scene."""
        if not _has_parts(toggles):
            return
        for name, flag in _FLAGS.items():
            self._parts.flags[int(getattr(mujoco.mjtVisFlag, flag))] = getattr(toggles, name)
        self._parts.flags[_FORCE] = toggles.contacts and self._world.dynamic
        start = scene.ngeom
        model, own = self._model, self._data
        self._follow(data, has_contacts=toggles.contacts)
        mujoco.mjv_addGeoms(model, own, self._parts, self._perturb, _ALL, scene)
        self._tidy(scene, start)

    def _follow(self, data: mujoco.MjData, *, has_contacts: bool) -> None:
        model, own = self._model, self._data
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(self._world.model, data, state, _STATE)
        mujoco.mj_setState(model, own, state, _STATE)
        if has_contacts and self._world.dynamic:
            mujoco.mj_forward(model, own)
            return
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        if has_contacts:
            mujoco.mj_collision(model, own)

    def _tidy(self, scene: mujoco.MjvScene, start: int) -> None:
        rows = self._rows_of(scene)[start : scene.ngeom]
        rows["emission"] = np.maximum(rows["emission"], _GLOW)
        of_joints = (rows["objtype"] == _JOINT).nonzero()[0]
        radii = self._radii[rows["objid"][of_joints]]
        sized = of_joints[radii > 0]
        rows["size"][sized] = radii[radii > 0, None] * _JOINT_SIZE
        is_centre = (rows["objtype"] == _UNKNOWN) & (rows["type"] == _SPHERE)
        masses = self._model.body_subtreemass[np.where(is_centre, rows["objid"], 0)]
        shown = rows[~is_centre | (masses > _MIN_MASS)]
        rows[: len(shown)] = shown
        scene.ngeom = start + len(shown)

    def _rows_of(self, scene: mujoco.MjvScene) -> np.ndarray:
        if self._views is None or self._views[0] is not scene:
            self._views = scene, struct_view(scene)
        return self._views[1]


def _has_parts(toggles: Toggles) -> bool:
    return any(getattr(toggles, name) for name in _FLAGS)


def _set_sizes(model: mujoco.MjModel) -> None:
    usual, now = mujoco.MjSpec().visual, model.vis
    for name, size in _SIZES.items():
        if getattr(now.scale, name) == np.float32(getattr(usual.scale, name)):
            setattr(now.scale, name, size)
    if np.array_equal(now.rgba.inertia, usual.rgba.inertia):
        now.rgba.inertia = _INERTIA_RGBA
    weight = float(model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity))
    if now.map.force == np.float32(usual.map.force) and weight > 0:
        # MuJoCo divides by the mean mass of bodies.
        per_newton = ARROW_SIZE_OF_LENGTH * _WEIGHT_LENGTH * model.stat.extent / weight
        now.map.force = per_newton * model.stat.meanmass
