"""The struct view of `MjvScene`, the buffer, and the slow path that needs no layout."""

import logging

import mujoco
import numpy as np

from sero_mj.viewer.decor import scene_writer
from sero_mj.viewer.decor.geom_buffer import GEOM, GeomBuffer
from sero_mj.viewer.decor.scene_writer import SceneWriter, set_geom, struct_view


def a_scene(maxgeom: int = 50) -> mujoco.MjvScene:
    return mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), maxgeom)


def a_full_pen(count: int = 7) -> GeomBuffer:
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
        # The binding writes a C string; what was behind its end stays there.
        assert view["label"][i].split(b"\0")[0] == f"geom {i}".encode()
        np.testing.assert_array_equal(view["rgba"][i], scene.geoms[i].rgba)


def test_struct_view_leaves_the_scene_as_it_was() -> None:
    scene = a_scene()
    for i in (0, 49):  # MuJoCo leaves them as the memory was, in which there may be NaN
        start = np.full(3, 1.0 + i)
        mujoco.mjv_initGeom(
            scene.geoms[i], mujoco.mjtGeom.mjGEOM_BOX, start, start, np.eye(3).ravel(), np.ones(4)
        )
    before = [fields_of(scene.geoms[i]) for i in (0, 49)]
    struct_view(scene)
    assert [fields_of(scene.geoms[i]) for i in (0, 49)] == before


def test_struct_view_refuses_memory_that_is_laid_out_otherwise(monkeypatch, caplog) -> None:
    swapped = dict(GEOM.fields or {})
    offsets = [swapped[name][1] for name in GEOM.names or ()]
    names = list(GEOM.names or ())
    i, j = names.index("matid"), names.index("texid")
    offsets[i], offsets[j] = offsets[j], offsets[i]
    formats = [swapped[name][0] for name in names]
    other = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 256})
    monkeypatch.setattr(scene_writer, "GEOM", other)
    with caplog.at_level(logging.WARNING):
        assert struct_view(a_scene()) is None
    assert "mjvGeom has an unexpected memory layout; geoms are copied one by one" in caplog.text


def test_slow_and_fast_path_put_the_same_geoms_into_a_scene() -> None:
    buffer = a_full_pen()
    fast, slow = a_scene(), a_scene()
    fast_host, slow_host = SceneWriter(fast), SceneWriter(slow)
    assert fast_host._view is not None
    slow_host._view = None
    for host in (fast_host, slow_host):
        assert host.add(buffer) == 0
    assert fast.ngeom == slow.ngeom == 7
    for a, b in zip(fast.geoms[:7], slow.geoms[:7], strict=True):
        assert fields_of(a) == fields_of(b)


def test_a_host_appends_behind_what_is_there_and_says_what_found_no_room() -> None:
    scene = a_scene(10)
    host = SceneWriter(scene)
    scene.ngeom = 6
    scene.geoms[5].label = "kept"
    assert host.add(a_full_pen(7)) == 3
    assert scene.ngeom == 10
    assert scene.geoms[5].label == "kept"
    assert [g.label for g in scene.geoms[6:10]] == [f"label {i}" for i in range(4)]


def test_a_pen_gives_all_or_nothing_and_counts_what_is_left_out() -> None:
    buffer = GeomBuffer(capacity=10)
    assert len(buffer.take(8, 6)) == 8
    assert len(buffer.take(3, 6)) == 0
    assert (buffer.count, buffer.dropped) == (8, 3)
    assert len(buffer.take(2, 6)) == 2
    buffer.clear()
    assert (buffer.count, buffer.dropped) == (0, 0)


def test_a_pen_forgets_the_label_of_the_frame_before() -> None:
    buffer = GeomBuffer(capacity=20)
    buffer.take(7, int(mujoco.mjtGeom.mjGEOM_LABEL))["label"] = b"old"
    buffer.clear()
    assert (buffer.take(7, int(mujoco.mjtGeom.mjGEOM_BOX))["label"] == b"").all()


def test_decor_is_marked_as_such_and_throws_no_shadow() -> None:
    rows = a_full_pen().rows[:7]
    assert (rows["category"] == int(mujoco.mjtCatBit.mjCAT_DECOR)).all()
    assert (rows["castshadow"] == 0).all()
    assert (rows["segid"] == -1).all()


def test_set_geom_cuts_nothing_from_a_label_of_99_characters() -> None:
    rows = np.zeros(1, GEOM)
    rows["label"] = b"x" * 99
    geom = mujoco.MjvGeom()
    set_geom(geom, rows[0])
    assert geom.label == "x" * 99
