"""Puts everything where it belongs: followers, bases on other robots' frames, doubles, frames."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.mjcf_double import OUT_OF_SIGHT
from ..assemble.named_frames import WORLD
from ..assemble.world import World
from ..errors import DeclarationError
from .doubles import pose_doubles
from .follow import follow
from .route import wire
from .router import LateRouter, Packets
from .wiring import FrameRoute, Wiring

Array = NDArray[np.float64]


class Placer:
    """Moves all frames of a world to where its data says.

    Args:
        world: the compiled scene.
        wiring: what `wire` returned for its scene; made anew when None.

    Raises:
        DeclarationError: the scene's routes are wrong.
    """

    def __init__(self, world: World, wiring: Wiring | None = None) -> None:
        wiring = wire(world.scene) if wiring is None else wiring
        if wiring.problems:
            raise DeclarationError(world.scene.located(wiring.problems))
        self._world = world
        self._late = LateRouter(world, wiring.later)
        self._levels = wiring.levels
        placing = [route for route in wiring.frame_routes if route.to.key != "flange_check"]
        self._routes = {route.to.name: route for route in placing}
        self._checks = [route for route in wiring.frame_routes if route not in placing]
        later = {name for level in self._levels for name in level}
        self._at_once = [name for name in world.scene.frames if name not in later]

    def place(self, data: mujoco.MjData, packets: Packets | None = None) -> None:
        """Computes all frames from joint angles and what was received; time does not pass.

        Before, robots get what other robots' outputs lead to them.

        Args:
            data: the world's state.
            packets: the latest values by source and event, for routes that need several.
        """
        self._late.apply(data, packets or {})
        for name in self._at_once:
            self._place_received(data, name)
        pose_doubles(self._world, data)
        for level in self._levels:  # each stands on what the one before has placed
            mujoco.mj_kinematics(self._world.model, data)
            for name in level:
                if name in self._routes:
                    self._follow_route(data, self._routes[name])
                else:
                    self._place_received(data, name)
            pose_doubles(self._world, data)
        follow(self._world.model, data)
        for route in self._checks:
            self._keep(data, route)

    def _origin(self, data: mujoco.MjData, route: FrameRoute) -> Array:
        if route.is_fwd_kin:
            return self._world.fwd_kin_base_to_flange(data, route.frame)
        return self._world.frame(data, route.frame)

    def _follow_route(self, data: mujoco.MjData, route: FrameRoute) -> None:
        T = self._origin(data, route)
        if route.to.kind == "frame":
            self._keep(data, route)
        self._world.set_pose(data, route.to.name, T)
        data.userdata[self._world.flags[route.to.target]] = 1.0

    def _keep(self, data: mujoco.MjData, route: FrameRoute) -> None:
        target = route.to.target
        data.userdata[self._world.slots[target]] = self._origin(data, route).ravel()
        data.userdata[self._world.flags[target]] = 1.0

    def _place_received(self, data: mujoco.MjData, name: str) -> None:
        """Places a received frame, or hides it while there is none."""
        world = self._world
        T = data.userdata[world.slots[f"{name}.frame"]].reshape(4, 4)
        if data.userdata[world.flags[f"{name}.frame"]] <= 0 or not np.isfinite(T).all():
            data.mocap_pos[world.placed[name]] = OUT_OF_SIGHT
            data.userdata[world.flags[f"{name}.frame"]] = 0.0
            return
        relative_to = world.scene.frames[name].relative_to
        parent = np.eye(4) if relative_to == WORLD else world.frame(data, relative_to)
        world.set_pose(data, name, parent @ T)
