"""What the decor tests share: a world with everything set, and a view without OpenGL."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World
from sero_mj.decor.draw import Decor
from sero_mj.decor.toggles import Toggles
from sero_mj.decor.view import View

GEOM = mujoco.mjtGeom


def world_of(**fields: Any) -> World:
    """A world with one LWR and these fields."""
    return World(Scene(robots=[SerialRobot.from_model("lwr", **fields)], floor=False))


def view_at(
    azimuth: float = 0.7, distance: float = 2.5, width: int = 1280, height: int = 800
) -> View:
    """A level look at the middle of a standing LWR."""
    forward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return View(
        position=np.array([0.0, 0.0, 0.6]) - distance * forward,
        right=np.cross(forward, up),
        up=up,
        forward=forward,
        tan_half_fovy=float(np.tan(np.deg2rad(22.5))),
        near=0.02,
        width=width,
        height=height,
    )


def toggles_of(world: World) -> Toggles:
    """What the world declares, without the legend."""
    toggles = Toggles(world)
    toggles.legend = False
    return toggles


def drawn(world: World, view: View | None = None, **shown: bool) -> Any:
    """The rows that decor draws for a world as declared, features set by name."""
    data = world.make_data()
    toggles = toggles_of(world)
    for name, value in shown.items():
        getattr(toggles, name)[:] = value
    pen = Decor(world).draw(data, toggles, view or view_at())
    return pen.rows[: pen.count]


def of_kind(rows: Any, kind: Any) -> Any:
    """The rows of one geom type."""
    return rows[rows["type"] == int(kind)]
