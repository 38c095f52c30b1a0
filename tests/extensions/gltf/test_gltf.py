"""glTF files of scenes and runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from sero_mj.extensions.gltf import export
from sero_mj.extensions.gltf.export import write_glb
from sero_mj.load import load_scene
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.player.capture import capture

pygltflib = pytest.importorskip("pygltflib")


def test_glb_file_has_an_animated_node_for_each_visible_body(tmp_path: Path) -> None:
    found = capture(load_scene("impedance_push"), fps=10, begin=1.0, seconds=0.5)
    write_glb(found, tmp_path / "push.glb")
    gltf = pygltflib.GLTF2().load(str(tmp_path / "push.glb"))
    names = {node.name for node in gltf.nodes}
    assert {"world", "lwr/link1", "lwr/link7"} <= names
    moved = {gltf.nodes[c.target.node].name for c in gltf.animations[0].channels}
    assert "lwr/link3" in moved and "world" not in moved
    assert gltf.accessors[gltf.animations[0].samplers[0].input].count == found.frames


def test_mesh_shared_by_geoms_is_written_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = '<mujoco><asset><mesh name="m" builtin="sphere" params="2"/></asset><worldbody>'
    ball += '<geom type="mesh" mesh="m"/>' * 3 + "</worldbody></mujoco>"
    scene = Scene(objects=[Object(name="ball", mjcf=ball)])
    corners, made = export._corners, []
    monkeypatch.setattr(
        export, "_corners", lambda model, geom: made.append(geom) or corners(model, geom)
    )
    write_glb(capture(scene), tmp_path / "ball.glb")
    assert len(made) == 1
    # Meshes with different names are often equal, too.
    found = capture(load_scene("justin"), seconds=0.0, wait=0.0)
    write_glb(found, tmp_path / "justin.glb")
    gltf = pygltflib.GLTF2().load(str(tmp_path / "justin.glb"))
    assert len(gltf.meshes) < 0.7 * len(found.geoms)
