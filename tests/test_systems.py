"""The robots of section 4 of the paper, as shipped scenes."""

from __future__ import annotations

import socket
import struct

import numpy as np
import pytest
from decor_tools import view_at

from sero_mj.base.paths import find_scene, list_scenes
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.wiring import wire
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.toggles import Toggles

# Half axes of the haptic device's user, an ellipsoid, m.
CHEST, CHEST_SIZE = np.array([0.0, 0.0, 1.02]), np.array([0.12, 0.19, 0.27])
LINK = 0.07  # radius of an LWR's links, m


@pytest.mark.extensions
def test_shipped_scenes_can_be_shown_at_the_same_time() -> None:
    """If two scenes used one port, the second would fail to start."""
    places: dict[str, str] = {}
    for name in list_scenes():
        scene = load_scene(name)
        for source in wire(scene).check(scene).sources.values():
            other = places.setdefault(source.about.rpartition(" on ")[2], name)
            assert other == name, f"{name} and {other}: {source.about}"
    assert len(places) == len(list_scenes())


def test_hands_reach_the_haptic_device_and_its_arms_clear_the_user() -> None:
    world = World(load_scene(find_scene("haptic_device")))
    data = world.make_data()
    for name, side in (("left", 1.0), ("right", -1.0)):
        hand = world.frame(data, f"{name}/flange")[:3, 3] - CHEST
        assert hand == pytest.approx([0.35, side * 0.22, -0.05], abs=0.005)
        robot = world.robots[name].robot
        joints = robot.dh.frames(robot.home, robot.base_frame)[1:, :3, 3] - CHEST
        assert (np.linalg.norm(joints / (CHEST_SIZE + LINK), axis=1) > 1).all()


@pytest.mark.parametrize("mode", [0, 1])
def test_packet_value_switches_the_mode_of_the_haptic_device(mode: int) -> None:
    scene = load_scene(find_scene("haptic_device"))
    scene.sources["udp"]["port"] = 0
    numbers = [*np.full(14, 0.3), *np.full(14, 0.5), *np.full(14, 20.0), mode]
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        port = mirror.sources["udp"].port
        sender.sendto(struct.pack("<43d", *numbers), ("127.0.0.1", port))
        assert mirror.wait(5.0) == []
        mirror.advance()
        toggles = Toggles(mirror.world)
        decor = Decor(mirror.world)
        decor.draw(mirror.data, toggles, view_at())
    assert (toggles.arrows[:14] == mode).all() and (toggles.doubles != mode).all()
    notes = [text for panels in decor.panels for lines in panels.texts for text in lines]
    assert b"base positions of the robots: approximate, not DLR data" in notes
