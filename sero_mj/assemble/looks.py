"""Cameras, lights, and where one looks from when no camera is named."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from .declaration import Array, Declaration, Frame, Point


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
        frame: the frame that `position` and `look_at` are in; it can be routed to
            (`NAME.frame`), so that a camera rides on a robot.
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
