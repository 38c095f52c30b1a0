"""`Compiler`: a cache of compiled worlds, for runs that simulate the same robots."""

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

# How many are remembered; a sweep over masses has new ones every time. What controllers know of a
# robot is small, and of each robot of the largest scene it is asked for in every run.
_MAX_WORLDS, _MAX_ROBOTS = 8, MOST_ENTRIES["robots"]


class Compiler:
    """Compiles dynamic worlds, and copies those that it has compiled before.

    Two scenes are the same when everything that is declared of robots, objects and floor is;
    mesh files are taken not to change while it lives.
    """

    def __init__(self) -> None:
        self._worlds: dict[object, World] = {}
        self._models: dict[object, RobotModel] = {}

    def world(self, scene: Scene, gravity: Array = EARTH) -> World:
        """A dynamic world with a model of its own, which may be changed.

        Args:
            scene: of which robots, objects and floor are looked at, and nothing else.
            gravity: (3,), m/s2, in the world.

        Raises:
            DeclarationError: what MuJoCo cannot compile.
        """
        key = fingerprint([scene.robots, scene.objects, scene.floor])
        made = _find(self._worlds, key, lambda: World(scene, dynamic=True), _MAX_WORLDS)
        world = copy.copy(made)
        world.model = copy.copy(world.model)
        world.model.opt.gravity[:] = gravity
        world.scene = scene
        return world

    def robot_model(self, robot: SerialRobot, gravity: Array = EARTH) -> RobotModel:
        """What a controller knows of a robot, for it alone.

        Args:
            gravity: (3,), m/s2, in the world.

        Raises:
            DeclarationError: MuJoCo cannot compile the robot.
        """
        key = fingerprint(robot)
        model = copy.copy(_find(self._models, key, lambda: RobotModel.of(robot), _MAX_ROBOTS))
        model.skeleton.opt.gravity[:] = gravity
        return model


def _find(known: dict[object, T], key: object, make: Callable[[], T], most: int) -> T:
    """Returns what is known, or makes it and forgets what was asked for longest ago."""
    found = known.pop(key, None)
    if found is None:
        found = make()
        if len(known) >= most:
            known.pop(next(iter(known)))
    known[key] = found  # what was asked for last stands last
    return found


def fingerprint(value: Any) -> object:
    """A hashable value that is equal for equal declarations."""
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
