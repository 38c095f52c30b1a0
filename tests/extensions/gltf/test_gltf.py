"""glTF files of scenes and runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from decor_tools import belonging, toggles_of, vertices_of, view_at

from sero_mj.extensions.gltf import export
from sero_mj.extensions.gltf.export import write_glb
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
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


def test_round_arrows_are_where_python_draws_them(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    robot = SerialRobot.from_model(
        "lwr", torques=[0, 80.0, -30.0, 150.0, 0, 0, 0], show_arrows=True,
        joint_angles=[0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2],
    )  # fmt: skip
    scene = Scene(robots=[robot], floor=False)
    write_glb(capture(scene), tmp_path / "arrows.glb")
    world = World(scene)
    buffer = Decor(world).draw(world.make_data(), toggles_of(world), view_at())
    rows = belonging(buffer, Kind.ARROW)
    assert len(rows) == 3 + 1  # one is striped
    loaded = trimesh.load(tmp_path / "arrows.glb")
    bounds = []
    for node in loaded.graph.nodes_geometry:
        pose, name = loaded.graph[node]
        points = trimesh.transform_points(loaded.geometry[name].vertices, pose)
        bounds.append(np.array([points.min(axis=0), points.max(axis=0)]))
    for row in rows:
        x, y, z = vertices_of(row).T  # y is up in glTF
        points = np.stack([x, z, -y], axis=1)
        exact = np.array([points.min(axis=0), points.max(axis=0)])
        assert min(np.abs(each - exact).max() for each in bounds) < 1e-4


def test_arrows_rotate_and_change_their_width_in_a_run(tmp_path: Path) -> None:
    found = capture(load_scene("impedance_push"), fps=10, begin=1.0, seconds=1.0)
    write_glb(found, tmp_path / "push.glb")
    gltf = pygltflib.GLTF2().load(str(tmp_path / "push.glb"))
    arrows = {
        child for node in gltf.nodes if node.name in ("lwr/link2", "lwr/link4")
        for child in node.children if gltf.nodes[child].scale is not None
    }  # fmt: skip
    assert arrows
    channels = gltf.animations[0].channels
    assert {"rotation", "scale"} == {c.target.path for c in channels if c.target.node in arrows}
