"""Flange check: compares the received flange frame of a robot with the computed one.

The received frame is drawn in pale colors, with a line to the computed flange frame. The difference
is shown in the upper right corner. If it exceeds the `flange_tolerance` of the robot, it is shown
in red beside the flange. Source: section 3.1 of the paper.
"""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array, rotation_angle
from ...robots.assemble.parts import RobotPart
from ...robots.assemble.world_view import WorldView
from .axes import AXIS_RGB, draw_bars
from .billboard_layout import BillboardGroup
from .feature import Feature, Frame
from .font import line_of
from .geom_buffer import GeomBuffer, Kind
from .image_view import ImageView
from .layout import RIGHT
from .panels import Panels, panel_sizes
from .smart_arrows import frames_along

OFF_RGBA = (0.55, 0.04, 0.04, 0.92)
_PALE = 0.45  # fraction of white in the color of the received axes
_LINE_RGBA = (0.78, 0.07, 0.07, 1.0)
_GOOD_LINE_RGBA = (0.35, 0.37, 0.40, 1.0)
_LINE_HALF_WIDTH = 0.003  # m
_AXES_SHARE = 0.8  # length of the received axes, fraction of the length of other axes
_CORNER_RGBA = (0.09, 0.11, 0.14, 0.6)
_MARGIN = 0.5  # distance from the image border, fraction of the line height


def flange_difference(
    world: WorldView, data: mujoco.MjData, robot: str
) -> tuple[float, float] | None:
    """Returns the difference between the received and the computed flange frame of a robot.

    Returns:
        distance between the origins, m, and angle between the frames, rad; None if no valid frame
        was received.
    """
    received = _received(world, data, robot)
    if received is None:
        return None
    own = world.fwd_kin_base_to_flange(data, robot)
    distance = float(np.linalg.norm(received[:3, 3] - own[:3, 3]))
    return distance, rotation_angle(own[:3, :3].T @ received[:3, :3])


def _received(world: WorldView, data: mujoco.MjData, robot: str) -> Array | None:
    target = f"{robot}.flange_check"
    if data.userdata[world.flags[target]] <= 0:
        return None
    T = data.userdata[world.slots[target]].reshape(4, 4)
    return T if np.isfinite(T).all() else None


class FlangeCheck(Feature):
    """The visual feature that compares each received flange frame with the computed one."""

    order = 30

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._flags = np.array([world.flags[f"{name}.flange_check"] for name in world.robots], int)

    def lay_out(self, frame: Frame) -> None:
        data, view = frame.data, frame.view
        if not frame.toggles.flange_checks or not (data.userdata[self._flags] > 0).any():
            return
        items, anchors, texts, right = [], [], [], []
        clear, is_hidden = 0.0, False
        for i, (name, part) in enumerate(self.world.robots.items()):
            difference = flange_difference(self.world, data, name)
            if difference is None:
                continue
            if name in frame.stale:
                text = f"{name} flange check: {frame.stale[name]}"
                right.append(line_of(text))
                continue
            distance, angle = difference[0], float(np.rad2deg(difference[1]))
            robot = part.robot
            off = distance > robot.flange_tolerance or angle > robot.flange_tolerance_deg
            point = self._draw_frame(frame.buffer, data, name, off)
            numbers = f"{1e3 * distance:7.2f} mm  {angle:6.2f} deg"
            if not off:
                right.append(line_of(f"{name} flange check{numbers}"))
                continue
            pixel, depth = view.project(point)
            if not view.sees(pixel, depth):
                right.append(line_of(f"{name} flange is off {numbers}"))
                is_hidden = True
                continue
            clear = max(clear, robot.axes_length / view.pixel_size(float(depth)))
            items.append(i)
            anchors.append(pixel)
            head = f"{name} flange is off"
            position = f"  position {1e3 * distance:8.2f} mm".encode()
            texts.append([line_of(head), position, f"  angle    {angle:8.2f} deg".encode()])
        if items:
            frame.billboards.append(self._group(view, items, np.array(anchors), texts, clear))
        if right:
            frame.corners.append(_corner(view, right, is_hidden))

    def _group(
        self,
        view: ImageView,
        items: list[int],
        anchors: Array,
        texts: list[list[bytes]],
        clear: float,
    ) -> BillboardGroup:
        widths = np.array([view.font.block_width(lines) for lines in texts])
        top = len(self.world.joints.names)  # rank above all billboards of joints
        return BillboardGroup(
            kind=Kind.CHECK,
            items=np.array(items, np.intp),
            anchors=anchors,
            sizes=panel_sizes(widths, len(texts[0]), view),
            texts=texts,
            owners=np.array(items, np.intp),
            side=np.full(len(items), RIGHT, np.intp),
            rank=np.array(items, np.intp) + top,
            share=np.full(len(items), np.inf),
            clear=clear,
            rgba=OFF_RGBA,
        )

    def _draw_frame(self, buffer: GeomBuffer, data: mujoco.MjData, name: str, off: bool) -> Array:
        world = self.world
        part: RobotPart = world.robots[name]
        received = _received(world, data, name)
        assert received is not None
        base = world.frame(data, part.base_name)
        own = world.frame(data, part.flange_name)[:3, 3]
        T = base @ received
        length = np.array([_AXES_SHARE * part.robot.axes_length])
        rgb = (AXIS_RGB + _PALE * (1.0 - AXIS_RGB))[None]
        draw_bars(buffer, T[None, :3, 3], T[None, :3, :3], (length, 0.06 * length), rgb, np.ones(1))
        between = T[:3, 3] - own
        distance = float(np.linalg.norm(between))
        if distance > 1e-6:
            rows = buffer.take(1, int(mujoco.mjtGeom.mjGEOM_BOX))
            if len(rows):
                rows["pos"] = own + between / 2
                rows["mat"] = frames_along(between[None] / distance)
                rows["size"] = (_LINE_HALF_WIDTH, _LINE_HALF_WIDTH, distance / 2)
                rows["rgba"] = _LINE_RGBA if off else _GOOD_LINE_RGBA
        return np.asarray(T[:3, 3])


def _corner(view: ImageView, lines: list[bytes], off: bool) -> Panels:
    widest = np.array([max(view.font.width(line) for line in lines)])
    size = panel_sizes(widest, len(lines), view)
    margin = _MARGIN * view.font.height
    corner = view.free[1] - margin
    return Panels(corner - size / 2, size, [lines], OFF_RGBA if off else _CORNER_RGBA)
