"""Pictures of what is where: the part at every pixel, and its depth; decor is in neither.

They are drawn without multisampling: a pixel at an edge is of one part or of the other, never of a
mixture of their numbers.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ...robots.assemble.world_view import WorldView
from ..decor.geom_buffer import GeomBuffer
from ..decor.scene_writer import SceneWriter
from .picking import picked_drawn, picked_geom

BACKGROUND, FLOOR = "background", "floor"
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_WIREFRAME = int(mujoco.mjtRndFlag.mjRND_WIREFRAME)
_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
# What has a surface besides geoms, and the field of a model that counts it.
_SURFACES = {
    int(mujoco.mjtObj.mjOBJ_SKIN): "nskin",
    int(mujoco.mjtObj.mjOBJ_FLEX): "nflex",
    int(mujoco.mjtObj.mjOBJ_TENDON): "ntendon",
}
_AT_INFINITY = 1.0 - 1e-5  # of the distance of the far plane, beyond which nothing is drawn


class Parts:
    """The parts that pictures of a world tell apart, by number.

    Attributes:
        names: by number: `background` (the sky) is 0; then links (`lwr/link3`, or as the robot's
            own file calls them), those of doubles (`goal/link3`), objects, `floor`. They are the
            same in all pictures of a scene.
    """

    def __init__(self, world: WorldView) -> None:
        model = world.model
        self._numbers = {BACKGROUND: 0}
        self._of = {(_GEOM, i): self._number(_geom_name(world, i)) for i in range(model.ngeom)}
        for kind, count in _SURFACES.items():
            for i in range(getattr(model, count)):
                name = mujoco.mj_id2name(model, kind, i) or f"{count[1:]}{i}"
                self._of[kind, i] = self._number(name)
        self._of_double: dict[tuple[str, int], int] = {}
        for double in (name for name, part in world.doubles.items() if not part.is_compiled):
            for i in range(model.ngeom):
                if (picked := picked_drawn(world, double, i)) is not None:
                    self._of_double[double, i] = self._number(picked.own_name)
        self._floor = self._number(FLOOR)
        self.names = tuple(self._numbers)

    def _number(self, name: str) -> int:
        return self._numbers.setdefault(name, len(self._numbers))

    def of(self, geom: mujoco.MjvGeom, double: str | None = None) -> int | None:
        """Returns the part of a geom in a scene; None for decor."""
        if double is not None:
            return self._of_double.get((double, geom.objid))
        if geom.type == _PLANE and geom.objtype == _UNKNOWN:  # of surroundings of our own
            return self._floor
        return self._of.get((geom.objtype, geom.objid))


def _geom_name(world: WorldView, geom: int) -> str:
    model = world.model
    if name := picked_geom(world, geom).own_name:
        return name
    if model.geom_type[geom] == _PLANE:
        return FLOOR
    body: str = model.body(model.geom_bodyid[geom]).name
    return body or f"geom{geom}"


class PassRenderer:
    """Renders the parts and the depths of a world."""

    def __init__(self, world: WorldView, renderer: mujoco.Renderer) -> None:
        self.parts = Parts(world)
        self.scene: mujoco.MjvScene = renderer.scene
        self._renderer: Any = renderer
        self._writer = SceneWriter(renderer.scene)
        self._far = float(world.model.vis.map.zfar * world.model.stat.extent)

    def segmentation(self, buffer: GeomBuffer) -> Ints:
        """Returns the part at every pixel, (height, width), int32."""
        self._mark(buffer)
        self._renderer.enable_segmentation_rendering()
        shown = self._renderer.render()[..., 0]
        return np.asarray(np.maximum(shown, 0))  # it is -1 where there is nothing

    def depth(self, buffer: GeomBuffer) -> Array:
        self._mark(buffer)
        self._renderer.enable_depth_rendering()
        depth: Array = self._renderer.render()
        depth[depth >= _AT_INFINITY * self._far] = np.inf
        return depth

    def close(self) -> None:
        self._renderer.close()

    def _mark(self, buffer: GeomBuffer) -> None:
        scene = self.scene
        scene.flags[_WIREFRAME] = False
        self._writer.mark(buffer)
        ends: list[tuple[int, str | None]] = [(scene.ngeom, None)]
        for drawn in buffer.drawn_doubles:
            self._writer.add_double(drawn)
            ends.append((scene.ngeom, drawn.double))
        start = 0
        for end, double in ends:
            for i in range(start, end):
                geom = scene.geoms[i]
                part = self.parts.of(geom, double)
                if part is None or geom.rgba[3] <= 0:
                    geom.segid = -1  # is not drawn
                    continue
                geom.segid, geom.objid = i, part
                geom.rgba[3] = 1.0  # what is transparent leaves no depth
            start = end
