"""Decor has one description: what Python draws is what a page shows, whoever draws it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import sampled
from decor_tools import belonging
from model_pages import drawn, overlap, page_of
from numpy.typing import NDArray
from plugin_tools import install
from web_tools import MISSING

from sero_mj import Scene, SerialRobot, World, load_scene
from sero_mj.base.plugins import forget_plugins
from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.declared.cartesian import SmartArrow
from sero_mj.robots.declared.scene import SceneToggles
from sero_mj.viewer.decor import arrow_shapes
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import GeomBuffer, Kind
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.scene_writer import SceneWriter
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.camera import find_camera
from sero_mj.viewer.image.mujoco_private import context_of, lend_shapes
from sero_mj.viewer.player.capture import capture

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")

SIZE = (1200, 800)
OUTLINE = 0.98
LWR_LIMITS = np.array([200.0, 200.0, 100.0, 100.0, 100.0, 30.0, 30.0])

# The geoms of the arrows of joints at a time.
ARROWS = """time => {
    player.recording.seek(time);
    player.draw();
    const { of, count, positions, rotations, sizes, rgba } = player.recording.geoms, found = [];
    for (let k = 0; k < count; k++) if (of[3 * k] === 1) found.push({
        of: [...of.slice(3 * k + 1, 3 * k + 3)], pos: [...positions.slice(3 * k, 3 * k + 3)],
        quat: [...rotations.slice(4 * k, 4 * k + 4)], size: [...sizes.slice(3 * k, 3 * k + 3)],
        rgba: [...rgba.slice(4 * k, 4 * k + 4)] });
    return found;
}"""
SHAPES = """() => player.stage.run.arrows.shapes.meshes.map(
    ({ positions, index }) => [[...positions], [...index]])"""


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Any]]:
    pages: list[Any] = []

    def page(found: Any, at: float = 0.0) -> Any:
        one = browser.new_page(viewport={"width": 640, "height": 640})
        one.said = []
        one.on("console", lambda message: one.said.append(message.text))
        one.on("pageerror", lambda error: one.said.append(str(error)))
        one.goto(f"{page_of(found, tmp_path / f'{len(pages)}.html').as_uri()}#t={at}")
        one.locator("html[data-ready]").wait_for(state="attached")
        pages.append(one)
        return one

    yield page
    for one in pages:
        one.close()


def buffer_of(world: World, data: mujoco.MjData, camera: str | None = None) -> GeomBuffer:
    """What Python draws."""
    scene, free = mujoco.MjvScene(world.model, 1000), find_camera(world, camera)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    mujoco.mjv_updateScene(world.model, data, mujoco.MjvOption(), None, free, everything, scene)
    view = ImageView.of_scene(scene, *SIZE)
    return Decor(world).draw(data, Toggles(world), view)


def check_arrows(page: Any, world: World, data: mujoco.MjData, time: float) -> int:
    """Compares the geoms of all arrows at a time (s); returns how many there are."""
    rows = belonging(buffer_of(world, data), Kind.ARROW)
    found = {tuple(each["of"]): each for each in page.evaluate(ARROWS, time)}
    buffer = buffer_of(world, data)
    items = buffer.items[: buffer.count][buffer.kinds[: buffer.count] == Kind.ARROW]
    assert len(found) == len(rows)
    for item, row in zip(items.tolist(), rows, strict=True):
        one = found[item, int(row["dataid"])]
        np.testing.assert_allclose(one["pos"], row["pos"], atol=1e-4)
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, np.array(one["quat"]))
        np.testing.assert_allclose(mat, row["mat"].ravel(), atol=1e-3)
        np.testing.assert_allclose(one["size"], row["size"], rtol=1e-4)
        np.testing.assert_allclose(one["rgba"], 255 * row["rgba"], atol=1)
    return len(rows)


def test_page_has_the_meshes_of_arrows_and_axes(opened: Callable[..., Any]) -> None:
    page = opened(capture(Scene(robots=[SerialRobot.from_model("lwr")])))
    found = page.evaluate(SHAPES)
    assert len(found) == len(arrow_shapes.shapes())
    for (positions, index), shape in zip(found, arrow_shapes.shapes(), strict=True):
        assert np.abs(np.reshape(positions, (-1, 3)) - shape.vertices).max() < 1.5e-4
        assert index == shape.faces.ravel().tolist()


@pytest.mark.parametrize("sign", sampled([1.0, -1.0], 1))
def test_arrows_have_the_geoms_of_python(opened: Callable[..., Any], sign: float) -> None:
    shares = sign * np.array([0.005, 0.02, 0.1, 0.45, 1.0, 1.3, 3.0])
    robot = SerialRobot.from_model(
        "lwr", torques=shares * LWR_LIMITS, show_arrows=True,
        joint_angles=[0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2],
    )  # fmt: skip
    scene = Scene(robots=[robot])
    page = opened(capture(scene))
    world = World(scene)
    assert check_arrows(page, world, world.make_data(), 0.0) == 7 + 2


@pytest.mark.thorough
def test_round_arrows_rotate_like_the_python_geoms(opened: Callable[..., Any]) -> None:
    scene = load_scene("impedance_push")
    page = opened(capture(scene, fps=10, seconds=3.0))
    compared = 0
    with Mirror(scene) as mirror:
        for time in (0.3, 1.2, 1.7, 2.9):
            mirror.advance(time)
            # Positions of bodies are rounded to 0.05 mm on a page.
            compared += check_arrows(page, mirror.world, mirror.data, time)
    assert compared > 12


def picture_of_decor(
    world: World, data: mujoco.MjData, camera: str
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Decor alone, as MuJoCo draws it (h, w, 3), and where it is (h, w)."""
    world.model.vis.global_.offwidth, world.model.vis.global_.offheight = SIZE
    with mujoco.Renderer(world.model, SIZE[1], SIZE[0]) as renderer:
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "HAZE"):
            renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        option = mujoco.MjvOption()
        option.geomgroup[:] = option.sitegroup[:] = 0
        renderer.update_scene(data, find_camera(world, camera), option)
        buffer = buffer_of(world, data, camera)
        buffer.rows["label"] = b""  # which is HTML on pages
        SceneWriter(renderer.scene, lend_shapes(context_of(renderer))).add(buffer, with_text=False)
        picture = renderer.render()
    return picture, picture.max(axis=-1) > 12


