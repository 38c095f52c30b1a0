"""The meshes of arrows and axes: closed, exactly as wide as declared, close to the ideal shape."""

import mujoco
import numpy as np
import pytest
from decor_tools import belonging, toggles_of, vertices_of, view_at, world_of

from sero_mj.viewer.decor.arrow_shapes import (
    AXIS,
    BANDS,
    COARSE,
    COPIES,
    HEAD,
    RATIOS,
    SHAFT,
    THICK,
    THIN,
    Detail,
    depth_of,
    nearest_ratio,
    round_arrow,
    round_bands,
    shapes,
    shapes_model,
)
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import FIRST_SHAPE, Kind
from sero_mj.viewer.decor.scene_writer import SceneWriter

POSES = np.array(
    [[0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2], [0] * 7, [1.0, 0.9, -0.6, -1.3, 0.8, -0.9, 0.0]]
)


def normals_of(vertices, faces):
    """Returns normals of faces, as long as twice their areas."""
    first, second, third = vertices[faces.T]
    return np.cross(second - first, third - first)


def shape_of(ratio: float):
    """Returns the round arrow of a ratio, and its numbers of faces."""
    detail = THIN if ratio < 0.17 else THICK
    return round_arrow(ratio, detail), detail


@pytest.mark.parametrize("detail", [None, COARSE])
def test_faces_have_areas_and_point_outward(detail: Detail | None) -> None:
    for k, (vertices, faces) in enumerate(shapes(detail)):
        normals = normals_of(vertices, faces)
        assert np.linalg.norm(normals, axis=1).min() > 1e-8
        edges = {(a, b) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
        assert len(edges) == 3 * len(faces)  # neighbors have the same orientation
        if k < BANDS or k in (SHAFT, HEAD, AXIS):
            # Volume by the divergence theorem, with the open ends, which are tiny.
            volume = np.einsum("fi,fi->", vertices[faces[:, 0]], normals) / 6
            assert 1e-4 < volume < np.ptp(vertices, axis=0).prod()


@pytest.mark.parametrize("ratio", [*RATIOS[::4].tolist(), 0.45])
def test_tube_is_as_wide_as_declared_and_tapers_toward_its_tail(ratio: float) -> None:
    (vertices, _), detail = shape_of(ratio)
    tube = vertices[: (detail.tail + detail.tube + 1) * detail.sides]
    tube = tube.reshape(-1, detail.sides, 3)
    widths = np.ptp(tube[:, :, 2], axis=1)
    assert widths.max() == widths[-1] == pytest.approx(ratio, rel=1e-12)
    assert (np.diff(widths) > 0).all()
    out = np.hypot(tube[..., 0], tube[..., 1])
    assert np.ptp(out[-1]) == pytest.approx(float(depth_of(ratio)), rel=1e-12)
    middles = (out.max(axis=1) + out.min(axis=1)) / 2
    assert middles == pytest.approx(np.full(len(tube), middles[0]))  # it follows a circle
    assert 0.95 < middles[0] < 1.6
    # The head is wider, ends in a point, and is on the other side of the tail.
    head = vertices[len(tube.reshape(-1, 3)) : len(vertices) // COPIES]
    assert np.ptp(head[:, 2]) > max(1.7 * ratio, 0.05)
    ahead = np.arctan2(head[:, 1], head[:, 0])
    assert ahead.max() == pytest.approx(np.deg2rad(104), abs=0.02)  # less a small opening
    # The next tubes are the first one, rotated by 120 and 240 degrees.
    tubes = np.split(vertices, COPIES)
    for k, each in enumerate(tubes):
        cos, sin = np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3)
        turned = tubes[0] @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
        assert each == pytest.approx(turned, abs=1e-12)


def test_depth_and_heads_grow_with_the_width() -> None:
    extents = np.array([np.ptp(shape_of(ratio)[0].vertices, axis=0) for ratio in RATIOS])
    assert (np.diff(extents, axis=0) > 0).all()
    assert (np.diff(depth_of(RATIOS)) > 0).all()


@pytest.mark.parametrize("ratio", [0.03, 0.14, 0.18, 0.23, 0.45])
def test_surface_is_within_a_pixel_of_the_ideal_at_200_pixels(ratio: float) -> None:
    ideal, ideal_faces = round_arrow(ratio, Detail(48, 64, 12, 96, 24))
    normals = normals_of(ideal, ideal_faces)
    at_vertices = np.zeros_like(ideal)
    for corner in ideal_faces.T:
        np.add.at(at_vertices, corner, normals)
    at_vertices /= np.linalg.norm(at_vertices, axis=1, keepdims=True)
    (vertices, faces), detail = shape_of(ratio)
    pixel = np.ptp(vertices[:, 0]) / 200
    tube, back = 2 * detail.sides * (detail.tail + detail.tube), 2 * detail.head_sides
    curved = np.delete(faces[: len(faces) // COPIES], slice(tube, tube + back), axis=0)
    points = vertices[curved].mean(axis=1)  # flat faces are farthest there
    edges = vertices[curved[:, :2]].mean(axis=1)
    for part in np.array_split(np.concatenate([points, edges]), 8):
        apart = ((part[:, None] - ideal) ** 2).sum(axis=2)
        nearest = apart.argmin(axis=1)
        off = np.einsum("pi,pi->p", part - ideal[nearest], at_vertices[nearest])
        assert np.abs(off).max() < pixel


def test_bands_enclose_the_tube_without_a_visible_step() -> None:
    for ratio in RATIOS[::5].tolist():
        distance = 0.006 * ratio
        bands, arrow = round_bands(ratio, THICK).vertices, round_arrow(ratio, THICK).vertices
        nearest = np.sqrt(((bands[:, None] - arrow) ** 2).sum(axis=2).min(axis=1))
        assert nearest.max() == pytest.approx(distance / 2, rel=1e-6)


def test_nearest_ratio_is_within_13_percent_and_stops_at_the_ends() -> None:
    ratios = np.geomspace(RATIOS[0], RATIOS[-1], 400)
    assert np.abs(np.log(RATIOS[nearest_ratio(ratios)] / ratios)).max() < np.log(1.14)
    assert nearest_ratio(np.array([0.0, 1e-3, 5.0])).tolist() == [0, 0, len(RATIOS) - 1]


def test_model_has_the_vertices_and_normals_of_the_shapes() -> None:
    model = shapes_model()
    assert model.nmesh == len(shapes())
    for k, (vertices, faces) in enumerate(shapes()):
        first, count = model.mesh_vertadr[k], model.mesh_vertnum[k]
        assert model.mesh_vert[first : first + count] == pytest.approx(vertices, abs=1e-6)
        first, count = model.mesh_faceadr[k], model.mesh_facenum[k]
        assert (model.mesh_face[first : first + count] == faces).all()
        corners = model.mesh_facenormal[first : first + count]
        smooth = model.mesh_normal[model.mesh_normaladr[k] :][corners].mean(axis=1)
        flat = normals_of(vertices, faces)
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        assert np.einsum("fi,fi->f", smooth, flat).min() > 0.5


def test_scene_without_the_meshes_gets_triangles_of_the_same_size() -> None:
    world = world_of(torques=np.full(7, 150.0), show_arrows=True, joint_angles=POSES[0])
    buffer = Decor(world).draw(world.make_data(), toggles_of(world), view_at())
    arrows = belonging(buffer, Kind.ARROW)
    scene = mujoco.MjvScene(world.model, 5000)
    assert SceneWriter(scene).add(buffer, with_text=False) == 0
    corners, types = [], set()
    for geom in scene.geoms[: scene.ngeom]:
        types.add(geom.type)
        edges = geom.mat * geom.size
        corners.append(geom.pos + np.array([0 * geom.pos, edges[:, 0], edges[:, 1]]))
    assert types == {int(mujoco.mjtGeom.mjGEOM_TRIANGLE)}
    assert len(corners) < 200 * len(arrows)
    points = np.concatenate(corners)
    exact = np.concatenate([vertices_of(row) for row in arrows])
    assert points.min(axis=0) == pytest.approx(exact.min(axis=0), abs=0.01)
    assert points.max(axis=0) == pytest.approx(exact.max(axis=0), abs=0.01)


def test_written_mesh_geoms_have_exact_scales() -> None:
    world = world_of(torques=[20.0] + [0.0] * 6, show_arrows=True)
    buffer = Decor(world).draw(world.make_data(), toggles_of(world), view_at())
    (arrow,) = belonging(buffer, Kind.ARROW)
    scene = mujoco.MjvScene(world.model, 100)
    SceneWriter(scene, 1000).add(buffer, with_text=False)
    (geom,) = scene.geoms[: scene.ngeom]
    assert geom.dataid == 1000 + 2 * (arrow["dataid"] - FIRST_SHAPE)
    assert np.linalg.norm(geom.mat, axis=0) == pytest.approx(arrow["size"], rel=1e-6)


def test_a_head_of_each_arrow_is_visible_in_95_percent_of_moments() -> None:
    """A head is visible if the robot hides at most two thirds of its vertices."""
    seen = []
    for pose in POSES:
        world = world_of(torques=np.full(7, 9.0), show_arrows=True, joint_angles=pose)
        data, decor, toggles = world.make_data(), Decor(world), toggles_of(world)
        for time in np.arange(6) * np.pi / 1.6 / 6 + 0.1:
            data.time = time
            rows = belonging(decor.draw(data, toggles, view_at()), Kind.ARROW)
            for azimuth in np.arange(5) * 2 * np.pi / 5 + time:
                for height in (0.3, 1.5):
                    eye = np.array([2.0 * np.cos(azimuth), 2.0 * np.sin(azimuth), height])
                    seen += [sees_a_head(world.model, data, eye, row) for row in rows]
    assert np.mean(seen) > 0.95


def sees_a_head(model: mujoco.MjModel, data: mujoco.MjData, eye, row) -> bool:
    geom = np.zeros(1, np.int32)
    vertices = vertices_of(row).reshape(COPIES, -1, 3)
    for head in vertices[:, -THIN.head * THIN.head_sides :: 4]:
        ways = head - eye
        distances = np.linalg.norm(ways, axis=1)
        free = 0
        for way, distance in zip(ways, distances, strict=True):
            hit = mujoco.mj_ray(model, data, eye, way / distance, None, 1, -1, geom, None)
            free += hit < 0 or hit > distance - 1e-3
        if 3 * free > len(head):
            return True
    return False
