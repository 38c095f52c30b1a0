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
from model_pages import drawn, overlap, page_of
from numpy.typing import NDArray
from plugin_tools import install
from web_tools import MISSING

from sero_mj import Scene, SerialRobot, World, load_scene
from sero_mj.base.plugins import forget_plugins
from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.declared.cartesian import SmartArrow
from sero_mj.robots.declared.scene import SceneToggles
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import GeomBuffer, Kind
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.round_arrows import ARROW_GEOMS
from sero_mj.viewer.decor.scene_writer import SceneWriter
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.camera import find_camera
from sero_mj.viewer.player.capture import _ARROW_GEOMS, capture

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")

SIZE = (1200, 800)
OUTLINE = 0.98
FAR = 1e-4  # m, between a vertex of a page and Python's
LWR_LIMITS = np.array([200.0, 200.0, 100.0, 100.0, 100.0, 30.0, 30.0])

# Places of the vertices of the round arrows, in their own frames, as the shader computes them.
VERTICES = """([joints, time]) => {
    player.recording.seek(time);
    player.draw();
    const { stage } = player, { arrows } = stage;
    const gl = document.createElement("canvas").getContext("webgl2");
    const program = gl.createProgram();
    const sources = [[gl.VERTEX_SHADER, `#version 300 es
        in vec4 along; in vec3 across; uniform vec4 how; uniform float striped; out vec3 found;
        void main() { float dark; ${arrows.formula}
            found = transformed; gl_Position = vec4(dark); }`],
        [gl.FRAGMENT_SHADER, "#version 300 es\\nvoid main() {}"]];
    for (const [kind, text] of sources) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw gl.getShaderInfoLog(shader);
        gl.attachShader(program, shader);
    }
    gl.transformFeedbackVaryings(program, ["found"], gl.SEPARATE_ATTRIBS);
    gl.linkProgram(program);
    gl.useProgram(program);
    const { attributes } = arrows.mesh.geometry, count = attributes.along.count;
    for (const [name, size] of [["along", 4], ["across", 3]]) {
        const place = gl.getAttribLocation(program, name);
        gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ARRAY_BUFFER, attributes[name].array, gl.STATIC_DRAW);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
    }
    const out = gl.createBuffer();
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, out);
    gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 12 * count, gl.STATIC_READ);
    gl.enable(gl.RASTERIZER_DISCARD);
    const found = joints.map((joint) => {
        const k = arrows.joints.indexOf(joint), how = arrows.how.array.slice(4 * k, 4 * k + 4);
        gl.uniform4fv(gl.getUniformLocation(program, "how"), how);
        gl.beginTransformFeedback(gl.POINTS);
        gl.drawArrays(gl.POINTS, 0, count);
        gl.endTransformFeedback();
        const places = new Float32Array(3 * count);
        gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, places);
        return { places: [...places], site: [...stage.sites[joint].elements], shown: how[0] > 0 };
    });
    gl.getExtension("WEBGL_lose_context").loseContext();
    return found;
}"""


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


def buffer_of(
    world: World, data: mujoco.MjData, camera: str | None = None, most: int = ARROW_GEOMS
) -> GeomBuffer:
    """What Python draws, with at most so many geoms for each arrow."""
    scene, free = mujoco.MjvScene(world.model, 1000), find_camera(world, camera)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    mujoco.mjv_updateScene(world.model, data, mujoco.MjvOption(), None, free, everything, scene)
    view = ImageView.of_scene(scene, *SIZE)
    return Decor(world, arrow_geoms=most).draw(data, Toggles(world), view)


def corners_of(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Corners of boxes (b, 8, 3) and of triangles (t, 3, 3), m."""
    is_box = rows["type"] == int(mujoco.mjtGeom.mjGEOM_BOX)
    boxes, heads = rows[is_box], rows[~is_box]
    bits = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    own = bits * boxes["size"].astype(float)[:, None]
    of_boxes = boxes["pos"][:, None] + np.einsum("bij,bkj->bki", boxes["mat"].astype(float), own)
    edges = heads["mat"].astype(float) * heads["size"].astype(float)[:, None, :]
    first = heads["pos"].astype(float)
    ends = np.stack([first, first + edges[..., 0], first + edges[..., 1]], axis=1)
    return of_boxes, ends


def farthest(some: NDArray[Any], others: NDArray[Any]) -> float:
    """Largest distance from a point to the nearest of others, both ways, m."""
    apart = np.linalg.norm(some[:, None] - others[None], axis=2)
    return float(max(apart.min(axis=1).max(), apart.min(axis=0).max()))


def check_arrows(page: Any, world: World, data: mujoco.MjData, time: float) -> int:
    """Compares all round arrows at a time (s); returns how many there are."""
    buffer = buffer_of(world, data)
    kinds, items = buffer.kinds[: buffer.count], buffer.items[: buffer.count]
    count = 0
    joints = [*range(len(world.joints.names))]
    for joint, found in zip(joints, page.evaluate(VERTICES, [joints, time]), strict=True):
        rows = buffer.rows[: buffer.count][(kinds == Kind.ARROW) & (items == joint)]
        assert found["shown"] == bool(len(rows))
        if not len(rows):
            continue
        count += 1
        boxes, heads = corners_of(rows)
        site = np.reshape(found["site"], (4, 4)).T
        places = np.reshape(found["places"], (-1, 3)) @ site[:3, :3].T + site[:3, 3]
        # Box by box and triangle by triangle: 36 and 3 vertices each.
        of_boxes = places[: 36 * len(boxes)].reshape(-1, 36, 3)
        of_heads = places[36 * len(boxes) :].reshape(-1, 3, 3)
        assert of_heads.shape == heads.shape
        assert max(farthest(a, b) for a, b in zip(of_boxes, boxes, strict=True)) < FAR
        assert farthest(of_heads.reshape(-1, 3), heads.reshape(-1, 3)) < FAR
    return count


@pytest.mark.thorough
@pytest.mark.parametrize("sign", sampled([1.0, -1.0], 1))
def test_round_arrow_has_the_vertices_of_the_python_geoms(
    opened: Callable[..., Any], sign: float
) -> None:
    shares = sign * np.array([0.005, 0.02, 0.1, 0.45, 1.0, 1.3, 3.0])
    robot = SerialRobot.from_model(
        "lwr", torques=shares * LWR_LIMITS, show_arrows=True,
        joint_angles=[0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2],
    )  # fmt: skip
    scene = Scene(robots=[robot])
    page = opened(capture(scene))
    world = World(scene)
    assert check_arrows(page, world, world.make_data(), 0.0) == 7


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
        buffer = buffer_of(world, data, camera, _ARROW_GEOMS)
        buffer.rows["label"] = b""  # which is HTML on pages
        SceneWriter(renderer.scene).add(buffer, with_text=False)
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
