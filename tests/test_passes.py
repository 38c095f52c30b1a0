"""Segmentation and depth, against rays through the same pixels."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
from conftest import sampled
from foreign_models import arm
from PIL import Image

import sero_mj
from sero_mj.base.errors import RenderError
from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Object, Scene
from sero_mj.viewer.image.passes import palette, save_depth, save_segmentation
from sero_mj.viewer.image.render import HeadlessRenderer, render_image, render_video

POSE = np.deg2rad([30, 60, -40, 90, 50, -80, 20])
SIZE = (321, 240)
FAR = 60.0  # m; in images the floor ends at about this distance, for rays it is infinite


@pytest.fixture(scope="module")
def world() -> World:
    T = np.eye(4)
    T[:3, 3] = 0.6, 0.6, 0.15
    box = Object(name="crate", shape="box", size=[0.3, 0.3, 0.3], frame=T)
    double = Double(name="goal", of="lwr", joint_angles=POSE)
    robot = SerialRobot.from_model("lwr", show_arrows=True, show_axes=True, torques=[90.0] * 7)
    return World(Scene(robots=[robot], doubles=[double], objects=[box]))


@pytest.fixture(scope="module")
def data(world: World) -> mujoco.MjData:
    data = world.make_data()
    Placer(world).place(data)
    return data


@pytest.fixture(scope="module")
def renderer(world: World):
    with HeadlessRenderer(world, *SIZE) as renderer:
        yield renderer


def rays(renderer: HeadlessRenderer, data: mujoco.MjData, count: int = 1500):
    """Yields pixels (x, y), the geom hit by a ray through each (-1 for none), and its depth, m."""
    view, random = renderer.decor.view, np.random.default_rng(32)
    geom = np.full(1, -1, np.int32)
    for x, y in random.integers(0, SIZE, (count, 2)).tolist():
        direction = view.at(np.array([x + 0.5, SIZE[1] - y - 0.5]), 1.0) - view.position
        length = float(np.linalg.norm(direction))
        found = mujoco.mj_ray(
            renderer.world.model, data, view.position, direction / length, None, 1, -1, geom, None
        )
        yield x, y, int(geom[0]), found / length


@pytest.mark.gl
def test_every_pixel_is_the_part_hit_by_its_ray(renderer, data) -> None:
    parts, names = renderer.segmentation(data), renderer.part_names
    assert parts.shape == SIZE[::-1]
    assert parts.dtype == np.int32
    seen = set()
    for x, y, geom, depth in rays(renderer, data):
        picked = renderer.decor.pick(data, renderer.decor.from_above(x, y))
        name = names[parts[y, x]]
        if geom < 0 or depth > FAR:
            assert name in ("background", "floor")
            continue
        if picked is None:
            assert name == "floor"
        elif picked.kind in ("link", "double", "object"):  # no arrow or panel is in front
            assert name == picked.own_name
        seen.add(name)
    assert {"floor", "crate", "lwr/base", "lwr/link4", "goal/link5"} <= seen


@pytest.mark.gl
def test_depths_equal_those_of_rays(renderer, data) -> None:
    depth = renderer.depth(data)
    assert depth.shape == SIZE[::-1]
    assert depth.dtype == np.float32
    parts = renderer.segmentation(data)
    assert np.array_equal(np.isinf(depth), parts == 0)
    errors = [
        abs(depth[y, x] - along) / along
        for x, y, geom, along in rays(renderer, data)
        if geom >= 0 and along < FAR
    ]
    # At an edge, the ray may pass on the other side.
    assert np.quantile(errors, 0.995) < 1e-4
    assert np.median(errors) < 1e-6


@pytest.mark.gl
def test_parts_have_unique_names_and_cover_all_pixels(renderer, data) -> None:
    names = renderer.part_names
    assert names[0] == "background"
    assert len(set(names)) == len(names)
    links = [f"link{i}" for i in range(1, 8)]
    for owner in ("lwr", "goal"):
        assert {f"{owner}/{link}" for link in ["base", *links]} <= set(names)
    counts = np.bincount(renderer.segmentation(data).ravel(), minlength=len(names))
    assert counts.sum() == SIZE[0] * SIZE[1]
    assert counts[names.index("crate")] > 500


@pytest.mark.gl
def test_decor_and_hidden_doubles_are_in_no_pass(world, data) -> None:
    with HeadlessRenderer(world, *SIZE) as renderer:
        with_decor = renderer.segmentation(data), renderer.depth(data)
        renderer.toggles.arrows[:] = renderer.toggles.axes[:] = False
        for before, now in zip(
            with_decor, (renderer.segmentation(data), renderer.depth(data)), strict=True
        ):
            np.testing.assert_allclose(before, now, rtol=2e-5)
        renderer.toggles.doubles[:] = False
        shown = {renderer.part_names[i] for i in np.unique(renderer.segmentation(data))}
    assert not any(name.startswith("goal/") for name in shown)
    assert "lwr/link3" in shown


@pytest.mark.gl
def test_image_is_the_same_after_its_passes(world, data) -> None:
    with HeadlessRenderer(world, *SIZE) as renderer:
        renderer.render(data)
        before = renderer.render(data).copy()
        renderer.segmentation(data)
        renderer.depth(data)
        assert np.array_equal(renderer.render(data), before)


@pytest.mark.gl
@pytest.mark.parametrize("suffix", sampled([".png", ".npy"], 1))
def test_pass_files_contain_the_arrays(world, data, tmp_path, suffix: str) -> None:
    files = {which: tmp_path / f"{which}{suffix}" for which in ("segmentation", "depth")}
    for which, path in files.items():
        render_image(world.scene, path, size=SIZE, render_pass=which)
    with HeadlessRenderer(world, *SIZE) as renderer:
        parts, depth, names = renderer.segmentation(data), renderer.depth(data), renderer.part_names
    legend = json.loads((tmp_path / "segmentation.parts.json").read_text())
    assert [row["name"] for row in legend["parts"]] == list(names)
    assert [row["pixels"] for row in legend["parts"]] == np.bincount(
        parts.ravel(), minlength=len(names)
    ).tolist()
    if suffix == ".npy":
        assert np.array_equal(np.load(files["segmentation"]), parts)
        # The floor is drawn near the camera position of the last frame, so rounding differs.
        np.testing.assert_allclose(np.load(files["depth"]), depth, rtol=2e-5)
        return
    with Image.open(files["segmentation"]) as picture:
        assert picture.mode == "P"
        assert np.array_equal(np.asarray(picture), parts)
        colours = np.asarray(picture.convert("RGB"))
    for row in legend["parts"]:
        assert (colours[parts == row["id"]] == row["colour"]).all()
    with Image.open(files["depth"]) as picture:
        assert picture.info["Description"] == "depth in mm; 0 for no depth"
        mm = np.asarray(picture).astype(float)
    told = depth < 10
    assert np.abs(mm[told] / 1000 - depth[told]).max() < 0.00051
    assert (mm[~np.isfinite(depth)] == 0).all()


def test_part_colors_are_unique() -> None:
    assert len({tuple(colour) for colour in palette(256).tolist()}) == 256
    assert palette(3).tolist() == [[0, 0, 0], [128, 0, 0], [0, 128, 0]]  # as in PASCAL VOC


def test_many_parts_are_stored_in_16_bits_without_colors(tmp_path) -> None:
    parts = np.arange(600, dtype=np.int32).reshape(20, 30)
    legend = save_segmentation(tmp_path / "many.png", parts, [f"part{i}" for i in range(600)])
    with Image.open(tmp_path / "many.png") as picture:
        assert np.array_equal(np.asarray(picture), parts)
    assert json.loads(legend.read_text())["parts"][599]["colour"] is None


def test_depths_out_of_range_are_0_in_millimeters(tmp_path) -> None:
    save_depth(tmp_path / "far.png", np.array([[0.0004, 1.2346, 65.535, 65.6, np.inf]]))
    with Image.open(tmp_path / "far.png") as picture:
        assert np.asarray(picture).tolist() == [[0, 1235, 65535, 0, 0]]


def test_passes_are_not_written_in_lossy_formats(lwr, tmp_path) -> None:
    scene = Scene(robots=[lwr])
    for path in ("parts.jpg", "parts.webp"):
        with pytest.raises(RenderError, match=r"\.png or \.npy"):
            render_image(scene, tmp_path / path, render_pass="segmentation")
    with pytest.raises(RenderError, match="video compression changes the colors"):
        render_video(scene, tmp_path / "film.mp4", render_pass="depth")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.gl
def test_parts_of_a_third_party_model_have_its_names(tmp_path) -> None:
    model, own = arm(lift=0.8)
    double = Double(name="goal", of="arm", joint_angles=[0.0, -0.8, 0.3, 0.0])
    with sero_mj.overlay(model, own, doubles=[double]) as overlay:
        world = overlay.world
        with HeadlessRenderer(world, *SIZE) as renderer:
            renderer.toggles.wireframe = True  # for images, not for passes
            parts, names = renderer.segmentation(own), renderer.part_names
    counts = dict(zip(names, np.bincount(parts.ravel(), minlength=len(names)), strict=True))
    assert {"background", "arm/fore", "goal/fore", "cube", "ground"} <= counts.keys()
    assert min(counts[name] for name in ("arm/fore", "goal/fore", "arm/upper", "ground")) > 300
