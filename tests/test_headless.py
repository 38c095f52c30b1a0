"""Rendered images, checked for what they must show."""

from contextlib import nullcontext

import mujoco
import numpy as np
import pytest
from conftest import raises_with, sampled
from decor_tools import world_of
from PIL import Image

from sero_mj.base.errors import RenderError, UnknownName, UsageError
from sero_mj.data.drive.place import Placer
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Camera, Scene, View
from sero_mj.viewer.decor.font import DEFAULT_FONT, FONT_HEIGHTS, Font, line_height
from sero_mj.viewer.decor.geom_buffer import ARROW_SIZE_OF_LENGTH
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.panels import PADDING
from sero_mj.viewer.image import render
from sero_mj.viewer.image.camera import Navigator, find_camera
from sero_mj.viewer.image.framing import (
    Framing,
    bounding_sphere,
    needed_aspect,
    stand_back,
)
from sero_mj.viewer.image.render import HeadlessRenderer, render_image

pytestmark = pytest.mark.gl

POSE = np.deg2rad([30, 60, -40, 90, 50, -80, 20])
TORQUES = np.array([120, -60, 30, -8, 4, -2, 0.76])  # 68 % down to 2 % of the limits
SIZE = (800, 600)


@pytest.fixture(scope="module")
def world() -> World:
    return world_of(joint_angles=POSE, torques=TORQUES, show_arrows=True)


@pytest.fixture(scope="module")
def renderer(world: World):
    with HeadlessRenderer(world, *SIZE) as renderer:
        renderer.toggles.legend = False
        yield renderer


def changed(a, b):
    """Returns where two images differ by more than noise, (height, width) bool."""
    return np.abs(a.astype(int) - b.astype(int)).max(axis=2) > 25


@pytest.mark.parametrize("joint", range(7))
def test_every_arrow_is_visible_in_its_color_at_its_joint(world, renderer, joint: int) -> None:
    data = world.make_data()
    complete = renderer.render(data)
    renderer.toggles.arrows[joint] = False
    try:
        without = renderer.render(data)
    finally:
        renderer.toggles.arrows[joint] = True
    rows, columns = np.nonzero(changed(complete, without))
    # The missing arrow makes a difference, even the thin one of 2 % of the limit ...
    assert len(rows) > 60
    # ... at its joint ...
    centre, depth = renderer.decor.view.project(data.site_xpos[world.joints.centre_site[joint]])
    reach = 0.17 / renderer.decor.view.pixel_size(float(depth))
    away = np.hypot(columns - centre[0], (SIZE[1] - rows) - centre[1])
    assert (away < reach).all()
    # ... and in the color of its sign: orange has more red than blue, blue the reverse.
    red, _, blue = complete[rows, columns].mean(axis=0)
    assert np.sign(red - blue) == np.sign(TORQUES[joint])


def test_arrow_width_in_pixels_grows_with_the_torque(world, renderer) -> None:
    data = world.make_data()
    areas = []
    for share in (0.02, 0.1, 0.4, 1.0):
        world.set_input(data, "lwr.torques", [0, 0, 0, 0, share * 100, 0, 0])
        shown = renderer.render(data)
        renderer.toggles.arrows[:] = False
        areas.append(int(changed(shown, renderer.render(data)).sum()))
        renderer.toggles.arrows[:] = True
    assert (np.diff(areas) > 0.15 * np.array(areas[:-1])).all()


def test_billboard_text_is_white_on_its_dark_background(renderer, world) -> None:
    data = world.make_data()
    renderer.toggles.arrows[:] = False
    renderer.toggles.billboards[:] = True
    try:
        pixels = renderer.render(data)
    finally:
        renderer.toggles.arrows[:], renderer.toggles.billboards[:] = True, False
    buffer = renderer.decor.buffer
    rows = buffer.rows[: buffer.count]
    assert (rows["type"] == int(mujoco.mjtGeom.mjGEOM_LABEL)).sum() == 7
    font = renderer.decor.view.font
    (panels,) = [panels for panels in renderer.decor.panels if panels.has_values]
    assert len(panels.texts) == 7
    for (x, y), (width, height) in zip(panels.centres, panels.sizes, strict=True):
        middle = SIZE[1] - y
        box = pixels[
            round(middle - height / 2) : round(middle + height / 2),
            round(x - width / 2) : round(x + width / 2),
        ][6:-6]  # without the rounded corners
        bright = box.min(axis=2) > 150
        assert 0.02 < bright.mean() < 0.5
        # The text reaches from one padding to the other and does not cover them.
        columns = np.nonzero(bright.any(axis=0))[0]
        pad = PADDING * font.height
        assert abs(columns[0] - pad) <= 3
        assert abs(columns[-1] - (width - pad)) <= 3
        assert np.median(box) < 90  # the panel behind it


