"""`Scene`: robots, sources, routes and surroundings, as they are declared."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from ..errors import DeclarationError, Problem, did_you_mean
from .declaration import Array, Declaration, Point
from .double import Double
from .objects import Object
from .robot import SerialRobot
from .toml_file import key_lines, located


def _unit_range(rgb: Array) -> Array:
    if (rgb < 0).any() or (rgb > 1).any():
        raise ValueError(f"found {rgb.tolist()}; expected three numbers from 0 to 1")
    return rgb


def _direction(vector: Array) -> Array:
    if not np.abs(vector).max() > 0:
        raise ValueError(f"found {vector.tolist()}; expected a direction")
    return vector


class Camera(Declaration):
    """A camera with a name.

    Attributes:
        position: in the world, m.
        look_at: the point it looks at, m.
        fovy_deg: vertical field of view in degrees.
    """

    position: Point
    look_at: Point = Field(default_factory=lambda: np.zeros(3))
    fovy_deg: float = Field(45.0, gt=0, lt=180)

    @field_validator("look_at")
    @classmethod
    def _is_elsewhere(cls, look_at: Array, info: ValidationInfo) -> Array:
        position = info.data.get("position")
        if position is not None and np.array_equal(look_at, position):
            raise ValueError(f"found {look_at.tolist()}; expected another point than position")
        return look_at


class View(Declaration):
    """Where one looks from when no camera is named.

    Attributes:
        camera: a camera of the scene; the rest is for the free camera.
        azimuth_deg: direction of sight about the vertical, 90 looks along +y.
        elevation_deg: negative looks down.
        distance: m from the look-at point; None fits the scene.
        look_at: m; None is the middle of the scene.
    """

    camera: str | None = None
    azimuth_deg: float = 150.0
    elevation_deg: float = -14.0
    distance: float | None = Field(None, gt=0)
    look_at: Point | None = None


class Light(Declaration):
    """A light that shines from a position along a direction.

    Attributes:
        position: m.
        direction: towards what is lit; need not be of unit length.
        diffuse: red, green, blue, 0 to 1.
        directional: parallel rays, as from the sun.
        cast_shadow: whether things throw shadows in it.
    """

    position: Point
    direction: Annotated[Point, AfterValidator(_direction)] = np.array([0.0, 0.0, -1.0])
    diffuse: Annotated[Point, AfterValidator(_unit_range)] = np.full(3, 0.7)
    directional: bool = True
    cast_shadow: bool = True


class Scene:
    """Everything one picture is made from.

    Args:
        robots: by name.
        sources: by name; a table with `kind` and its fields, or a source object.
        routes: input (`lwr.joint_angles`) to event (`udp.values0`).
        doubles: transparent doubles of the robots.
        objects: fixed things.
        cameras: by name.
        lights: by name; one that casts shadows when empty. A headlight is always there.
        floor: whether there is one.
        view: where one looks from.
        name: shown in titles and messages.
        file: the file it was read from.
        broken: what the file declares but could not be built: sections (`robots`) and entries
            (`robots.lwr`).

    Raises:
        DeclarationError: two robots have one name.
    """

    def __init__(
        self,
        *,
        robots: list[SerialRobot] | None = None,
        sources: Mapping[str, Any] | None = None,
        routes: Mapping[str, str] | None = None,
        doubles: list[Double] | None = None,
        objects: list[Object] | None = None,
        cameras: Mapping[str, Camera] | None = None,
        lights: Mapping[str, Light] | None = None,
        floor: bool = True,
        view: View | None = None,
        name: str = "scene",
        file: Path | None = None,
        broken: Collection[str] = (),
    ) -> None:
        if isinstance(robots, SerialRobot):
            robots = [robots]
        for key, value in (("sources", sources), ("routes", routes)):
            if value is not None and not isinstance(value, Mapping):
                message = f"found {value!r}; expected a mapping from names"
                raise DeclarationError([Problem(key, message)])
        self.robots: dict[str, SerialRobot] = {}
        self.doubles = {double.name: double for double in doubles or []}
        self.sources = dict(sources or {})
        self.routes = dict(routes or {})
        self.objects = list(objects or [])
        self.cameras = dict(cameras or {})
        self.lights = dict(lights or {})
        self.floor = floor
        self.view = view or View()
        self.name = name
        self.file = file
        self.broken = frozenset(broken)
        if not all(isinstance(robot, SerialRobot) for robot in robots or []):
            message = f"found {robots!r}; expected a list of SerialRobot"
            raise DeclarationError([Problem("robots", message)])
        for robot in robots or []:
            self.add(robot)
        problems = self.double_problems()
        if problems and file is None:
            raise DeclarationError(problems)

    def add(self, robot: SerialRobot) -> SerialRobot:
        """Adds a robot and returns it.

        Raises:
            DeclarationError: a robot of that name is there already.
        """
        if robot.name in self.robots:
            message = f"two robots have the name '{robot.name}'; expected different names"
            raise DeclarationError([Problem(f"robots.{robot.name}", message)])
        self.robots[robot.name] = robot
        return robot

    def double_problems(self) -> list[Problem]:
        """Doubles of robots that are not there, or with another number of joints."""
        problems = []
        for name, double in self.doubles.items():
            if name in self.robots:
                message = "a robot has this name; expected another one"
                problems.append(Problem(f"doubles.{name}", message))
            if not self.declares("robots", double.of):
                near = did_you_mean(double.of, self.declared("robots"))
                problems.append(Problem(f"doubles.{name}.of", f"no robot '{double.of}'{near}"))
            elif double.of in self.robots:
                n = self.robots[double.of].n
                for key in ("joint_angles", "path"):
                    value = getattr(double, key)
                    if value is not None and value.shape[-1] != n:
                        message = f"found {value.shape[-1]} joints; {double.of} has {n}"
                        problems.append(Problem(f"doubles.{name}.{key}", message))
            if double.path is not None and len(double.path) < 2:
                problems.append(Problem(f"doubles.{name}.path", "expected two rows or more"))
        return problems

    def declares(self, section: str, name: str) -> bool:
        """Whether there is such an entry, be it right or wrong; then one report is enough."""
        entries = self.robots if section == "robots" else self.sources
        return name in entries or bool({section, f"{section}.{name}"} & self.broken)

    def declared(self, section: str) -> list[str]:
        """Names in a section (`robots` or `sources`), those of broken entries included."""
        entries = self.robots if section == "robots" else self.sources
        broken = [key.partition(".")[2] for key in self.broken if key.startswith(f"{section}.")]
        return [*entries, *broken]

    def located(self, problems: list[Problem]) -> list[Problem]:
        """Returns the problems with this scene's file and lines, where it came from a file."""
        if self.file is None:
            return problems
        lines = key_lines(self.file)
        return [
            problem if problem.file else located(problem, self.file, lines)
            for problem in (self._in_its_model(problem, lines) for problem in problems)
        ]

    def _in_its_model(self, problem: Problem, lines: Mapping[str, int]) -> Problem:
        """A field that the scene takes over from a robot's file is wrong in that file."""
        section, _, rest = problem.key.partition(".")
        name, _, key = rest.partition(".")
        robot = self.robots.get(name) if section == "robots" else None
        model = None if robot is None else robot._model
        if problem.file or model is None or not key:
            return problem
        if f"{section}.{name}.{key.partition('.')[0]}" in lines:
            return problem
        return located(Problem(key, problem.message), model, key_lines(model))
