"""Images of `overlay`: rendered, clicked on, and displayed in notebooks."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from foreign_models import JACO_TORQUES, arm, jaco
from PIL import Image

import sero_mj
from sero_mj.base.errors import RenderError
from sero_mj.robots.assemble.world import World
from sero_mj.viewer.image.image_files import ImageArray
from sero_mj.viewer.image.render import HeadlessRenderer

pytestmark = pytest.mark.gl

SIZE = (640, 480)
CAMERA = "60,-14,1.3"
# Mean difference of two images, of 255. Renderers differ by less; a missing arrow by more.
TOLERANCE = 0.02


def difference(one: Any, other: Any) -> float:
    return float(np.abs(one.astype(float) - other.astype(float)).mean())


@pytest.fixture(scope="module")
def overlay() -> Iterator[Any]:
    model, data = jaco()
    double = sero_mj.Double(name="goal", of="jaco")
    with sero_mj.overlay(model, data, doubles=[double]) as made:
        yield made


@pytest.fixture(autouse=True)
def as_declared(overlay: Any) -> None:
    overlay.toggles.reset()
    overlay.toggles.legend = False
    overlay.set("jaco.torques", JACO_TORQUES)
    overlay.clear("goal.joint_angles")


def with_their_renderer(overlay: Any, **options: Any) -> Any:
    """Returns the image of a user's own loop."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(overlay.model, camera)
    camera.azimuth, camera.elevation, camera.distance = 60, -14, 1.3
    camera.lookat = (0, 0, 0.35)
    with mujoco.Renderer(overlay.model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(overlay.data, camera)
        assert overlay.draw(renderer, **options) == 0
        return renderer.render()


def test_missing_arrow_changes_the_image(overlay: Any) -> None:
    picture = overlay.image(*SIZE, CAMERA)
    assert difference(picture, overlay.image(*SIZE, CAMERA)) == 0.0
    for joint in range(6):
        overlay.toggles.arrows[joint] = False
        assert difference(picture, overlay.image(*SIZE, CAMERA)) > TOLERANCE, joint
        overlay.toggles.arrows[joint] = True


def test_image_can_be_saved_and_is_an_array(overlay: Any, tmp_path: Path) -> None:
    picture = overlay.image(320, 240, CAMERA)
    for name in ("new/out.png", "out.jpg", "out.webp"):
        picture.save(tmp_path / name)
        with Image.open(tmp_path / name) as found:
            assert found.size == (320, 240)
    with Image.open(tmp_path / "new" / "out.png") as found:
        np.testing.assert_array_equal(np.asarray(found), picture)
    assert isinstance(picture, np.ndarray)
    picture[10:90, ::2].save(str(tmp_path / "part.png"))
    with Image.open(tmp_path / "part.png") as found:
        assert found.size == (160, 80)
    with raises_with(
        RenderError, reason=f"cannot write {tmp_path}/out.xyz: unknown file extension: .xyz"
    ):
        picture.save(tmp_path / "out.xyz")
    found = "found 240 x 320 numbers of type uint8; expected an image of height x width x 3"
    with raises_with(RenderError, reason=f"cannot write {tmp_path}/plane.png: {found}"):
        picture[..., 0].save(tmp_path / "plane.png")


@pytest.mark.thorough
def test_lwr_looks_the_same_as_overlay_and_as_scene() -> None:
    torques = [30.0, -80.0, 25.0, 60.0, -30.0, 25.0, -25.0]
    robot = sero_mj.SerialRobot.from_model("lwr", show_arrows=True, show_axes=True)
    world = World(sero_mj.Scene(robots=[robot]))
    data = world.make_data()
    data.qpos[:] = (0.3, 0.5, -0.7, -1.1, 0.4, 0.9, -0.2)
    mujoco.mj_forward(world.model, data)
    world.set_input(data, "lwr.torques", torques)
    fields = {
        name: getattr(robot, name)
        for name in ("torque_limits", "arrow_radius", "axes_size", "show_axes")
    }
    fields["offsets_to_center_of_joints"] = robot.offsets
    camera = "150,-14,2.4"
    with (
        HeadlessRenderer(world, *SIZE, camera) as renderer,
        sero_mj.overlay(world.model, data, robots={"lwr": fields}) as overlay,
    ):
        overlay.set("lwr.torques", torques)
        expected = renderer.render(data)
        overlay.image(*SIZE, camera)
        look = renderer.camera
        assert difference(expected, overlay.image(*SIZE, look)) < TOLERANCE
        for joint in range(7):
            overlay.toggles.arrows[joint] = False
            assert difference(expected, overlay.image(*SIZE, look)) > TOLERANCE, joint
            overlay.toggles.arrows[joint] = True


@pytest.mark.thorough
@pytest.mark.parametrize("joint", range(6))
def test_click_on_a_drawn_arrow_picks_its_joint(overlay: Any, joint: int) -> None:
    """The pixels that change with the arrow are its pixels; picking there returns the joint."""
    overlay.set("jaco.torques", {f"joint_{joint + 1}": 6.0 if joint > 2 else 28.0})
    picture = with_their_renderer(overlay)
    overlay.toggles.arrows[joint] = False
    without = with_their_renderer(overlay)
    overlay.toggles.arrows[joint] = True
    with_their_renderer(overlay)  # picking uses the frame drawn last
    changed = np.abs(picture.astype(int) - without).sum(axis=2) > 150
    ys, xs = changed.nonzero()
    assert len(xs) > 60
    hits = []
    for k in np.linspace(0, len(xs) - 1, 40).astype(int):
        picked = overlay.pick(int(xs[k]), int(ys[k]))
        hits.append(picked is not None and (picked.kind, picked.name))
    assert hits.count(("arrow", f"jaco/joint_{joint + 1}")) >= 36  # the rest are edges


def test_clicks_work_as_in_a_scene(overlay: Any) -> None:
    data = overlay.data
    with_their_renderer(overlay)
    middle = overlay.view.project((data.body("jaco/b_2").xpos + data.body("jaco/b_3").xpos) / 2)
    at = (float(middle[0][0]), float(SIZE[1] - middle[0][1]))
    picked = overlay.click(*at)
    assert (picked.kind, picked.name, picked.owner) == ("link", "jaco/b_2", "jaco")
    assert overlay.toggles.billboards.nonzero()[0].tolist() == [*range(6)]  # of the arm
    overlay.click(*at, gesture="double")
    assert overlay.toggles.axes.sum() == len(overlay.world.robots["jaco"].tree.bodies)
    overlay.hover(*at)
    assert overlay.toggles.hover[0] == "jaco/b_2"
    assert overlay.pick(3, 3) is None


def test_double_is_at_its_joint_angles_and_can_be_clicked(overlay: Any) -> None:
    data = overlay.data
    before = with_their_renderer(overlay)
    target = data.qpos + np.array([0.9, 0.2, 0.2, 0, 0, 0, 0, 0, 0])
    overlay.set("goal.joint_angles", target)
    picture = with_their_renderer(overlay)
    there = mujoco.MjData(overlay.model)
    there.qpos[:] = target
    mujoco.mj_forward(overlay.model, there)
    assert overlay.frame("goal/b_6")[:3, 3] == pytest.approx(there.body("jaco/b_6").xpos)
    middle = (there.body("jaco/b_3").xpos + there.body("jaco/b_4").xpos) / 2
    pixel, _ = overlay.view.project(middle)
    x, y = round(pixel[0]), round(SIZE[1] - pixel[1])
    changed = (picture != before).any(axis=2)
    assert changed[y, x] and changed.sum() > 5000
    more = (picture.astype(int) - before)[changed].mean(axis=0)
    assert more[1] > more[0] + 15 and more[1] > more[2] + 10  # greener
    picked = overlay.click(x, y)
    assert (picked.kind, picked.name, picked.owner) == ("double", "goal/b_3", "goal")
    assert overlay.toggles.billboards.nonzero()[0].tolist() == [*range(9, 15)]
    overlay.toggles.reset()
    overlay.toggles.legend = False
    overlay.toggles.doubles[:] = False
    assert difference(before, with_their_renderer(overlay)) == 0.0
    overlay.toggles.doubles[:] = True
    overlay.set("goal.joint_angles", data.qpos)  # at the robot's pose it is not drawn
    assert difference(before, with_their_renderer(overlay)) == 0.0


def test_path_is_a_row_of_doubles() -> None:
    model, data = arm()
    path = np.array([[0.0, 0, 0, 0], [1.5, 0.5, 0, 0]])
    double = sero_mj.Double(name="way", of="arm", path=path, path_length=4)
    with sero_mj.overlay(model, data, doubles=[double]) as overlay:
        shown = overlay.image(320, 240)
        overlay.toggles.doubles[:] = False
        assert difference(shown, overlay.image(320, 240)) > 0.3


BARE = """<mujoco><visual><headlight active="{headlight}"/></visual><asset>{sky}</asset>
  <worldbody>{more}<camera name="front" pos="0 -2 {height}" xyaxes="1 0 0 0 0 1"/>
    <body name="rod" pos="0 0 {height}"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".1" rgba=".8 .8 .8 1"/></body>
  </worldbody></mujoco>"""
SKY = '<texture type="skybox" builtin="flat" rgb1="1 0 0" width="8" height="48"/>'


def bare(height: float = 1.0, more: str = "", sky: str = "", headlight: int = 1) -> mujoco.MjModel:
    xml = BARE.format(height=height, more=more, sky=sky, headlight=headlight)
    return mujoco.MjModel.from_xml_string(xml)


@pytest.mark.thorough
@pytest.mark.parametrize("camera", [None, "front"])
def test_bare_model_is_lit_with_a_floor_and_a_sky(camera: str | None) -> None:
    for headlight in (1, 0):
        model = bare(headlight=headlight)
        with sero_mj.overlay(model) as shown:
            picture = shown.image(160, 120, camera)
            sky, rod, floor = picture[3, 20], picture[60, 80], picture[-1, -20]
            assert sky.min() > 150 and rod.min() > 120 and floor.min() > 120
            assert sky[2] > sky[0] and int(np.ptp(floor)) < 20
            assert shown.pick(155, 118) is None
        with sero_mj.overlay(model, surroundings=False) as plain:
            picture = plain.image(160, 120, camera)
            assert picture[3, 20].max() == picture[-1, -20].max() == 0


def test_surroundings_are_added_only_if_missing_and_change_nothing() -> None:
    model = bare(more='<light pos="0 0 9"/><geom type="plane" size="1 1 1"/>', sky=SKY)
    assert sero_mj.overlay(model).world.surroundings() is None
    own = sero_mj.overlay(bare(more='<light pos="0 0 9"/>', sky=SKY)).world.surroundings()
    assert own is not None and (own.ngeom, own.nlight, own.vis.headlight.active) == (1, 0, 0)
    own = sero_mj.overlay(bare(more='<geom type="plane" size="1 1 1"/>')).world.surroundings()
    assert own is not None and (own.ngeom, own.nlight) == (0, 1)
    model = bare(sky=SKY)
    with sero_mj.overlay(model) as shown:
        before = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        after = before.copy()
        mujoco.mj_saveModel(model, None, before)
        red = shown.image(160, 120)[2, 20]
        mujoco.mj_saveModel(model, None, after)
    assert red[0] > 200 and red[1] < 50
    assert np.array_equal(before, after)


def test_floor_is_below_the_lowest_geom() -> None:
    for height, expected in ((3.0, 0.0), (0.6, 0.0), (0.0, -0.6), (-2.0, -2.6)):
        own = sero_mj.overlay(bare(height)).world.surroundings()
        assert own is not None and own.geom_pos[0, 2] == pytest.approx(expected, abs=0.01)


def test_floor_does_not_move() -> None:
    overlay = sero_mj.overlay(bare(0.0))
    first, overlay.data.qpos[0] = overlay.world.surroundings(), np.pi
    mujoco.mj_forward(overlay.model, overlay.data)
    again = overlay.world.surroundings()
    assert first is not None and again is not None
    assert first.geom_pos[0, 2] == again.geom_pos[0, 2] == pytest.approx(-0.6, abs=0.01)


def test_images_of_several_models_are_independent() -> None:
    one, other = sero_mj.overlay(bare()), sero_mj.overlay(arm()[0])
    first, second = one.image(160, 120), other.image(160, 120)
    assert difference(first, one.image(160, 120)) == 0.0
    one.close()
    assert difference(second, other.image(160, 120)) == 0.0
    assert difference(first, one.image(160, 120)) == 0.0
    one.close()
    other.close()


def test_rendering_does_not_change_the_user_model(overlay: Any) -> None:
    model = overlay.model
    before = model.vis.global_.offwidth, model.vis.global_.offheight
    overlay.image(800, 700)
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == before


def test_changes_of_the_user_model_are_in_the_next_image(overlay: Any) -> None:
    first = overlay.image(*SIZE, CAMERA)
    colours = overlay.model.geom_rgba.copy()
    overlay.model.geom_rgba[:, :3] = (0.9, 0.2, 0.2)
    assert difference(first, overlay.image(*SIZE, CAMERA)) > 1.0
    overlay.model.geom_rgba[:] = colours
    assert difference(first, overlay.image(*SIZE, CAMERA)) == 0.0


def test_notebook_displays_an_overlay_and_its_images(overlay: Any) -> None:
    picture = overlay.image(200, 100)
    assert isinstance(picture, ImageArray) and isinstance(picture, np.ndarray)
    shown = np.asarray(Image.open(io.BytesIO(picture._repr_png_() or b"")))
    assert np.array_equal(shown, picture)
    assert picture[10, 10]._repr_png_() is None  # a pixel is an array of numbers
    assert (picture / 2)._repr_png_() is None
    assert Image.open(io.BytesIO(overlay._repr_png_())).size == (960, 600)


def test_scene_image_can_be_displayed() -> None:
    world = World(sero_mj.Scene(robots=[sero_mj.SerialRobot.from_model("lwr")]))
    with HeadlessRenderer(world, 64, 48) as renderer:
        assert renderer.render(world.make_data())._repr_png_()  # type: ignore[attr-defined]


@pytest.mark.thorough
def test_real_notebook_displays_overlay_images(tmp_path: Any) -> None:
    import nbformat  # takes seconds, which each worker would spend
    from foreign_models import ARM
    from nbclient import NotebookClient

    book = nbformat.v4.new_notebook()
    book.cells = [
        nbformat.v4.new_code_cell(
            "import mujoco, sero_mj\n"
            f"model = mujoco.MjModel.from_xml_string('''{ARM}''')\n"
            "data = mujoco.MjData(model); mujoco.mj_forward(model, data)\n"
            "overlay = sero_mj.overlay(model, data)\noverlay"
        ),
        nbformat.v4.new_code_cell("overlay.image(64, 48)"),
    ]
    NotebookClient(book, timeout=60, resources={"metadata": {"path": tmp_path}}).execute()
    for cell in book.cells:
        assert "image/png" in cell.outputs[-1]["data"]