def test_image_without_decor_equals_the_one_of_mujoco(world) -> None:
    data = world.make_data()
    camera = find_camera(world)
    with HeadlessRenderer(world, 160, 120) as ours:
        ours.toggles.arrows[:] = False
        got = ours.render(data)
    with mujoco.Renderer(world.model, 120, 160) as plain:
        plain.update_scene(data, camera)
        assert np.array_equal(got, plain.render())


def test_font_widths_equal_those_of_mujoco(world) -> None:
    at_150 = mujoco.mjtFontScale.mjFONTSCALE_150
    with mujoco.Renderer(world.model, 16, 16, font_scale=at_150) as renderer:
        context = Font.of_context(renderer._mjr_context)
    assert context.height == DEFAULT_FONT.height
    assert context.widths[32:127].tolist() == DEFAULT_FONT.widths[32:127].tolist()


@pytest.mark.parametrize("scale", FONT_HEIGHTS)
def test_font_heights_equal_those_of_mujoco(scale: int, world) -> None:
    font = getattr(mujoco.mjtFontScale, f"mjFONTSCALE_{scale}")
    with mujoco.Renderer(world.model, 16, 16, font_scale=font) as renderer:
        assert renderer._mjr_context.charHeight == FONT_HEIGHTS[scale]


def test_text_size_grows_with_the_image_size(world) -> None:
    heights = [line_height(world, 2 * h, h) for h in (300, 480, 800, 1080, 2160)]
    assert heights == [18, 18, 28, 38, 76]
    assert [line_height(world, h, 2 * h) for h in (300, 480, 800, 1080, 2160)] == heights


def test_arrow_geom_is_drawn_with_the_assumed_length() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size=".001"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 1.0, 90, 0
    length = 0.2
    with mujoco.Renderer(model, 401, 401) as renderer:
        renderer.update_scene(data, camera)
        renderer.scene.ngeom = 1
        mujoco.mjv_initGeom(
            renderer.scene.geoms[0],
            mujoco.mjtGeom.mjGEOM_ARROW,
            np.array([0.01, 0.01, ARROW_SIZE_OF_LENGTH * length]),
            np.zeros(3),
            np.eye(3).ravel(),
            np.ones(4, np.float32),
        )
        rows, _ = np.nonzero(renderer.render().max(axis=2) > 40)
    per_metre = 401 / (2 * np.tan(np.deg2rad(model.vis.global_.fovy) / 2))
    assert (200.5 - rows.min()) / per_metre == pytest.approx(length, abs=0.008)


def test_meshes_of_arrows_are_drawn_like_triangles_of_the_same_shape() -> None:
    limits = SerialRobot.from_model("lwr").torque_limits
    robot = SerialRobot.from_model("lwr", torques=0.9 * limits, show_arrows=True)
    world = World(Scene(robots=[robot]))
    found = []
    for has_meshes in (True, False):
        with HeadlessRenderer(world, 640, 480) as renderer:
            renderer.toggles.legend = renderer.toggles.status = False
            if not has_meshes:
                renderer.decor.first_shape = None
            pixels = renderer.render(world.make_data()).astype(int)
            assert renderer.decor.buffer.count == 7
            found.append(pixels[..., 0] - pixels[..., 2] > 90)  # orange
    assert found[0].sum() > 2000
    # The tubes of triangles have four sides, so their sections are squares within the circles.
    assert (found[0] & found[1]).sum() > 0.55 * (found[0] | found[1]).sum()
    (mesh_rows, mesh_columns), (rows, columns) = (np.nonzero(each) for each in found)
    for mesh, triangles in ((mesh_rows, rows), (mesh_columns, columns)):
        assert (
            np.abs(np.quantile(mesh, [0, 0.5, 1]) - np.quantile(triangles, [0, 0.5, 1])).max() < 16
        )


def test_named_camera_looks_at_its_target(lwr) -> None:
    camera = Camera(position=[2.0, 1.0, 1.5], look_at=[0.1, 0.2, 0.3])
    world = World(Scene(robots=[lwr], cameras={"front": camera}))
    with HeadlessRenderer(world, 320, 240, "front") as renderer:
        renderer.render(world.make_data())
        pixels, _ = renderer.decor.view.project(np.array([0.1, 0.2, 0.3]))
        assert pixels == pytest.approx([160, 120], abs=0.1)
        assert renderer.decor.view.position == pytest.approx([2.0, 1.0, 1.5], abs=1e-5)
    with raises_with(UnknownName, kind="camera", name="fron", near="front"):
        find_camera(world, "fron")


