"""`Clearance`: distances between the links of a robot, and between links and surroundings."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from ...base.errors import UsageError
from ...base.frames import Array, Ints
from ...robots.assemble.world import World
from ...robots.declared.scene import Scene

_FAR = 1.0  # m, larger distances are not computed
_ALWAYS = 0.95  # share of random poses in which overlapping shapes do not indicate a collision
_START_SHARE = 0.9  # share of the distance at the start that must remain if it is already small


class Clearance:
    """Distances between collision shapes, of which at least one moves with a robot.

    Adjacent links are ignored as in simulations, and so are links whose shapes overlap in almost
    all poses. Two parts that are closer than `distance` at the start may stay that close.

    Args:
        scene: scene with the robot. All other robots and objects are at rest.
        name: name of the robot.
        distance: required distance, m.
        start: joint values at the start, shape (n,), rad or m.
        poses: random joint values, shape (K, n).

    Attributes:
        notes: sentences about links whose distances are unknown.

    Raises:
        UsageError: the robot touches itself or something else at the start.
    """

    def __init__(
        self, scene: Scene, name: str, distance: float, start: Array, poses: Array
    ) -> None:
        world = World(scene, dynamic=True)
        self._model = model = world.physics_model()
        self._data, rest = mujoco.MjData(model), world.make_data()
        for key in ("qpos", "mocap_pos", "mocap_quat"):
            getattr(self._data, key)[:] = getattr(rest, key)
        part = world.robots[name]
        self._qpos, self._distance = part.qpos, distance
        # Bodies with the same number do not move relative to each other.
        self._rigid = np.zeros(model.nbody, np.intp)
        for body in range(1, model.nbody):
            own = body in model.dof_bodyid[part.dofs]
            self._rigid[body] = body if own else self._rigid[model.body_parentid[body]]
        shown = set(self._rigid[model.geom_bodyid].tolist())  # this model has no visual geometry
        bare = [self._named(body) for body in sorted({*self._rigid.tolist()} - shown - {0})]
        text = "no collision shapes are declared, so distances are not checked"
        self.notes = [f"{', '.join(bare)}: {text}"] if bare else []
        self._required = np.full((model.nbody, model.nbody), distance)
        self._ignore_overlaps(poses)
        for _, pairs, distances in self._contacts(start[None], distance):
            for pair, found in zip(pairs.tolist(), distances.tolist(), strict=True):
                if found < 0.0 and self._required[*pair] > 0.0:
                    one, other = (self._named(body) for body in pair)
                    reason = f"{one} and {other} touch at the start of the motion of '{name}'"
                    raise UsageError(f"{reason}. Choose another pose with --start.")
                self._required[*pair] = min(self._required[*pair], _START_SHARE * found)

    def _ignore_overlaps(self, poses: Array) -> None:
        overlaps = np.zeros(self._required.shape)
        for _, pairs, distances in self._contacts(poses, self._distance):
            for one, other in np.unique(pairs[distances < 0.0], axis=0):
                overlaps[one, other] += 1.0
        self._required[overlaps > _ALWAYS * len(poses)] = -np.inf

    def _contacts(self, poses: Array, within: float) -> Iterator[tuple[int, Ints, Array]]:
        # Rows of poses in which geoms are close, ids of the two bodies (C, 2), ascending, and their
        # distances (C,).
        model, data = self._model, self._data
        model.geom_margin[:] = 0.5 * within  # MuJoCo adds the margins of both geoms
        for row, pose in enumerate(poses):
            data.qpos[self._qpos] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                bodies = np.sort(model.geom_bodyid[data.contact.geom], axis=1)
                moved = np.diff(self._rigid[bodies], axis=1)[:, 0] != 0
                yield row, bodies[moved], data.contact.dist[moved]

    def _named(self, body: int) -> str:
        return self._model.body(body).name.rstrip("/") if body else "the surroundings"

    def shortfalls(self, poses: Array) -> Array:
        """Returns how far parts are too close in poses (K, n), relative to the required distance.

        The result has shape (K,). It is zero if all distances are sufficient.
        """
        found = np.zeros(len(poses))
        for row, pairs, distances in self._contacts(poses, self._distance):
            required = self._required[pairs[:, 0], pairs[:, 1]]
            found[row] = np.maximum(required - distances, 0.0).sum() / self._distance
        return found

    def nearest(self, poses: Array) -> tuple[float, str, int]:
        """Returns the minimum distance in m, both parts as text, and the row, in poses (K, n).

        The distance is infinite if all distances are above 1 m.
        """
        least, where, nearest = np.inf, "", 0
        for row, pairs, distances in self._contacts(poses, _FAR):
            ignored = np.isinf(self._required[pairs[:, 0], pairs[:, 1]])
            found = np.where(ignored, np.inf, distances)
            if len(found) and found.min() < least:
                least, nearest = float(found.min()), row
                where = " and ".join(self._named(int(body)) for body in pairs[found.argmin()])
        return least, where, nearest
