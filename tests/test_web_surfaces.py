"""What a page draws of a model, beside classic pictures: outlines, textures, soft parts."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import sampled
from model_pages import captured, classic, drawn, overlap, page_of, rolled_out
from PIL import Image
from web_tools import MISSING

from sero_mj import HeadlessRenderer
from sero_mj.load import load_scene
from sero_mj.viewer.player.capture import capture

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")

SIZE = (480, 360)
CAMERA = "60,-35,2.2,0,0.1,0"
# Surfaces have their own colours in both pictures.
BARE = '<visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>'
OUTLINE = 0.98  # pixels that both cover, of those that one of them covers
LEVELS = 12  # of 255; how far a colour inside of a surface may be away

HEIGHTS = " ".join(
    f"{max(0.0, 3.0 - np.hypot(r - 4, c - 5)):.2f}" for r in range(9) for c in range(13)
)
GEOMS = {
    "plane": 'type="plane" size=".6 .4 .1"',
    "endless": 'type="plane" size="0 0 .1"',
    "box": 'type="box" size=".5 .3 .2"',
    "sphere": 'type="sphere" size=".5"',
    "capsule": 'type="capsule" size=".25 .4" euler="60 20 0"',
    "ellipsoid": 'type="ellipsoid" size=".6 .3 .4"',
    "cylinder": 'type="cylinder" size=".35 .3" euler="20 30 0"',
    "hfield": 'type="hfield" hfield="h"',
    "mesh": 'type="mesh" mesh="m"',
    "sdf": 'type="mesh" mesh="plain"',
}


@pytest.fixture(scope="module")
def opened(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    folder, numbers = tmp_path_factory.mktemp("surfaces"), count()
    one = browser.new_page(viewport={"width": 640, "height": 480})
    one.said = []
    one.on("console", lambda message: one.said.append(message.text))
    one.on("pageerror", lambda error: one.said.append(str(error)))

    def page(found: Any) -> Any:
        one.said.clear()
        file = page_of(found, folder / f"{next(numbers)}.html")
        one.goto(f"{file.as_uri()}#t=0")
        one.locator("html[data-ready]").wait_for(state="attached")
        return one

    yield page
    one.close()


def picture_file() -> bytes:
    """A picture without symmetry: red grows to the right, green downward, blue in one quarter."""
    pixels = np.zeros((64, 96, 3), np.uint8)
    pixels[..., 0], pixels[..., 1] = np.linspace(40, 250, 96), np.linspace(40, 250, 64)[:, None]
    pixels[:32, :48, 2] = 200
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "png")
    return buffer.getvalue()


def of_texture(geom: str, look: str) -> mujoco.MjModel:
    xml = f"""<mujoco>{BARE}<asset>
    <texture name="flat" type="2d" file="t.png"/>
    <texture name="cube" type="cube" builtin="gradient" rgb1="1 1 0" rgb2="0 .3 .9"
      mark="cross" markrgb="1 1 1" width="64" height="64"/>
    <material name="flat" texture="flat" texrepeat="1 1"/>
    <material name="many" texture="flat" texrepeat="3 2"/>
    <material name="even" texture="flat" texrepeat="2 2" texuniform="true"/>
    <material name="cube" texture="cube"/>
    <hfield name="h" nrow="9" ncol="13" size=".6 .4 .3 .05" elevation="{HEIGHTS}"/>
    <mesh name="m" vertex="-.5 -.5 0 .5 -.5 0 .5 .5 .3 -.5 .5 .3 0 0 -.3"
      face="0 1 2 0 2 3 0 4 1 1 4 2 2 4 3 3 4 0" texcoord="0 1 1 1 1 0 0 0 .5 .5"/>
    <mesh name="plain" builtin="supertorus" params="24 .35 1 1"/>
    </asset><worldbody><geom {GEOMS[geom]} material="{look}"/></worldbody></mujoco>"""
    return mujoco.MjModel.from_xml_string(xml, {"t.png": picture_file()})


def compare(page: Any, found: Any, data: mujoco.MjData, time: float = 0.0) -> tuple[float, Any]:
    """Overlap of the outlines, and how far colours are away where neither has an edge."""
    model = found.world.model
    picture, covered = classic(model, data, found.camera, SIZE)
    pixels = drawn(page, SIZE, time, ["floor", "backdrop"])
    seen = pixels[..., 3] > 127
    both = covered & seen
    inside = both.copy()
    for axis in (0, 1):
        for way in (-2, -1, 1, 2):
            inside &= np.roll(both, way, axis)
            for each in (picture, pixels[..., :3]):
                step = np.abs(np.roll(each, way, axis).astype(int) - each).max(axis=-1)
                inside &= step < 25
    away = np.abs(picture.astype(int) - pixels[..., :3]).max(axis=-1)[inside]
    return overlap(covered, seen), away


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("geom", "look"),
    # A picture that is there once, `flat`, is one that is there 1 x 1 times.
    sampled(
        [
            [geom, look]
            for look in ("many", "cube", "even", "flat")
            for geom in GEOMS
            if look != "cube" or geom not in ("plane", "endless", "mesh")  # MuJoCo draws none there
        ],
        8,
    ),
)
def test_textures_are_at_the_same_places_as_in_our_images(
    opened: Callable[..., Any], geom: str, look: str
) -> None:
    model = of_texture(geom, look)
    (data,) = rolled_out(model, 1, 0)
    found = captured(model, [data], CAMERA)
    page = opened(found)
    outline, away = compare(page, found, data)
    assert page.said == []
    assert outline >= OUTLINE
    assert len(away) > 1500
    assert np.percentile(away, 95) <= LEVELS


def skinned() -> str:
    """Two bones in a box whose skin bends: vertices belong to the bones by halves and thirds."""
    rows = np.linspace(0, 1, 9)
    points = [(x - 0.5, y, z) for x in rows for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    faces = []
    for k in range(8):
        a = 4 * k
        for p, q in ((0, 1), (1, 3), (3, 2), (2, 0)):
            faces += [(a + p, a + q, a + 4 + q), (a + p, a + 4 + q, a + 4 + p)]
    faces += [(0, 2, 1), (1, 2, 3), (32, 33, 34), (33, 35, 34)]
    share = np.repeat(np.clip(1.5 - 2 * rows, 0, 1), 4)

    def words(numbers: Any) -> str:
        return " ".join(f"{each:g}" for each in np.ravel(numbers))

    def bone(name: str, at: str, weights: Any) -> str:
        (ids,) = np.nonzero(weights)
        return (
            f'<bone body="{name}" bindpos="{at}" bindquat="1 0 0 0" vertid="{words(ids)}" '
            f'vertweight="{words(weights[ids])}"/>'
        )

    return f"""<mujoco>{BARE}<option gravity="0 0 0"/>
    <asset><material name="blue" rgba=".1 .3 .9 1"/></asset>
    <worldbody><body name="a" pos="-.25 0 0"><geom size=".02" group="4"/>
    <body name="b" pos=".5 0 0"><joint name="bend" axis="0 1 0" pos="-.25 0 0"/>
    <geom size=".02" group="4"/></body></body></worldbody>
    <deformable><skin name="s" material="blue" inflate=".01" vertex="{words(points)}"
    face="{words(faces)}">{bone("a", "-.25 0 0", share)}{bone("b", ".25 0 0", 1 - share)}
    </skin></deformable><keyframe><key qpos="0"/></keyframe></mujoco>"""


SOFT = {
    "tendon": f"""<mujoco>{BARE}<worldbody>
      <site name="a" pos="-.6 0 .3" size=".02"/><site name="side" pos="0 0 .5" size=".01"/>
      <geom name="w" type="cylinder" size=".15 .2" euler="90 0 0" rgba=".8 .8 .2 1"/>
      <body pos=".6 0 .3"><joint axis="0 0 1" type="slide"/><geom size=".05" rgba="1 0 0 1"/>
      <site name="b" size=".02"/></body></worldbody>
      <tendon><spatial width=".03" rgba=".1 .7 .3 1"><site site="a"/>
      <geom geom="w" sidesite="side"/>
      <site site="b"/></spatial></tendon></mujoco>""",
    "cable": f"""<mujoco>{BARE}<worldbody>
      <flexcomp name="f" type="grid" count="20 1 1" dim="1" spacing=".08 .1 .1" radius=".03"
        rgba=".9 .5 .1 1" mass="1"><edge equality="true"/><pin id="0"/></flexcomp>
      </worldbody></mujoco>""",
    "cloth": f"""<mujoco>{BARE}<worldbody>
      <flexcomp name="f" type="grid" count="7 7 1" dim="2" spacing=".1 .1 .1" radius=".02"
        rgba=".9 .2 .5 1" mass="1"><edge equality="true"/><pin id="0 6"/></flexcomp>
      </worldbody></mujoco>""",
    "solid": f"""<mujoco>{BARE}<worldbody><geom type="plane" size="1 1 .1" pos="0 0 -.3"/>
      <flexcomp name="f" type="grid" count="4 4 4" dim="3" spacing=".1 .1 .1" radius=".03"
        rgba=".2 .7 .8 1" mass="1"><edge equality="true"/></flexcomp></worldbody></mujoco>""",
    "skin": skinned(),
}  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize("name", sampled(list(SOFT), 2))
def test_soft_bodies_move_as_in_our_images(opened: Callable[..., Any], name: str) -> None:
    model = mujoco.MjModel.from_xml_string(SOFT[name])
    states = rolled_out(model, 5, 30)
    if name == "skin":
        for k, data in enumerate(states):
            data.qpos[0] = 0.3 * k
            mujoco.mj_forward(model, data)
    found = captured(model, states, "60,-25,2.4,0,0,0")
    page = opened(found)
    first, _ = classic(model, states[0], found.camera, SIZE)
    last, _ = classic(model, states[-1], found.camera, SIZE)
    assert np.abs(first.astype(int) - last).max() > 50  # it moves
    for k in (0, 2, 4):
        outline, away = compare(page, found, states[k], k / 10)
        # The ends of cables are round here, and open in MuJoCo.
        assert outline >= (0.92 if name == "cable" else OUTLINE), k
        assert np.percentile(away, 95) <= LEVELS
    assert page.said == []


@pytest.mark.thorough
def test_page_of_a_dm_control_model_looks_like_mujoco(
    opened: Callable[..., Any],
) -> None:
    suite = pytest.importorskip("dm_control.suite.quadruped")
    xml = suite.make_model(terrain=True, rangefinders=False, walls_and_ball=True)
    model = mujoco.MjModel.from_xml_string(xml, suite.common.ASSETS)
    states = rolled_out(model, 2, 10)
    page = opened(found := captured(model, states, "120,-25,6,0,0,.5"))
    outline, _ = compare(page, found, states[1], 0.1)
    assert outline >= OUTLINE
    assert page.said == []
    assert page.evaluate("player.calls") <= 12
    # Nothing to switch or to choose where there is no joint.
    page.locator("#open").click()
    page.locator("#panel label.check").wait_for()
    assert page.locator("#panel label.check").all_inner_texts() == ["shadows"]
    assert page.locator("#areas").is_hidden()


def test_plane_is_transparent_from_below(opened: Callable[..., Any]) -> None:
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>{BARE}<worldbody>
    <geom type="plane" size=".6 .5 .1" rgba="1 .8 0 1"/>
    <geom type="sphere" size=".2" pos="0 0 .4" rgba="0 .2 1 1"/></worldbody></mujoco>""")
    (data,) = rolled_out(model, 1, 0)
    page = opened(found := captured(model, [data], "60,35,2.2,0,0,.2"))
    pixels = drawn(page, SIZE, 0.0, ["floor", "backdrop"])
    alpha = pixels[..., 3]
    assert ((alpha > 60) & (alpha < 100)).sum() > 5000
    _, covered = classic(model, data, found.camera, SIZE)
    assert overlap(covered, alpha > 30) >= OUTLINE


