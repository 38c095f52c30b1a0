"""The struct view of `MjvScene`, the geom buffer, and the scene writer."""

import mujoco
import numpy as np
import pytest

from sero_mj.base.errors import RenderError
from sero_mj.viewer.decor import scene_writer
from sero_mj.viewer.decor.geom_buffer import GEOM, GeomBuffer
from sero_mj.viewer.decor.scene_writer import SceneWriter, set_geom, struct_view


def a_scene(maxgeom: int = 50) -> mujoco.MjvScene:
    return mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), maxgeom)


def a_full_buffer(count: int = 7) -> GeomBuffer:
    rng = np.random.default_rng(0)
    buffer = GeomBuffer(capacity=20)
    rows = buffer.take(count, int(mujoco.mjtGeom.mjGEOM_BOX))
    for name in ("size", "pos", "mat", "rgba"):
        rows[name] = rng.uniform(0, 1, rows[name].shape)
    rows["label"] = [f"label {i}".encode() for i in range(count)]
    return buffer


def fields_of(geom: mujoco.MjvGeom) -> dict[str, object]:
    return {name: np.array(getattr(geom, name)).tolist() for name in GEOM.names or ()}


def test_struct_view_reads_what_the_binding_writes_in_every_geom() -> None:
    scene = a_scene()
    view = struct_view(scene)
    assert view is not None
    for i in (0, 1, 31, 49):
        mujoco.mjv_initGeom(
            scene.geoms[i],
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            np.array([0.1, 0.2, 0.3]),
            np.array([1.0, 2.0, i]),
            np.eye(3).ravel(),
            np.array([0.1, 0.2, 0.3, 0.4], np.float32),
        )
        scene.geoms[i].label = f"geom {i}"
        assert view["type"][i] == int(mujoco.mjtGeom.mjGEOM_CAPSULE)
        assert view["pos"][i].tolist() == [1.0, 2.0, i]
        # The binding writes a C string, and bytes after its end remain.
        assert view["label"][i].split(b"\0")[0] == f"geom {i}".encode()
        np.testing.assert_array_equal(view["rgba"][i], scene.geoms[i].rgba)


def test_struct_view_does_not_change_the_scene() -> None:
    scene = a_scene()
    for i in (0, 49):  # MuJoCo leaves this memory uninitialized, so it may contain NaN
        start = np.full(3, 1.0 + i)
        mujoco.mjv_initGeom(
            scene.geoms[i], mujoco.mjtGeom.mjGEOM_BOX, start, start, np.eye(3).ravel(), np.ones(4)
        )
    before = [fields_of(scene.geoms[i]) for i in (0, 49)]
    struct_view(scene)
    assert [fields_of(scene.geoms[i]) for i in (0, 49)] == before


def test_struct_view_rejects_another_memory_layout(monkeypatch) -> None:
    swapped = dict(GEOM.fields or {})
    offsets = [swapped[name][1] for name in GEOM.names or ()]
    names = list(GEOM.names or ())
    i, j = names.index("matid"), names.index("texid")
    offsets[i], offsets[j] = offsets[j], offsets[i]
    formats = [swapped[name][0] for name in names]
    other = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 256})
    monkeypatch.setattr(scene_writer, "GEOM", other)
    with pytest.raises(RenderError, match="unexpected memory layout"):
        struct_view(a_scene())


def test_scene_writer_appends_geoms_and_returns_the_number_dropped() -> None:
    scene = a_scene(10)
    host = SceneWriter(scene)
    scene.ngeom = 6
    scene.geoms[5].label = "kept"
    assert host.add(a_full_buffer(7)) == 3
    assert scene.ngeom == 10
    assert scene.geoms[5].label == "kept"
    assert [g.label for g in scene.geoms[6:10]] == [f"label {i}" for i in range(4)]


def test_buffer_allocates_all_rows_or_none_and_counts_dropped_ones() -> None:
    buffer = GeomBuffer(capacity=10)
    assert len(buffer.take(8, 6)) == 8
    assert len(buffer.take(3, 6)) == 0
    assert (buffer.count, buffer.dropped) == (8, 3)
    assert len(buffer.take(2, 6)) == 2
    buffer.clear()
    assert (buffer.count, buffer.dropped) == (0, 0)


def test_clearing_a_buffer_clears_labels() -> None:
    buffer = GeomBuffer(capacity=20)
    buffer.take(7, int(mujoco.mjtGeom.mjGEOM_LABEL))["label"] = b"old"
    buffer.clear()
    assert (buffer.take(7, int(mujoco.mjtGeom.mjGEOM_BOX))["label"] == b"").all()


def test_decor_has_its_category_and_casts_no_shadow() -> None:
    rows = a_full_buffer().rows[:7]
    assert (rows["category"] == int(mujoco.mjtCatBit.mjCAT_DECOR)).all()
    assert (rows["castshadow"] == 0).all()
    assert (rows["segid"] == -1).all()


def test_set_geom_stores_labels_of_99_characters() -> None:
    rows = np.zeros(1, GEOM)
    rows["label"] = b"x" * 99
    geom = mujoco.MjvGeom()
    set_geom(geom, rows[0])
    assert geom.label == "x" * 99