def test_free_camera_takes_azimuth_elevation_distance(world) -> None:
    camera = find_camera(world, "30,-20,3.5")
    assert (camera.azimuth, camera.elevation, camera.distance) == (30, -20, 3.5)
    expected = (
        "the name of a camera, or azimuth,elevation,distance (degrees, degrees, m above 0), "
        "optionally followed by the look-at point ,x,y,z (m), for example 150,-15,2.2"
    )
    for wrong in ("30,-20", "30,-20,0", "a,b,c", "1,2,nan", 5):
        with raises_with(UsageError, key="camera", found=wrong, expected=expected):
            find_camera(world, wrong)


def test_declared_view_sets_the_camera(lwr) -> None:
    view = View(azimuth_deg=12.0, elevation_deg=-3.0, distance=4.0, look_at=[0, 0, 1])
    camera = find_camera(World(Scene(robots=[lwr], view=view)))
    assert (camera.azimuth, camera.elevation, camera.distance) == (12, -3, 4)
    assert camera.lookat == pytest.approx([0, 0, 1])


def test_default_view_contains_the_whole_robot(lwr) -> None:
    world = World(Scene(robots=[lwr]))
    centre, radius = bounding_sphere(world)
    data = world.make_data()
    with HeadlessRenderer(world, 800, 600) as renderer:
        renderer.render(data)
        pixels, _ = renderer.decor.view.project(data.xpos[world.robots["lwr"].bodies])
    assert (pixels > 20).all() and (pixels < [780, 580]).all()
    assert 0.5 < radius < 0.8
    assert np.ptp(pixels[:, 1]) > 300  # and the robot is not tiny
    assert centre[2] == pytest.approx(0.59, abs=0.05)


FOLDED = np.deg2rad([0, 100, 0, 118, 0, 0, 0])


def in_picture(world: World, camera: mujoco.MjvCamera, data: mujoco.MjData) -> bool:
    """Returns whether the centers of all geoms of the robot are in a square image."""
    scene = mujoco.MjvScene(world.model, 10)
    mujoco.mjv_updateCamera(world.model, data, camera, scene)
    view = ImageView.of_scene(scene, 600, 600)
    return bool(view.sees(*view.project(data.geom_xpos[world.geoms_in_view()])).all())


def test_robot_that_moves_out_of_the_image_is_brought_back() -> None:
    world = world_of(joint_angles=FOLDED)
    navigator, data = Navigator(world), world.make_data()
    navigator.advance(data)
    declared = navigator.camera.distance
    assert in_picture(world, navigator.camera, data)
    data.qpos[:] = 0.0  # upright: the pose of the first packet
    mujoco.mj_kinematics(world.model, data)
    assert not in_picture(world, navigator.camera, data)
    navigator.advance(data)
    assert in_picture(world, navigator.camera, data)
    assert navigator.camera.distance > declared
    with HeadlessRenderer(world, 60, 60) as renderer:
        renderer.render(data)
        assert in_picture(world, renderer.camera, data)
    assert navigator.choose(0) == "initial view"
    navigator.advance(data)
    assert in_picture(world, navigator.camera, data)


def test_camera_is_unchanged_while_the_robot_is_in_the_image() -> None:
    world = world_of(joint_angles=np.zeros(7))
    navigator, data = Navigator(world), world.make_data()
    before = navigator.camera.distance, *navigator.camera.lookat
    data.qpos[:] = FOLDED
    mujoco.mj_kinematics(world.model, data)
    navigator.advance(data)
    assert (navigator.camera.distance, *navigator.camera.lookat) == before


def test_camera_set_by_the_user_is_unchanged() -> None:
    world = world_of(joint_angles=FOLDED)
    data = world.make_data()
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(world.model, data)
    wanted = "30,-20,0.5"
    placed = find_camera(world, wanted)
    Framing(world, placed, wanted).fit(placed, data)
    assert placed.distance == 0.5
    navigator = Navigator(world)
    navigator.advance(world.make_data())
    navigator.zoom(3)
    moved = navigator.camera.distance
    navigator.advance(data)
    assert navigator.camera.distance == moved


def test_image_sizes_out_of_range_are_rejected(world) -> None:
    for size in ((0, 100), (100, 20000)):
        expected = {"found": size, "expected": "1 to 16384 pixels per side"}
        with raises_with(RenderError, key="image size", **expected):
            HeadlessRenderer(world, *size)


def test_odd_image_sizes_work(world) -> None:
    with HeadlessRenderer(world, 51, 33) as renderer:
        assert renderer.render(world.make_data()).shape == (33, 51, 3)


def mixed_colours(picture: np.ndarray) -> int:
    """Returns the number of colors of an image; multisampling mixes colors at edges."""
    return len(np.unique(picture.reshape(-1, 3), axis=0))