@pytest.mark.thorough
def test_plane_reflects(opened: Callable[..., Any]) -> None:
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>{BARE}
    <asset><material name="wet" rgba=".1 .1 .3 1" reflectance=".6"/></asset><worldbody>
    <light type="directional" diffuse="0 0 0" specular="0 0 0"/>
    <geom type="plane" size="1 1 .1" material="wet"/>
    <geom type="box" size=".3 .2 .15" pos="0 0 .3" rgba="1 .5 .1 1"/></worldbody></mujoco>""")
    (data,) = rolled_out(model, 1, 0)
    page = opened(found := captured(model, [data], "60,-25,2.6,0,0,.2"))
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        renderer.update_scene(data, found.camera)
        picture = renderer.render().astype(int)
    without = drawn(page, SIZE, 0.0).astype(int)
    pixels = drawn(page, SIZE, 0.0, shadows=True).astype(int)
    is_mirrored = np.abs(pixels - without)[..., :3].max(axis=-1) > 40
    assert is_mirrored.sum() > 2000
    away = np.abs(pixels[..., :3] - picture).max(axis=-1)[is_mirrored]
    assert np.percentile(away, 90) <= LEVELS
    assert page.said == []


def test_light_of_the_model_shines_from_its_position(opened: Callable[..., Any]) -> None:
    model = mujoco.MjModel.from_xml_string("""<mujoco>
    <visual><headlight ambient=".2 .2 .2" diffuse="0 0 0" specular="0 0 0"/></visual>
    <worldbody><light type="directional" dir="0 1 -1" diffuse=".6 .3 .3" specular="0 0 0"/>
    <geom type="box" size=".4 .4 .4"/></worldbody></mujoco>""")
    (data,) = rolled_out(model, 1, 0)
    page = opened(found := captured(model, [data], CAMERA))
    outline, away = compare(page, found, data)
    assert outline >= OUTLINE and np.percentile(away, 95) <= LEVELS


def test_our_scenes_have_no_extra_entries_in_the_page_header() -> None:
    import json

    from sero_mj.load import load_scene
    from sero_mj.viewer.player.capture import capture
    from sero_mj.viewer.player.encode import encode

    data = encode(capture(load_scene("lwr")), "lwr")
    head = json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])
    for key in ("textures", "skins", "flexes", "lights", "soft", "tendons"):
        assert key not in head


@pytest.mark.extensions
@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.parametrize("look", ["light", "dark"])
def test_page_looks_like_the_filament_image_of_the_scene(
    opened: Callable[..., Any], look: Any
) -> None:
    from sero_mj.extensions.filament.probe import filament_problem

    if (problem := filament_problem()) is not None:
        pytest.skip(problem)
    scene = load_scene("lwr")
    scene.view.look = look
    found = capture(scene)
    with HeadlessRenderer(found.world, *SIZE, renderer="filament") as renderer:
        picture = np.array(renderer.render(found.world.make_data())).astype(int)
    page = opened(found)
    page.evaluate("look => player.stage.setLook(look)", look)
    pixels = drawn(page, SIZE, 0.0, shadows=True)[..., :3].astype(int)
    assert page.said == []
    away = np.abs(picture - pixels).max(axis=-1)
    assert np.median(away) <= 4 and np.percentile(away, 90) <= 9
    robot = np.asarray(classic(found.world.model, found.world.make_data(), found.camera, SIZE)[1])
    shares = pixels[robot].mean() / picture[robot].mean()
    assert shares == pytest.approx(1.0, abs=0.07)  # links do not hide the sky from each other


def test_robot_occludes_the_sky_light_of_the_floor(opened: Callable[..., Any]) -> None:
    page = opened(capture(load_scene("lwr")))
    hidden = drawn(page, SIZE, 0.0, shadows=False)[..., :3].astype(int)
    page.evaluate("player.stage.surroundings.occlusion.capsules = []")
    darker = (drawn(page, SIZE, 0.0, shadows=False)[..., :3].astype(int) - hidden).max(axis=-1)
    assert page.said == []
    assert darker.min() >= -1 and 15 < darker.max() < 60
    base = page.evaluate("player.stage.pixel(player.stage.scene.position)")  # the world's origin
    row, column = np.unravel_index(darker.argmax(), darker.shape)
    assert np.hypot(row - base["y"], column - base["x"]) < 0.1 * SIZE[0]
    assert np.percentile(darker, 80) <= 1  # links, sky and the rest of the floor are as before
