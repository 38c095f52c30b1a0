"""`CopiedBodies`: the bodies of doubles in a page, if the model does not contain the doubles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...base.frames import Array, Ints
from ...robots.assemble.parts import DrawnDouble
from ...robots.assemble.world_view import WorldView
from .model import visible_geoms


class CopiedBody(NamedTuple):
    """A body of a double that is drawn with the geoms of the same body of its robot.

    Attributes:
        name: name of the body, such as `goal/lower`.
        double: index of the double.
        row: index of the pose in the path of the double; 0 for a double with one pose.
        body: id of the body of the robot.
        rgba: color of the geoms, shape (4,).
    """

    name: str
    double: int
    row: int
    body: int
    rgba: Array


class CopiedBodies:
    """The G bodies of all doubles that are not compiled into the model."""

    def __init__(self, world: WorldView) -> None:
        model, self.each = world.model, list[CopiedBody]()
        self._names = list(world.doubles)
        geoms = visible_geoms(model)
        self._geoms: dict[int, Ints] = {
            int(body): geoms[model.geom_bodyid[geoms] == body]
            for body in np.unique(model.geom_bodyid[geoms])
        }
        for double, (name, part) in enumerate(world.doubles.items()):
            if part.is_compiled:
                continue
            roots = model.body_rootid[part.of.bodies[1:]]
            bodies = [body for body in self._geoms if model.body_rootid[body] in roots]
            for row in range(1 if part.path is None else len(part.path)):
                for body in bodies:
                    label = f"{name}/{model.body(body).name.rpartition('/')[2]}"
                    rgba = np.asarray(part.double.rgba, float)
                    self.each.append(CopiedBody(label, double, row, body, rgba))

    def poses(self, drawn: Sequence[DrawnDouble]) -> tuple[Array, Array, Array]:
        """Returns the poses of all bodies in a frame.

        Args:
            drawn: doubles of the frame. Those of one path must be in the order of its poses.

        Returns:
            positions, shape (G, 3), m; unit quaternions, shape (G, 4); and opacity factors, shape
            (G,). The opacity of bodies that are not drawn is 0.
        """
        count = len(self.each)
        places, turns, opacity = np.zeros((count, 3)), np.zeros((count, 4)), np.zeros(count)
        turns[:, 0] = 1.0
        rows: dict[str, list[DrawnDouble]] = {}
        for one in drawn:
            rows.setdefault(one.double, []).append(one)
        for k, (_, double, row, body, rgba) in enumerate(self.each):
            found = rows.get(self._names[double], [])
            if row < len(found):
                one = found[row]
                places[k], turns[k] = one.data.xpos[body], one.data.xquat[body]
                share = float(one.rgba[3]) / max(float(rgba[3]), 1e-9)
                opacity[k] = share * float(one.opacity[self._geoms[body]].max())
        return places, turns, opacity
