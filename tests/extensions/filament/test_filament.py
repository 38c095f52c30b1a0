"""Filament images: the geoms, colors and clicks of the classic renderer, or a reason."""

from __future__ import annotations

import colorsys
import logging
import os
import subprocess
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with

from sero_mj import Double, HeadlessRenderer, Placer, Scene, SerialRobot, World
from sero_mj.base.errors import RenderError
from sero_mj.base.paths import list_scenes
from sero_mj.extensions.filament import probe as filament_probe
from sero_mj.extensions.filament.environment import environment
from sero_mj.extensions.filament.flat_triangles import blend
from sero_mj.extensions.filament.geoms import glow
from sero_mj.extensions.filament.probe import filament_problem, reason_of
from sero_mj.extensions.filament.renderer import FilamentRenderer
from sero_mj.extensions.photo.over import PhotoRenderer
from sero_mj.load import load_scene
from sero_mj.robots.declared.surroundings import PALETTES
from sero_mj.viewer.image import renderer as renderer_choice
from sero_mj.viewer.image.sky_light import linear, shown

pytestmark = pytest.mark.gl

SIZE = (320, 200)
POSE = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]
TORQUES = [100.0, -140.0, 60.0, 80.0, -60.0, 30.0, 30.0]
NO_DRIVER = {"VK_ICD_FILENAMES": "/nowhere.json", "VK_DRIVER_FILES": "/nowhere.json"}
_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_FLAGS = mujoco.mjtRndFlag


@pytest.fixture(scope="module", autouse=True)
def _runs() -> None:
    problem = filament_problem()
    if problem is not None:
        pytest.skip(f"Filament does not run: {problem}")


@pytest.fixture(scope="module")
def world() -> World:
    robot = SerialRobot.from_model("lwr", joint_angles=POSE, torques=TORQUES, show_arrows=True)
    return World(Scene(robots=[robot], doubles=[Double(name="goal", of="lwr")]))


@pytest.fixture(scope="module")
def data(world: World) -> mujoco.MjData:
    found = world.make_data()
    world.set_input(found, "goal.joint_angles", [0.9, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0])
    Placer(world).place(found)
    return found


@pytest.fixture(scope="module")
def pair(world: World) -> Any:
    """Yields the classic renderer and Filament's of one world."""
    with (
        HeadlessRenderer(world, *SIZE) as classic,
        HeadlessRenderer(world, *SIZE, renderer="filament") as filament,
    ):
        assert (classic.renderer, filament.renderer) == ("classic", "filament")
        yield classic, filament


def silhouette(renderer: HeadlessRenderer, data: mujoco.MjData) -> np.ndarray:
    """Returns where links are white in the light of the scene on black, (height, width) bool."""
    renderer._look(data)
    inner, model = renderer._renderer, renderer.world.model
    scene = inner.scene
    for flag in (_FLAGS.mjRND_SKYBOX, _FLAGS.mjRND_HAZE, _FLAGS.mjRND_SHADOW):
        scene.flags[flag] = 0
    for geom in scene.geoms[: scene.ngeom]:
        of_model = geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid >= 0
        is_link = of_model and model.geom_type[geom.objid] != mujoco.mjtGeom.mjGEOM_PLANE
        geom.matid, geom.emission = -1, 1.0
        geom.rgba = np.array([1.0, 1.0, 1.0, float(is_link and geom.rgba[3] == 1.0)])
    return np.asarray(inner.render().max(axis=2) > 90)


def assert_same_silhouette(world: World) -> None:
    data = world.make_data()
    Placer(world).place(data)
    found = []
    for name in ("classic", "filament"):
        with HeadlessRenderer(world, 1280, 800, renderer=name) as renderer:  # type: ignore[arg-type]
            found.append(silhouette(renderer, data))
    union = (found[0] | found[1]).sum()
    assert union > 2000
    assert (found[0] & found[1]).sum() / union >= 0.99


def test_link_silhouettes_equal_those_of_the_classic_renderer(world: World) -> None:
    assert_same_silhouette(world)


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(list_scenes()))
def test_link_silhouettes_of_shipped_scenes_equal_those_of_the_classic_renderer(name: str) -> None:
    assert_same_silhouette(World(load_scene(name)))


