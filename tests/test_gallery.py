"""The gallery: its page matches its list, and all included robots are shown."""

from __future__ import annotations

from types import ModuleType

import pytest
from conftest import ROOT, import_script

from sero_mj.base import paths
from sero_mj.viewer.image.render import render_image


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    return import_script(ROOT / "docs" / "gallery.py")


def test_page_and_images_match_the_list(gallery):
    names = [shot.name for shot in gallery.SHOTS]
    assert len(set(names)) == len(names)
    assert {path.stem for path in gallery.PICTURES.glob("*.webp")} == {*names}
    assert gallery.PAGE.read_text("utf-8") == gallery.make_page(), "run make gallery"


@pytest.mark.thorough
def test_every_shot_has_a_scene_and_every_shipped_robot_is_shown(gallery):
    shown = set()
    for shot in gallery.SHOTS:
        scene = gallery.scene_of(shot)
        shown |= {robot._model.parent.name for robot in scene.robots.values() if robot._model}
        if shot.holds_itself:
            assert any(abs(robot.torques).max() > 0.1 for robot in scene.robots.values())
    assert shown == {*paths.list_models()}


@pytest.mark.gl
def test_shot_renders_its_image(gallery, tmp_path):
    (shot,) = [shot for shot in gallery.SHOTS if shot.name == "flange_check"]
    file = tmp_path / "flange_check.png"
    render_image(gallery.scene_of(shot), file, size=(300, 220), camera=shot.camera, quality="draft")
    assert file.stat().st_size > 5000