@pytest.mark.thorough
def test_draft_has_no_shadows_and_hard_edges(world) -> None:
    pictures = {}
    for quality in ("normal", "draft"):
        with HeadlessRenderer(world, *SIZE, quality=quality) as renderer:
            renderer.toggles.legend = False
            pictures[quality] = renderer.render(world.make_data())
    is_shadow = pictures["draft"].mean(axis=2) > 1.2 * pictures["normal"].mean(axis=2)
    assert is_shadow.mean() > 0.005
    assert mixed_colours(pictures["draft"]) < 0.5 * mixed_colours(pictures["normal"])


def test_draft_textures_equal_those_of_opengl(world, monkeypatch) -> None:
    pictures = []
    for _ in range(2):
        with HeadlessRenderer(world, *SIZE, quality="draft") as renderer:
            pictures.append(renderer.render(world.make_data()).astype(int))
        # OpenGL generates those of the second image.
        monkeypatch.setattr(
            render, "without_textures", lambda model: nullcontext(np.zeros(0, np.intp))
        )
    assert np.abs(pictures[0] - pictures[1]).max() <= 3
    assert np.ptp(pictures[0][:, 2], axis=0).max() > 10  # sky, haze and tiles


@pytest.mark.thorough
def test_fine_image_is_smoother_with_equal_sizes_of_panels_and_text(world) -> None:
    pictures, panels = {}, {}
    for quality in ("normal", "fine"):
        with HeadlessRenderer(world, *SIZE, quality=quality, renderer="classic") as renderer:
            renderer.toggles.cards[:] = True
            pictures[quality] = renderer.render(world.make_data())
            panels[quality] = renderer.decor.panels
    centres = [np.concatenate([each.centres for each in panels[q]]) for q in ("normal", "fine")]
    assert np.array_equal(*centres)
    fine, normal = pictures["fine"], pictures["normal"]
    assert fine.shape == normal.shape
    assert np.abs(fine.astype(float) - normal).mean() < 3.0  # the same image
    assert mixed_colours(fine) > 1.2 * mixed_colours(normal)


@pytest.mark.parametrize(("quality", "dpi"), [("normal", None), ("fine", 300)])
def test_image_file_contains_its_resolution(quality, dpi, lwr, tmp_path) -> None:
    file = tmp_path / "lwr.png"
    scene, options = Scene(robots=[lwr]), {"size": (120, 90), "quality": quality}
    render_image(scene, file, **options, renderer="classic")
    with Image.open(file) as picture:
        assert picture.size == (120, 90)
        assert (dpi is None) == ("dpi" not in picture.info)
        assert dpi is None or picture.info["dpi"] == pytest.approx((dpi, dpi), abs=0.1)


def test_unknown_quality_is_rejected(world) -> None:
    with raises_with(RenderError, key="quality", found="best", expected="draft, normal, fine"):
        HeadlessRenderer(world, 64, 48, quality="best")  # type: ignore[arg-type]


def test_rendering_does_not_change_the_model(world) -> None:
    def state() -> list[float]:
        model = world.model
        quality = model.vis.quality
        return [quality.offsamples, quality.shadowsize, model.vis.global_.offwidth,
                *model.tex_width, *model.tex_height]  # fmt: skip

    before = state()
    with HeadlessRenderer(world, 64, 48, quality="draft") as renderer:
        renderer.render(world.make_data())
    assert state() == before


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["lwr_udp", "haptic_position", "justin_push", "lwr_hit_hand"])
@pytest.mark.parametrize("size", sampled([(390, 844), (640, 480), (600, 600), (1280, 800)], 1))
def test_robots_are_inside_images_of_any_shape(name: str, size: tuple[int, int]) -> None:
    world = World(load_scene(name))
    data, camera = world.make_data(), find_camera(world)
    Placer(world).place(data)
    scene = mujoco.MjvScene(world.model, maxgeom=0)
    mujoco.mjv_updateCamera(world.model, data, camera, scene)
    stand_back(scene, camera, *size, needed_aspect(world, camera))
    view = ImageView.of_scene(scene, *size)
    joints = world.joints.centre_site[: world.joints.of_robot]  # without doubles that have no pose
    pixels, depth = view.project(data.site_xpos[joints])
    assert view.sees(pixels, depth).all()
    ahead = (np.array(camera.lookat) - view.position) @ view.forward
    if size[0] / size[1] >= 4 / 3:
        assert ahead == pytest.approx(camera.distance, rel=1e-6)
    else:  # at most as large as in a 4:3 image, and not much smaller than the space allows
        assert ahead <= 4 / 3 * camera.distance * size[1] / size[0] * (1 + 1e-6)
        assert np.ptp(pixels[:, 0]) > 0.15 * size[0] or np.ptp(pixels[:, 1]) > 0.2 * size[1]