def test_arrows_have_their_declared_colors(
    world: World, data: mujoco.MjData, pair: tuple[HeadlessRenderer, HeadlessRenderer]
) -> None:
    for each in pair:
        each.toggles.doubles[:] = False
        each.toggles.legend = False
    classic, filament = (each.render(data).astype(int) for each in pair)
    rows = pair[1].decor.buffer.rows[: pair[1].decor.buffer.count]
    for colour in np.unique(rows["rgba"][rows["rgba"][:, 3] == 1.0], axis=0)[:, :3]:
        near = np.abs(filament - np.rint(255 * colour)).max(axis=2) <= 25  # they are shaded
        assert near.sum() > 40, colour
        hue = colorsys.rgb_to_hsv(*colour)[0]
        for picture in (classic, filament):
            hues = [colorsys.rgb_to_hsv(*pixel)[0] for pixel in picture[near] / 255]
            apart = 360 * abs(float(np.median(hues)) - hue)
            assert apart <= 6.0, (colour, apart)
    # Arrows have no halo: edges are between the colors on both sides.
    assert (filament.min(axis=2) > np.maximum(classic.min(axis=2), 245)).sum() == 0


@pytest.mark.thorough
def test_doubles_look_like_those_of_the_classic_renderer(
    world: World, data: mujoco.MjData, pair: tuple[HeadlessRenderer, HeadlessRenderer]
) -> None:
    pictures = []
    for each in pair:
        each.toggles.legend = each.toggles.arrows[:] = False
        shown = []
        for on in (True, False):
            each.toggles.doubles[:] = on
            shown.append(each.render(data).astype(int))
        pictures.append(shown)
    is_double = np.logical_and(
        *[np.abs(shown[0] - shown[1]).max(axis=2) > 30 for shown in pictures]
    )
    assert is_double.sum() > 500
    classic, filament = (shown[0][is_double].mean(axis=0) for shown in pictures)
    assert np.abs(classic - filament).max() < 28  # which are lit from other directions
    hues = [360 * colorsys.rgb_to_hsv(*(mean / 255))[0] for mean in (classic, filament)]
    assert abs(hues[0] - hues[1]) <= 3.0
    # Their links cast no shadow, as in the classic renderer.
    apart = [np.abs(shown[0] - shown[1]).max(axis=2) > 12 for shown in pictures]
    assert (apart[1] & ~apart[0]).sum() < 0.05 * apart[0].sum()


def test_opacity_applies_to_display_colors() -> None:
    light, opacity = glow((0.2, 0.7, 0.4, 0.36), False)
    for grey in (0.55, 0.7, 0.9):
        seen = shown(np.array(light) + (1 - opacity) * linear(np.full(3, grey)))
        # The classic renderer blends twice.
        expected = 0.64**2 * grey + (1 - 0.64**2) * np.array([0.2, 0.7, 0.4])
        assert np.abs(seen - expected).max() < 0.08
    assert glow((0.25, 0.5, 0.75, 1.0), False)[1] == 1.0


def test_clicks_pick_the_same_items(
    data: mujoco.MjData, pair: tuple[HeadlessRenderer, HeadlessRenderer]
) -> None:
    for each in pair:
        each.toggles.arrows[:] = each.toggles.doubles[:] = True
    hits = set()
    for x in range(60, 260, 12):
        for y in range(10, 190, 12):
            picked = [each.pick(data, x, y) for each in pair]
            assert picked[0] == picked[1]
            hits.add(None if picked[0] is None else picked[0].kind)
    assert len(hits) > 2


