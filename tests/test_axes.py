"""Smart axes as numbers."""

import numpy as np
import pytest
from decor_tools import drawn, world_of

from sero_mj.assemble.objects import Object
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World
from sero_mj.decor.axes import AXIS_RGB

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])


def test_axes_stand_at_base_joints_and_flange_along_x_y_z() -> None:
    world = world_of(joint_angles=POSE, show_axes=True, axes_size=0.15, axes_transparency=0.25)
    rows = drawn(world).reshape(-1, 3)
    robot = world.robots["lwr"].robot
    frames = robot.dh.frames(POSE, robot.base_frame)
    frames = np.concatenate([frames, frames[-1:] @ robot.flange_frame])
    assert len(rows) == len(frames) == 9
    for k, (bars, frame) in enumerate(zip(rows, frames, strict=True)):
        for axis in range(3):
            direction = frame[:3, axis]
            bar = bars[axis]
            assert bar["mat"][:, 2] == pytest.approx(direction, abs=1e-6)
            start = bar["pos"] - bar["mat"][:, 2] * bar["size"][2]
            end = bar["pos"] + bar["mat"][:, 2] * bar["size"][2]
            assert start == pytest.approx(frame[:3, 3], abs=1e-6)
            # Frames at one place are nested, the earlier ones longer.
            before = [f for f in frames[:k] if np.allclose(f[:3, 3], frame[:3, 3], atol=1e-9)]
            length = 0.15 / (1 + 0.45 * len(before))
            assert end == pytest.approx(frame[:3, 3] + length * direction, abs=1e-6)
            assert bar["rgba"] == pytest.approx([*AXIS_RGB[axis], 0.75])
            assert np.linalg.det(bar["mat"]) == pytest.approx(1.0, abs=1e-5)


def test_fully_transparent_axes_are_not_drawn() -> None:
    assert len(drawn(world_of(show_axes=True, axes_transparency=1.0))) == 0


def test_axes_that_are_objects_are_always_shown() -> None:
    tool = Object(name="tcp", shape="axes", size=[0.1], frame={"xyz": [0, 0, 0.2]})
    world = world_of(joint_angles=POSE, children=[tool])
    rows = drawn(world)
    assert len(rows) == 3
    robot = world.robots["lwr"].robot
    tcp = robot.fwd_kin_base_to_flange(POSE) @ tool.frame
    assert rows["pos"][2] == pytest.approx(tcp[:3, 3] + 0.05 * tcp[:3, 2], abs=1e-6)
    fixed = World(Scene(objects=[tool], floor=False))
    assert drawn(fixed)["pos"][0] == pytest.approx([0.05, 0, 0.2], abs=1e-6)