@pytest.fixture
def shapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    forget_plugins()
    install(tmp_path, "all_shapes", "sero_mj.decor", "shapes", "AllShapes")
    monkeypatch.syspath_prepend(str(tmp_path))
    import all_shapes

    yield all_shapes
    forget_plugins()
    sys.modules.pop("all_shapes", None)


@pytest.mark.thorough
def test_every_type_of_third_party_geom_is_shown_without_javascript(
    opened: Callable[..., Any], shapes: Any
) -> None:
    scene = Scene(floor=False)
    world = World(scene)
    camera = "200,-25,6.2,0,2.5,0"
    _, covered = picture_of_decor(world, world.make_data(), camera)
    page = opened(capture(scene, camera=camera))
    pixels = drawn(page, SIZE, 0.0, ["backdrop"])
    assert page.said == []
    seen = pixels[..., 3] > 127
    for k, name in enumerate(shapes.SIZES):
        mine = cell(page, k * shapes.APART)
        here, there = covered[mine], seen[mine]
        assert here.sum() > 20, name
        if name.startswith("LINE"):  # of a pixel's width on pages
            here, there = thick(here), thick(there)
            assert overlap(here, there) > 0.6, name
            continue
        assert overlap(here, there) >= 0.93, name  # some hundred pixels each
        declared = (0.2 + 0.07 * k, 0.9 - 0.06 * k, 0.3)  # decor glows: it is of no light
        colour = np.median(pixels[mine][here & there][:, :3], axis=0)
        np.testing.assert_allclose(colour, 255 * np.array(declared), atol=1.5, err_msg=name)
    assert overlap(covered, seen) > 0.9
    label = page.locator(".label")
    assert label.inner_text() == "third <b>one</b>"


def cell(page: Any, y: float) -> tuple[slice, slice]:
    """The part of the picture about a place on the row of shapes."""
    found = page.evaluate(
        """y => { const { stage } = player, V = stage.camera.position.constructor;
        const a = stage.pixel(new V(0, y - .25, 0)), b = stage.pixel(new V(0, y + .25, 0));
        return [a.x, b.x]; }""",
        y,
    )
    left, right = sorted(round(each) for each in found)
    return slice(0, SIZE[1]), slice(max(left, 0), right)


def thick(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and its neighbours."""
    grown = mask.copy()
    for axis in (0, 1):
        for way in (-2, -1, 1, 2):
            grown |= np.roll(mask, way, axis)
    return grown


def test_smart_arrows_show_with_their_heads(opened: Callable[..., Any]) -> None:
    arrows = [
        SmartArrow(name="f", kind="force", at="lwr/flange", vector=[60, 20, -40]),
        SmartArrow(name="m", kind="torque", at="lwr/link4", vector=[5, 9, 3]),
    ]
    scene = Scene(robots=[SerialRobot.from_model("lwr")], arrows=arrows, floor=False)
    world, camera = World(scene), "120,-15,2.2"
    _, covered = picture_of_decor(world, world.make_data(), camera)
    page = opened(capture(scene, camera=camera))
    page.evaluate("player.stage.robots.group.visible = false")
    seen = drawn(page, SIZE, 0.0, ["backdrop"])[..., 3] > 127
    assert covered.sum() > 800
    assert overlap(covered, seen) >= 0.93


@pytest.mark.thorough
def test_names_of_frames_are_text(opened: Callable[..., Any]) -> None:
    robot = SerialRobot.from_model("lwr", show_axes=True)
    scene = Scene(robots=[robot], toggles=SceneToggles(frame_names=True))
    page = opened(capture(scene))
    texts = page.locator(".label").all_inner_texts()
    assert "lwr/flange" in texts and "lwr/base" in texts
    boxes = [each.bounding_box() for each in page.locator(".label:visible").all()]
    assert boxes and all(box["width"] > 20 for box in boxes)
    world = World(scene)
    flange = world.make_data().site_xpos[world.frames.site[world.frames.names.index("lwr/flange")]]
    at = page.evaluate(
        """p => { const { stage } = player, V = stage.camera.position.constructor;
        return stage.pixel(new V(...p)); }""",
        flange.tolist(),
    )
    (name,) = (box for box, text in zip(boxes, texts, strict=True) if text == "lwr/flange")
    assert abs(name["x"] + name["width"] / 2 - at["x"]) < 2
    assert 0 < name["y"] - at["y"] < 20


def test_page_without_names_has_no_labels(opened: Callable[..., Any]) -> None:
    page = opened(capture(Scene(robots=[SerialRobot.from_model("lwr")])))
    assert page.locator(".label").count() == 0