@pytest.mark.parametrize(
    "stereo", ["side-by-side", pytest.param("anaglyph", marks=pytest.mark.thorough)]
)
def test_stereo_images_equal_those_of_the_classic_renderer(
    world: World, data: mujoco.MjData, stereo: Any
) -> None:
    pictures = []
    for name in ("classic", "filament"):
        with HeadlessRenderer(world, *SIZE, stereo=stereo, renderer=name) as renderer:  # type: ignore[arg-type]
            pictures.append(renderer.render(data).astype(int))
    assert np.abs(pictures[0] - pictures[1]).mean() < 20  # floors differ by 20
    if stereo == "side-by-side":
        apart = [np.abs(each[:, : SIZE[0] // 2] - each[:, SIZE[0] // 2 :]) for each in pictures]
        assert apart[1].mean() == pytest.approx(apart[0].mean(), rel=0.3)


@pytest.mark.thorough
def test_photo_is_visible_and_the_robot_hides_decor(world: World, data: mujoco.MjData) -> None:
    from photos import camera

    by = camera("none")
    noise = np.random.default_rng(1).integers(0, 256, (by.height, by.width, 3), dtype=np.uint8)
    changed, pictures = [], []
    for name in ("classic", "filament"):
        with PhotoRenderer(world, by, renderer=name) as renderer:  # type: ignore[arg-type]
            assert renderer.renderer == name
            renderer.toggles.legend = False
            renderer.toggles.doubles[:] = True
            pictures.append(renderer.render(data, noise).astype(int))
        changed.append(np.abs(pictures[-1] - noise).max(axis=2) > 8)
    # Edges one pixel wide are antialiased differently.
    assert (changed[0] & changed[1]).sum() / (changed[0] | changed[1]).sum() > 0.9
    assert np.abs(pictures[1] - noise)[~changed[1]].mean() < 1.0


def test_fine_images_use_filament_and_others_the_classic_renderer(world: World) -> None:
    for quality, renderer, expected in (
        ("fine", None, "filament"), ("normal", None, "classic"), ("draft", None, "classic"),
        ("fine", "classic", "classic"), ("draft", "filament", "filament"),
    ):  # fmt: skip
        assert renderer_choice.choose_renderer(renderer, quality, 64, 48) == expected  # type: ignore[arg-type]
    with raises_with(RenderError, key="renderer", found="opengl", expected="classic, filament"):
        HeadlessRenderer(world, 64, 48, renderer="opengl")  # type: ignore[arg-type]


def test_missing_driver_falls_back_to_classic_with_a_warning(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
) -> None:
    for name, value in NO_DRIVER.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(filament_probe, "_file", lambda: tmp_path / "filament.json")
    renderer_choice._warn.cache_clear()
    for quality in ("normal", "fine", "fine"):
        with HeadlessRenderer(world, 64, 48, quality=quality, renderer="filament") as renderer:  # type: ignore[arg-type]
            assert renderer.renderer == "classic"
            assert np.ptp(renderer.render(world.make_data())) > 50
    said = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(said) == 1
    text = said[0].getMessage()
    assert "Vulkan" in text and "apt install libvulkan1 mesa-vulkan-drivers" in text
    # The result is cached: no process is started again.
    filament_probe._problem.cache_clear()
    monkeypatch.setattr(subprocess, "run", None)
    assert "no Vulkan driver" in (filament_problem() or "")
    renderer_choice._warn.cache_clear()


def test_probe_is_repeated_if_its_result_cannot_be_cached(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "file" / "filament.json"
    file.parent.write_text("no folder")
    monkeypatch.setattr(filament_probe, "_file", lambda: file)
    monkeypatch.setattr(filament_probe, "_try", lambda width, height: f"{width}x{height}")
    filament_probe._problem.cache_clear()
    assert filament_problem() == "64x64"
    # Every size beyond the limits of all drivers is tried.
    assert filament_problem(5000, 100) == "5000x100"
    filament_probe._problem.cache_clear()
    file.parent.unlink()
    file.parent.mkdir()
    file.write_text("[no JSON")
    assert filament_problem(4096, 4096) == "64x64"
    filament_probe._problem.cache_clear()


@pytest.mark.parametrize(
    ("stderr", "status", "reason"),
    [
        ("libc++abi: terminating\nin createVkInstance:985\nreason: Unable to create Vulkan "
         "instance. error=-9\n", -6,
         "no Vulkan driver (Unable to create Vulkan instance. error=-9)"),
        ("Traceback\n  File\nsero_mj.base.errors.RenderError: the rendered image is empty\n", 1,
         "sero_mj.base.errors.RenderError: the rendered image is empty"),
        ("", -11, "the test process ended with status -11"),
    ],
)  # fmt: skip
def test_failure_reason_is_one_line(stderr: str, status: int, reason: str) -> None:
    assert reason_of(stderr, status) == reason


def draw(xml: str, size: tuple[int, int] = (64, 48)) -> np.ndarray:
    """Returns an image of a model."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    renderer = FilamentRenderer(model, *size)
    mujoco.mjv_defaultFreeCamera(model, camera)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, _ALL, renderer.scene)
    renderer.follow(data)
    pixels = renderer.render()
    renderer.close()
    return pixels


def test_unknown_or_invalid_options_are_reported_and_ignored(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pixels = draw(
        "<mujoco><custom><numeric name='filament.cg.slope' data='1'/>"
        "<numeric name='filament.shine' data='1'/></custom>"
        "<worldbody><geom size='.2'/></worldbody></mujoco>"
    )
    assert np.ptp(pixels) > 50
    assert [record.getMessage() for record in caplog.records] == [
        "filament.cg.slope: found 1; expected 3 finite numbers",
        "unknown option 'filament.shine' of MuJoCo's Filament renderer is ignored",
    ]


def test_nothing_is_printed_on_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    draw("<mujoco><worldbody><geom size='.2'/></worldbody></mujoco>")
    assert capfd.readouterr().out == ""


@pytest.mark.thorough
def test_ten_thousand_geoms_and_every_kind_of_surface_are_drawn() -> None:
    kinds = ("box", "sphere", "capsule", "cylinder", "ellipsoid")
    many = "".join(
        f"<geom type='{kinds[k % 5]}' size='.02 .02 .02' pos='{k % 100 * 0.06} {k // 100 * 0.06} 0'"
        f" rgba='{k % 7 / 7} {k % 11 / 11} {k % 13 / 13} 1'/>"
        for k in range(10_000)
    )
    assert np.ptp(draw(f"<mujoco><worldbody>{many}</worldbody></mujoco>")) > 50
    surfaces = """
      <mujoco><asset><mesh name='a' vertex='0 0 0 1 0 0 0 1 0 0 0 1'/>
      <hfield name='h' nrow='3' ncol='3' size='1 1 .3 .1' elevation='0 1 0 1 0 1 0 1 0'/>
      <texture name='t' type='2d' builtin='checker' rgb1='1 0 0' rgb2='0 1 0' width='64'
        height='64'/><material name='m' texture='t' metallic='1' roughness='.3'/>
      <material name='n' reflectance='.5'/></asset><worldbody>
      <geom type='mesh' mesh='a' material='m'/><geom type='hfield' hfield='h' pos='0 0 -1'/>
      <geom type='plane' size='2 2 .1' material='n' pos='0 0 -1'/><site size='.1' pos='1 1 1'/>
      <light pos='0 0 3' dir='0 0 -1'/><light dir='0 0 -1' type='directional'/>
      <light dir='0 -.3 -1' type='directional'/><light pos='1 2 3' type='point'/>
      </worldbody></mujoco>"""
    assert np.ptp(draw(surfaces, (160, 120))) > 100


@pytest.mark.thorough
def test_memory_does_not_grow_over_frames(world: World, data: mujoco.MjData) -> None:
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("Linux")

    def megabytes() -> float:
        return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

    with HeadlessRenderer(world, *SIZE, renderer="filament", frames=5000) as renderer:
        seen = []
        for k in range(300):
            world.set_input(data, "lwr.torques", np.array(TORQUES) * np.sin(0.1 * k))
            renderer.render(data)
            seen.append(megabytes())
    assert seen[-1] - seen[180] < 15  # driver buffers fill up before


def test_leaders_are_smooth_to_their_tips() -> None:
    picture = np.full((40, 200, 3), 200, np.uint8)
    triangle = np.array([[[10.0, 18.0], [10.0, 22.0], [190.0, 20.3]]])
    blend(picture, triangle, np.array([[0.0, 0.0, 0.0, 1.0]]))
    covered = (200.0 - picture[..., 0]).sum(axis=0) / 200.0
    expected = 4.0 * (190.0 - (np.arange(200) + 0.5)) / 180.0
    inside = slice(12, 188)
    assert np.abs(covered[inside] - expected[inside]).max() < 0.15
    assert (picture[:, 200 - 5 :] == 200).sum() > 0


def test_light_of_the_sky_has_no_tint() -> None:
    for look, palette in PALETTES.items():
        file = environment(look, palette)
        start = file.index(b"sh\0") + 3
        rows = file[start : file.index(b"\0", start)].decode().strip().splitlines()
        numbers = np.array([row.split() for row in rows], float)
        assert numbers.shape == (9, 3)
        assert np.allclose(numbers, numbers[:, :1])
        assert numbers[0, 0] > 0.1
