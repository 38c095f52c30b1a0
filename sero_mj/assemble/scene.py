"""`Scene`: robots, sources, routes and surroundings, from a TOML file or built in Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import Field

from .. import paths
from ..errors import DeclarationError, Problem, SeroError, did_you_mean
from .declaration import Declaration, Point
from .objects import Object
from .robot import SerialRobot, build_robot
from .toml_file import key_lines, located, read_toml

T = TypeVar("T")


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
    direction: Point = Field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    diffuse: Point = Field(default_factory=lambda: np.full(3, 0.7))
    directional: bool = True
    cast_shadow: bool = True


class Scene:
    """Everything one picture is made from.

    Args:
        robots: by name.
        sources: by name; a table with `kind` and its fields, or a source object.
        routes: input (`lwr.joint_angles`) to event (`udp.values0`).
        objects: fixed things.
        cameras: by name.
        lights: by name; two soft lights when empty.
        floor: whether there is one.
        view: where one looks from.
        name: shown in titles and messages.
        file: the file it was read from.

    Raises:
        DeclarationError: two robots have one name.
    """

    def __init__(
        self,
        *,
        robots: list[SerialRobot] | None = None,
        sources: Mapping[str, Any] | None = None,
        routes: Mapping[str, str] | None = None,
        objects: list[Object] | None = None,
        cameras: Mapping[str, Camera] | None = None,
        lights: Mapping[str, Light] | None = None,
        floor: bool = True,
        view: View | None = None,
        name: str = "scene",
        file: Path | None = None,
    ) -> None:
        self.robots: dict[str, SerialRobot] = {}
        self.sources = dict(sources or {})
        self.routes = dict(routes or {})
        self.objects = list(objects or [])
        self.cameras = dict(cameras or {})
        self.lights = dict(lights or {})
        self.floor = floor
        self.view = view or View()
        self.name = name
        self.file = file
        for robot in robots or []:
            self.add(robot)

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

    def located(self, problems: list[Problem]) -> list[Problem]:
        """Returns the problems with this scene's file and lines, where it came from a file."""
        if self.file is None:
            return problems
        lines = key_lines(self.file)
        return [
            problem if problem.file else located(problem, self.file, lines) for problem in problems
        ]


def read_scene(
    path: Path, overrides: Mapping[str, Any] | None = None
) -> tuple[Scene, list[Problem]]:
    """Reads a scene file, as far as it can be understood.

    Args:
        path: a TOML file.
        overrides: `robot.field` to its value, over what the file says; routes to it are dropped.

    Returns:
        the scene without the parts that are wrong, and every problem. Sources and routes are
        kept as they stand; `sero_mj.drive` checks them, for it knows what they mean.

    Raises:
        DeclarationError: the file cannot be read at all.
    """
    tables = read_toml(path)
    reader = _Reader(path, tables)
    for target, value in (overrides or {}).items():
        robot, _, field = target.partition(".")
        table = tables.get("robots", {}).get(robot)
        if isinstance(table, dict) and field:
            table[field] = value
            tables.get("routes", {}).pop(target, None)
        else:
            names = tables.get("robots", {})
            reader.wrong(target, f"no robot '{robot}' to set this for{did_you_mean(robot, names)}")
    scene = reader.scene()
    return scene, scene.located(reader.problems)


class _Reader:
    """Reads the sections of one file and collects what is wrong with them."""

    def __init__(self, path: Path, tables: dict[str, Any]) -> None:
        self.path = path
        self.tables = tables
        self.problems: list[Problem] = []

    def scene(self) -> Scene:
        sections: dict[str, Callable[[], Any]] = {
            "robots": lambda: list(self._each("robots", self._robot).values()),
            "sources": lambda: self._each("sources", lambda name, table: table),
            "routes": self._routes,
            "objects": lambda: list(self._each("objects", self._object).values()),
            "cameras": lambda: self._each("cameras", lambda _, table: Camera(**table)),
            "lights": lambda: self._each("lights", lambda _, table: Light(**table)),
            "view": lambda: View(**self._table("view")),
            "floor": lambda: self._typed("floor", bool, "true or false"),
            "name": lambda: self._typed("name", str, "a text"),
        }
        for key in self.tables:
            if key not in sections:
                self.wrong(key, f"unknown section{did_you_mean(key, sections)}")
        read = {}
        for key, reader in sections.items():
            if key in self.tables:
                value = self._try(key, reader)
                if value is not None:
                    read[key] = value
        scene = Scene(**{"name": self.path.stem, **read, "file": self.path})
        camera = scene.view.camera
        if camera is not None and camera not in self.tables.get("cameras", {}):
            self.wrong("view.camera", f"no camera '{camera}'{did_you_mean(camera, scene.cameras)}")
        return scene

    def wrong(self, key: str, message: str) -> None:
        self.problems.append(Problem(key, message))

    def _try(self, key: str, build: Callable[[], T]) -> T | None:
        try:
            return build()
        except DeclarationError as error:
            self.problems += [p if p.file else p.inside(key) for p in error.problems]
        except SeroError as error:
            self.wrong(key, str(error))
        return None

    def _typed(self, key: str, kind: type[T], expected: str) -> T | None:
        value = self.tables[key]
        if isinstance(value, kind):
            return value
        self.wrong(key, f"found {value!r}; expected {expected}")
        return None

    def _table(self, key: str) -> dict[str, Any]:
        value = self.tables[key]
        if isinstance(value, dict):
            return value
        raise DeclarationError([Problem("", f"found {value!r}; expected a table [{key}]")])

    def _each(self, key: str, build: Callable[[str, dict[str, Any]], T]) -> dict[str, T]:
        built: dict[str, T] = {}
        for name, table in self._table(key).items():
            place = f"{key}.{name}"
            if not isinstance(table, dict):
                self.wrong(place, f"found {table!r}; expected a table [{place}]")
                continue
            value = self._try(place, lambda name=name, table=table: build(name, table))  # type: ignore[misc]
            if value is not None:
                built[name] = value
        return built

    def _routes(self) -> dict[str, str]:
        routes = {}
        for target, event in self._table("routes").items():
            if isinstance(event, str):
                routes[target] = event
            else:
                hint = "; put quotes about the whole name" if isinstance(event, dict) else ""
                self.wrong(
                    f"routes.{target}",
                    f'found {event!r}; expected an event such as "udp.values0"{hint}',
                )
        return routes

    def _robot(self, name: str, table: dict[str, Any]) -> SerialRobot:
        fields = {**table, "name": name}
        model = fields.pop("model", None)
        beside = self.path.parent
        if "directory" in fields and isinstance(fields["directory"], str):
            fields["directory"] = str(beside / fields["directory"])
        for child in fields.get("children") or []:
            if isinstance(child, dict):
                child.setdefault("directory", str(beside))
        if model is None:
            return build_robot(fields)
        if not isinstance(model, str):
            raise DeclarationError([Problem("model", f"found {model!r}; expected a robot's name")])
        return build_robot(fields, paths.find_model(model, beside))

    def _object(self, name: str, table: dict[str, Any]) -> Object:
        fields = {"directory": str(self.path.parent), **table, "name": name}
        return Object(**fields)
