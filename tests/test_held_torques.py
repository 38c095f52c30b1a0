"""Gravity torques of robots without data, in images, videos and pages."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from decor_tools import view_at
from PIL import Image

from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.assemble.gravity_torques import GravityTorques
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.image import video_frames
from sero_mj.viewer.image.held_torques import HeldTorques
from sero_mj.viewer.image.render import render_image, render_video
from sero_mj.viewer.image.scene_decor import SceneDecor
from sero_mj.viewer.player.capture import capture

BENT = [0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1]
SMALL = {"size": (320, 240), "quality": "draft"}


def lwr(**fields: Any) -> Scene:
    return Scene(robots=[SerialRobot.from_model("lwr", show_arrows=True, **fields)])


def held() -> np.ndarray:
    return GravityTorques({"lwr": SerialRobot.from_model("lwr")}).of({"lwr": np.array(BENT)})["lwr"]


def legend(scene: Scene) -> str:
    with Mirror(scene) as mirror:
        decor = SceneDecor(mirror.world)
        HeldTorques(mirror, decor.toggles).update(mirror.data)
        decor.lay_out(mirror.data, view_at())
        panels = [panel for panel in decor.panels if panel.of_arrows]
        return "\n".join(line.decode() for panel in panels for line in panel.texts[0])


@pytest.mark.parametrize(
    ("fields", "first"),
    [
        ({"joint_angles": BENT}, "round arrows: gravity torque of the model"),
        ({"joint_angles": BENT, "torques": np.ones(7)}, "round arrows: joint torque"),
        ({}, ""),  # upright: no arrow is visible
        ({"joint_angles": BENT, "show_arrows": False}, ""),
    ],
)
def test_legend_describes_visible_arrows_only(fields: dict[str, Any], first: str) -> None:
    scene = Scene(robots=[SerialRobot.from_model("lwr", **{"show_arrows": True, **fields})])
    assert legend(scene).partition("\n")[0] == first


def test_floating_robot_has_no_arrows_and_no_legend(caplog) -> None:
    scene = lwr(joint_angles=BENT, free_base=True)
    with caplog.at_level(logging.WARNING):
        assert legend(scene) == ""
    assert "no gravity torque: robots.lwr: joint torques cannot hold" in caplog.text


def test_live_robot_has_a_legend_before_its_first_packet() -> None:
    robot = SerialRobot.from_model("lwr", show_arrows=True)
    sources = {"udp": {"kind": "udp", "port": 0, "structure": "7d"}}
    scene = Scene(robots=[robot], sources=sources, routes={"lwr.torques": "udp.values0"})
    assert legend(scene).startswith("round arrows: joint torque")


@pytest.mark.gl
def test_image_shows_gravity_torques_like_received_ones(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    found = []
    for scene, shown in (
        (lwr(joint_angles=BENT), {}),
        (lwr(joint_angles=BENT, torques=held()), {"modelled": "1"}),
        (lwr(joint_angles=BENT), {"arrows": "0"}),
    ):
        render_image(scene, path, shown=shown, **SMALL)
        found.append(np.asarray(Image.open(path)).astype(int))
    assert np.array_equal(found[0], found[1])
    assert (np.abs(found[0] - found[2]).max(axis=2) > 50).sum() > 300


@pytest.mark.gl
def test_video_shows_gravity_torques_in_every_frame(tmp_path: Path, monkeypatch) -> None:
    torques = []

    def noted(mirror: Mirror, renderer: Any, *rest: Any) -> Any:
        for pixels in drawn(mirror, renderer, *rest):
            torques.append(renderer.decor.toggles.modelled.all())
            yield pixels

    drawn = video_frames._draw
    monkeypatch.setattr(video_frames, "_draw", noted)
    render_video(lwr(joint_angles=BENT), tmp_path / "a.gif", duration=0.2, fps=10, **SMALL)
    assert torques == [True, True]


def test_page_contains_gravity_torques_with_their_label() -> None:
    found = capture(lwr(joint_angles=BENT, show_billboards=True))
    assert found.values["torques"][0] == pytest.approx(held())
    assert [line.head.split()[1] for line in found.lines[1]] == ["model"]
    assert found.legend[0].startswith("round arrows: gravity torque of the model")
