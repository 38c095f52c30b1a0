"""Cameras, lights, colour themes, and the default view of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from ..declaration import Array, Declaration, Frame, Point

Rgb = tuple[float, float, float]


def _unit_range(rgb: Array) -> Array:
    if (rgb < 0).any() or (rgb > 1).any():
        raise ValueError(f"found {rgb.tolist()}; expected three numbers from 0 to 1")
    return rgb


def _direction(vector: Array) -> Array:
    if not np.abs(vector).max() > 0:
        raise ValueError(f"found {vector.tolist()}; expected a direction")
    return vector


Look = Literal["light", "dark"]


class Camera(Declaration):
    """A named camera.

    Attributes:
        position: in `frame`, m.
        look_at: the point at the picture's centre, in `frame`, m.
        fovy_deg: vertical field of view in degrees.
        frame: T_world_frame of `position` and `look_at`; its input `NAME.frame` can be set by a
            route, to move the camera with a robot.
    """

    position: Point
    look_at: Point = Field(default_factory=lambda: np.zeros(3))
    fovy_deg: float = Field(45.0, gt=0, lt=180)
    frame: Frame = Field(default_factory=lambda: np.eye(4))

    @field_validator("look_at")
    @classmethod
    def _is_elsewhere(cls, look_at: Array, info: ValidationInfo) -> Array:
        position = info.data.get("position")
        if position is not None and np.array_equal(look_at, position):
            raise ValueError(f"found {look_at.tolist()}; expected another point than position")
        return look_at


class View(Declaration):
    """The view of a scene when no camera is named.

    Attributes:
        camera: a camera of the scene; the other fields are for the free camera.
        azimuth_deg: viewing direction about the vertical, 90 looks along +y.
        elevation_deg: negative looks down.
        distance: m from the look-at point; None fits the scene.
        look_at: m; None for the centre of the scene.
        look: colour theme, `light` or `dark`.
    """

    camera: str | None = None
    azimuth_deg: float = 150.0
    elevation_deg: float = -14.0
    distance: float | None = Field(None, gt=0)
    look_at: Point | None = None
    look: Look = "light"


@dataclass(frozen=True)
class Palette:
    """Colours of the surroundings, red, green, blue, 0 to 1.

    Attributes:
        sky: at the horizon and at the zenith.
        tiles: of the floor, two shades and the line between them.
        haze: at the end of the floor.
        headlight: ambient and diffuse intensity.
        key: intensity of the light that casts shadows.
    """

    sky: tuple[Rgb, Rgb]
    tiles: tuple[Rgb, Rgb, Rgb]
    haze: Rgb
    headlight: tuple[float, float]
    key: float


PALETTES = {
    # Chosen with the key light so that a floor seen from above is just below white.
    "light": Palette(
        sky=((0.97, 0.98, 0.99), (0.70, 0.76, 0.82)),
        tiles=((0.83, 0.85, 0.87), (0.86, 0.88, 0.90), (0.78, 0.80, 0.83)),
        haze=(0.93, 0.95, 0.97),
        headlight=(0.34, 0.28),
        key=0.52,
    ),
    "dark": Palette(
        sky=((0.11, 0.13, 0.16), (0.03, 0.04, 0.05)),
        tiles=((0.15, 0.17, 0.20), (0.17, 0.19, 0.22), (0.24, 0.27, 0.31)),
        haze=(0.09, 0.11, 0.14),
        headlight=(0.30, 0.30),
        key=0.55,
    ),
}


class Light(Declaration):
    """A light with a position and a direction.

    Attributes:
        position: m.
        direction: in which the light shines; of any length.
        diffuse: red, green, blue, 0 to 1.
        directional: parallel rays, as from the sun.
        cast_shadow: whether objects cast shadows in it.
    """

    position: Point
    direction: Annotated[Point, AfterValidator(_direction)] = np.array([0.0, 0.0, -1.0])
    diffuse: Annotated[Point, AfterValidator(_unit_range)] = np.full(3, 0.7)
    directional: bool = True
    cast_shadow: bool = True
