"""`Compiler`: a cache of compiled worlds and robot models."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from ...base.declaration import Declaration
from ...base.frames import Array
from ...robots.assemble.robot_dynamics import EARTH
from ...robots.assemble.world import World
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import MOST_ENTRIES, Scene
from .robot_model import RobotModel

T = TypeVar("T")

# Sizes of the caches. A sweep over masses compiles new worlds in every run. Robot models are small,
# and every run needs the models of all robots of its scene.
_MAX_WORLDS, _MAX_ROBOTS = 8, MOST_ENTRIES["robots"]


class Compiler:
    """Compiles dynamic worlds and robot models, caches them, and returns copies.

    The cache key consists of the declarations of robots, objects and floor. Changes of mesh files
    are not detected.
    """

    def __init__(self) -> None:
        self._worlds: dict[object, World] = {}
        self._models: dict[object, RobotModel] = {}

    def world(self, scene: Scene, gravity: Array = EARTH) -> World:
        """Returns a dynamic world whose model may be changed.

        Raises DeclarationError if MuJoCo cannot compile the scene.
        """
        key = fingerprint([scene.robots, scene.objects, scene.floor])
        made = _find(self._worlds, key, lambda: World(scene, dynamic=True), _MAX_WORLDS)
        world = copy.copy(made)
        world.model = copy.copy(world.model)
        world.model.opt.gravity[:] = gravity
        world.scene = scene
        return world

    def robot_model(self, robot: SerialRobot, gravity: Array = EARTH) -> RobotModel:
        """Returns an independent model of a robot.

        Raises DeclarationError if MuJoCo cannot compile the robot.
        """
        key = fingerprint(robot)
        model = copy.copy(_find(self._models, key, lambda: RobotModel.of(robot), _MAX_ROBOTS))
        model.skeleton.opt.gravity[:] = gravity
        return model


def _find(cache: dict[object, T], key: object, make: Callable[[], T], max_size: int) -> T:
    found = cache.pop(key, None)
    if found is None:
        found = make()
        if len(cache) >= max_size:
            cache.pop(next(iter(cache)))  # the least recently used
    cache[key] = found
    return found


def fingerprint(value: Any) -> object:
    """Returns a hashable value that is equal for equal declarations."""
    if isinstance(value, Declaration):
        fields = type(value).model_fields
        return type(value).__name__, tuple(fingerprint(getattr(value, key)) for key in fields)
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, Mapping):
        return "mapping", tuple((key, fingerprint(each)) for key, each in value.items())
    if isinstance(value, list | tuple):
        return "list", tuple(fingerprint(each) for each in value)
    return type(value).__name__, repr(value)
