"""A run's page in Chromium, from disk, offline: numbers, clicks, pictures, what it refuses."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from decor_tools import belonging, look, view_at
from web_tools import MISSING

import sero_mj
from sero_mj.data.drive.mirror import Mirror
from sero_mj.load import load_scene
from sero_mj.robots.declared.robot_parts import ARROW_QUANTITIES
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.player.capture import Mark, capture
from sero_mj.viewer.player.page import write_page
from sero_mj.viewer.web.page_state import billboard_lines

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")

FPS = 20
GEOM = mujoco.mjtGeom
SLIDES = """
[robots.stanford]
model = "stanford"
joint_angles = [0.0, 1.0, 0.4, 0.0, 0.5, 0.0]
show_arrows = true
[run]
duration = 1.0
[controllers.stanford]
kind = "joint_impedance"
stiffness = [800, 800, 2000, 200, 200, 200]
[disturbances.push]
kind = "force"
at = "stanford/flange"
force = [60.0, 60.0, -60.0]
begin = 0.48
"""
HOSTILE = "</script><script>globalThis.bad=1</script><img src=x onerror='globalThis.bad=2'>"
SIZE = (640, 400)
IMAGE = (1280, 900)
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
# What the robots cover, without decor: alpha of the picture, one digit a pixel, top row first.
SILHOUETTE = """([width, height, time]) => {
    const { stage } = player;
    player.recording.seek(time);
    stage.resize(width, height);
    stage.renderer.setPixelRatio(1);
    stage.renderer.setSize(width, height, false);
    stage.chooseCamera(-1);
    player.stage.hasShadows = false;
    player.draw();
    const { robots, items, surroundings: { floor, backdrop } } = stage;
    for (const each of [robots.depth, robots.ghosts, items.group, floor, backdrop])
        each.visible = false;
    stage.draw();
    const gl = stage.renderer.getContext(), bytes = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    for (const each of [robots.depth, robots.ghosts, items.group, floor, backdrop])
        each.visible = true;
    let digits = "";
    for (let y = height - 1; y >= 0; y--)
        for (let x = 0; x < width; x++) digits += bytes[4 * (y * width + x) + 3] > 127 ? "1" : "0";
    return digits;
}"""


@pytest.fixture(scope="module")
def scene() -> sero_mj.Scene:
    return load_scene("impedance_push")


@pytest.fixture(scope="module")
def file(scene: sero_mj.Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "push.html"
    marks = [Mark(0.5, 1.5, HOSTILE, "push"), Mark(1.0, 1.0, "it settles", "failed")]
    sero_mj.export_html(scene, path, title=HOSTILE, marks=marks, fps=FPS, seconds=2.0)
    return path


def opened(browser: Any, file: Path, *, at: float = 1.0, before: str = "", **options: Any) -> Any:
    options = {"viewport": {"width": 900, "height": 640}, **options}
    page = browser.new_context(offline=True, **options).new_page()
    page.said, page.asked = [], []
    page.on("console", lambda message: page.said.append(message.text))
    page.on("pageerror", lambda error: page.said.append(str(error)))
    page.on("request", lambda request: page.asked.append(request.url))
    if before:
        page.add_init_script(before)
    page.goto(f"{file.as_uri()}#t={at}")
    page.locator("html[data-ready]").wait_for(state="attached")
    return page


@pytest.fixture(scope="module")
def page(browser: Any, file: Path) -> Any:
    return opened(browser, file)


@pytest.fixture(scope="module")
def phone(browser: Any, file: Path) -> Any:
    return opened(browser, file, **PHONE)


def test_page_opens_alone_and_draws_in_few_calls(page: Any, file: Path) -> None:
    assert page.said == []
    assert [url for url in page.asked if not url.startswith(("blob:", "data:"))] == [file.as_uri()]
    assert 0 < page.evaluate("player.calls") <= 20


def test_numbers_are_those_of_the_run(page: Any, scene: sero_mj.Scene) -> None:
    log = scene.sources["simulation"].run.log
    frames = (0, 7, 20, 33, 40)
    rows = [int(np.argmin(np.abs(log.times - frame / FPS))) for frame in frames]
    for key in ("torques", "commanded_torques", "joint_angles"):
        found = page.evaluate(
            "([key, frames]) => frames.map(f => [0,1,2,3,4,5,6].map(j =>"
            " player.run.values[key][j * player.run.frames + f]))",
            [key, list(frames)],
        )
        assert np.array_equal(found, log.of("lwr", key)[rows])


def cards_of_image(scene: sero_mj.Scene, time: float) -> set[tuple[str, ...]]:
    """Title, labels and values of the cards that an image of a scene shows."""
    with Mirror(scene) as mirror:
        mirror.advance(time)
        decor, toggles = Decor(mirror.world), Toggles(mirror.world)
        toggles.billboards[:] = mirror.world.joints.owner == 0
        decor.draw(mirror.data, toggles, look((2.6, -2.2, 1.2), (0, 0, 0.5), *IMAGE))
        texts = [
            text for each in decor.panels if each.kind == Kind.BILLBOARD for text in each.texts
        ]
    cards = [billboard_lines(text) for text in texts]
    return {(title, *(word for line in lines for word in line)) for title, lines in cards}


CARDS = """() => [...document.querySelectorAll(".card")].filter(e => e.offsetWidth).map(card =>
    [card.querySelector("i").textContent, ...[...card.querySelectorAll("span")].flatMap(line =>
        [line.querySelector("i").textContent, line.querySelector("b").textContent])])"""


@pytest.mark.parametrize("lines", [None, ["commanded_torques", "torques", "joint_angles"]])
def test_page_shows_the_billboards_of_an_image(browser: Any, tmp_path: Path, lines: Any) -> None:
    scene = load_scene("impedance_push")
    if lines:
        scene.robots["lwr"].billboard_lines = lines
    write_page(capture(scene, fps=FPS, seconds=2.0), tmp_path / "push.html")
    viewport = dict(zip(("width", "height"), IMAGE, strict=True))
    page = opened(browser, tmp_path / "push.html", at=1.5, viewport=viewport)
    page.evaluate("player.draw()")
    cards = {tuple(card) for card in page.evaluate(CARDS)}
    assert len(cards) == 7 and cards == cards_of_image(scene, 1.5)
    page.context.close()


def shown_in(choice: Any) -> str:
    return str(choice.evaluate("each => each.selectedOptions[0].text"))


def test_arrows_show_torques_and_their_errors_by_turns(page: Any) -> None:
    page.evaluate("player.recording.seek(1.0); player.recording.hasPanel = true; player.draw()")
    choice, legend = page.get_by_label("quantity of arrows"), page.locator("#notes")
    widths = """() => {
        const { run: { arrows }, geoms: { of, sizes, count } } = player.recording, widths = [];
        for (let k = 0; k < count; k++) {
            const ratio = arrows.ratios[of[3 * k + 2] - arrows.shapes.first];
            if (of[3 * k] === 1) widths.push(sizes[3 * k + 2] * ratio);
        }
        return widths;
    }"""
    told, of_torque = legend.inner_text(), page.evaluate(widths)
    assert shown_in(choice) == "torque" and "round arrows: joint torque\n" in told
    page.keyboard.press("q")
    page.evaluate("player.draw()")
    assert shown_in(choice) == "torque error"
    of_error = page.evaluate(widths)
    cards = page.locator(".card").all_inner_texts()
    assert len(cards) == 7 and all("err" in card for card in cards)
    changed = "round arrows: torque error, commanded - measured\n"
    assert legend.inner_text() == told.replace("round arrows: joint torque\n", changed)
    error = page.evaluate("""() => {
        const { run: { joints, frames, values }, clock } = player.recording;
        return joints.map((_, j) => values.torque_error[j * frames + clock.frame]);
    }""")
    assert max(map(abs, error)) < 1.0  # Nm
    assert max(of_torque) > 5 * max(of_error, default=0.0)
    choice.select_option("torque")
    page.evaluate("player.draw()")
    assert (page.evaluate(widths), legend.inner_text()) == (of_torque, told)
    page.evaluate("player.recording.hasPanel = false; player.draw()")


def test_legend_describes_visible_arrows(page: Any) -> None:
    notes = page.locator("#notes")
    page.evaluate("player.recording.seek(1.5); player.draw()")
    assert "push: 80 mm long = 20 N" in notes.inner_text()
    page.evaluate("player.recording.seek(0.5); player.draw()")
    assert "push" not in notes.inner_text()
    assert "round arrows" in notes.inner_text()
    page.evaluate("player.recording.seek(1.5); player.recording.toggle('arrows'); player.draw()")
    assert notes.is_hidden()
    page.evaluate("player.recording.toggle('arrows'); player.draw()")
    assert "push: " in notes.inner_text()


def test_arrows_of_prismatic_joints_equal_those_of_python(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "slides.toml").write_text(SLIDES)
    scene = load_scene(tmp_path / "slides.toml")
    found = capture(scene, fps=FPS, seconds=1.0)
    write_page(found, tmp_path / "slides.html")
    page = opened(browser, tmp_path / "slides.html", at=0.5)
    assert "round arrows: joint torque, or force\n" in page.locator("#notes").inner_text()
    arrow = """() => {
        const { of, count, positions, rotations, sizes, rgba } = player.recording.geoms, at = [];
        for (let k = 0; k < count; k++) if (of[3 * k] === 1) at.push(k);
        return at.map(k => [of[3 * k + 1], [...positions.slice(3 * k, 3 * k + 3)],
            [...rotations.slice(4 * k, 4 * k + 4)], [...sizes.slice(3 * k, 3 * k + 3)],
            [...rgba.slice(4 * k, 4 * k + 4)]]);
    }"""
    error = "torque error, commanded - measured, or force\n"
    with Mirror(scene) as mirror:
        mirror.advance(0.5)
        decor, toggles = Decor(mirror.world), Toggles(mirror.world)
        for code, quantity in enumerate(("torques", "torque_error")):
            assert ARROW_QUANTITIES[code] == quantity
            toggles.arrow_quantity[:] = code
            buffer = decor.draw(mirror.data, toggles, view_at(distance=3))
            rows = belonging(buffer, Kind.ARROW, 2)
            sent = [each for each in page.evaluate(arrow) if each[0] == 2]
            assert len(sent) == len(rows) == 2
            for row, (_, place, turn, size, rgba) in zip(rows, sent, strict=True):
                assert np.allclose(place, row["pos"], atol=2e-4)
                mat = np.zeros(9)
                mujoco.mju_quat2Mat(mat, np.array(turn))
                assert np.allclose(mat, row["mat"].ravel(), atol=1e-3)
                assert np.allclose(size, row["size"], rtol=1e-3)
                assert np.allclose(rgba, 255 * row["rgba"], atol=1)
            if quantity == "torques":
                page.keyboard.press("q")
                page.locator("#notes", has_text=error).wait_for()
    page.evaluate("player.recording.select({ joint: 2 })")
    page.locator("#details h2", has_text="J3").wait_for()
    page.context.close()


def test_untrusted_names_are_shown_as_text(page: Any) -> None:
    assert page.locator("h1").inner_text() == HOSTILE.replace("_", " ")
    assert page.locator(".mark.push").get_attribute("title").endswith(HOSTILE)
    assert page.evaluate("globalThis.bad") is None


def test_page_shows_a_failed_expectation(page: Any) -> None:
    assert "1 of 1" in page.locator("#about").inner_text()
    told, time = page.locator(".told"), page.locator("#timeline input[type=range]")
    page.evaluate("player.recording.seek(0.2)")
    told.wait_for(state="hidden")
    assert time.get_attribute("aria-valuetext") == "0.20 s / 2.00 s"
    page.locator(".mark.failed").click()
    assert page.evaluate("player.recording.clock.time") == 1.0
    told.wait_for(state="visible")
    assert told.inner_text() == "1.00 s: failed: it settles"
    assert time.get_attribute("aria-valuetext") == "1.00 s / 2.00 s, 1.00 s: failed: it settles"


def boxes(page: Any, *selectors: str) -> list[tuple[float, float, float, float]]:
    """Left, top, right and bottom of what is seen of some elements, pixels."""
    found = page.evaluate(
        """selectors => selectors.flatMap(each => [...document.querySelectorAll(each)])
        .map(each => each.getBoundingClientRect()).filter(({ width }) => width)
        .map(({ left, top, right, bottom }) => [left, top, right, bottom])""",
        list(selectors),
    )
    return [tuple(each) for each in found]


def covered(page: Any, *selectors: str) -> list[Any]:
    """Pairs of elements of which one covers the other by more than a pixel."""
    return [
        (one, other)
        for one, other in itertools.combinations(boxes(page, *selectors), 2)
        if min(one[2], other[2]) - max(one[0], other[0]) > 1
        and min(one[3], other[3]) - max(one[1], other[1]) > 1
    ]


NEARER = """() => {
    const { camera, orbit } = player.stage;
    camera.position.sub(orbit.target).multiplyScalar(.55).add(orbit.target);
    orbit.update();
    player.draw();
}"""


# A pixel of the page at which nothing but the background is.
FREE = """() => {
    const { canvas, size: { width, height } } = player.stage;
    for (let y = 10; y < height; y += 10)
        for (let x = 10; x < width; x += 10)
            if (document.elementFromPoint(x, y) === canvas && !player.stage.pick(x, y))
                return [x, y];
}"""


@pytest.mark.parametrize("size", [(1280, 800), (900, 640), (390, 844)])
def test_messages_cover_neither_legend_nor_billboards(
    browser: Any, file: Path, size: tuple[int, int]
) -> None:
    width, height = size
    page = opened(browser, file, viewport={"width": width, "height": height})
    page.evaluate(
        "player.recording.select({ joint: 1 }); player.recording.nextQuantity(); player.draw()"
    )
    for time in (0.5, 1.0):
        page.evaluate("time => { player.recording.seek(time); player.draw(); }", time)
        assert page.locator(".told").is_visible()
        seen = (".told", "#notes", "#details", ".card")
        assert len(boxes(page, *seen)) >= 8 and covered(page, *seen) == []
        page.evaluate(NEARER)
        assert covered(page, *seen) == []
    page.context.close()


def test_message_disappears_at_other_times(page: Any) -> None:
    for time, is_told in ((1.0, True), (1.4, True), (1.6, False), (0.95, False), (0.99, True)):
        page.evaluate("time => { player.recording.seek(time); player.draw(); }", time)
        assert page.locator(".told.failed").is_visible() == is_told


def test_label_of_a_mark_does_not_overlap_other_marks(browser: Any, tmp_path: Path) -> None:
    scene = load_scene("impedance_push")
    marks = [Mark(0.5, 1.9, "push", "push")]
    marks += [Mark(time, time, "held", "held") for time in (0.52, 0.54, 1.5)]
    sero_mj.export_html(scene, tmp_path / "push.html", marks=marks, fps=FPS, seconds=2.0)
    page = opened(browser, tmp_path / "push.html")
    for width in (900, 390):
        page.set_viewport_size({"width": width, "height": 800})
        page.evaluate("() => new Promise(requestAnimationFrame)")
        page.evaluate("() => new Promise(requestAnimationFrame)")
        ((left, _, right, _),) = boxes(page, ".mark.push span")
        words = page.locator(".mark.push span")
        assert words.evaluate("each => each.scrollWidth <= each.clientWidth")
        for begin, _, end, _ in boxes(page, ".mark.held"):
            assert end <= left + 1 or begin >= right - 1
    page.context.close()


def test_marks_at_the_end_fit_a_phone_and_leave_the_slider_free(
    browser: Any, tmp_path: Path
) -> None:
    marks = [Mark(time, time, "held", "held") for time in (0.0, 1.0, 1.95, 2.0)]
    scene, path = load_scene("impedance_push"), tmp_path / "push.html"
    sero_mj.export_html(scene, path, marks=marks, fps=FPS, seconds=2.0)
    page = opened(browser, path, at=0.5, **PHONE)
    assert page.evaluate("[document.documentElement.scrollWidth, innerWidth]") == [390, 390]
    ((left, top, right, bottom),) = boxes(page, "#timeline input[type=range]")
    assert all(mark[3] <= top + 1 for mark in boxes(page, ".mark"))
    page.touchscreen.tap((left + right) / 2 + 40, (top + bottom) / 2)
    assert page.evaluate("player.recording.clock.time") not in (0.5, 1.0)
    ((left, top, right, bottom), *_) = boxes(page, ".mark")[1:]
    page.touchscreen.tap((left + right) / 2 + 12, (top + bottom) / 2)  # beside it
    assert page.evaluate("player.recording.clock.time") == 1.0
    page.context.close()


def test_phone_shows_the_arrow_quantity_and_can_change_it(phone: Any) -> None:
    phone.evaluate("player.recording.select(null); player.recording.seek(1.0); player.draw()")
    choice, legend = phone.get_by_label("quantity of arrows"), phone.locator("#notes")
    assert "round arrows: joint torque\n" in legend.inner_text()
    for word in ("torque error", "torque"):
        phone.locator("#open").tap()
        choice.select_option(word)
        phone.locator("#open").tap()
        choice.wait_for(state="hidden")
        assert f"round arrows: {'joint ' * (word == 'torque')}{word}" in legend.inner_text()
        assert covered(phone, "#notes", ".told", ".card", "#tools button") == []
    phone.locator(".card", has_text="A2").tap()
    phone.locator("#details h2", has_text="lwr/A2").wait_for()
    assert legend.is_hidden() and covered(phone, "#details", ".told", ".card") == []
    place = phone.evaluate(FREE)
    phone.touchscreen.tap(*place)
    phone.locator("#details").wait_for(state="hidden")
    assert legend.is_visible()


def test_plot_names_its_signals_and_units(page: Any) -> None:
    page.evaluate("player.recording.choose(2); player.draw()")
    names = page.locator(".graph .names").inner_text().split("\n")
    assert " ".join(names).split() == ["torque", "[Nm]", "measured", "commanded"]
    assert (
        page.locator(".graph [role=img]")
        .get_attribute("aria-label")
        .startswith("lwr/E1, torque [Nm]: ")
    )


def test_low_plot_of_nearly_zero_values_has_a_scale(phone: Any) -> None:
    numbers = """async (joint) => {
        player.recording.choose(joint);
        player.draw();
        await new Promise(requestAnimationFrame);
        const { areas } = player.surround.areas, { list } = areas.get("plot").tree;
        return list.widgets.get("plot:plot").graph.plot.axes[1]._values;
    }"""
    for joint in range(7):
        found = phone.evaluate(numbers, joint)
        assert len(found) > 1 and len(set(found)) == len(found)


def test_zero_angle_has_no_sign(page: Any) -> None:
    page.evaluate("""() => {
        const { joint_angles: angles } = player.run.values;
        const [before] = angles;
        angles[0] = -1e-5;
        player.recording.seek(0);
        player.recording.select({ joint: 0 });
        player.draw();
        angles[0] = before;
    }""")
    assert "0.000 rad" in page.locator("#details").inner_text()
    assert "-0.000" not in page.locator("#details").inner_text()


def test_status_has_a_background_and_is_above_billboards(page: Any) -> None:
    seen = page.evaluate("""() => ["names", "problem", "cards"].map(id => {
        const { backgroundColor } = getComputedStyle(document.getElementById(id));
        const own = document.getElementById(id).closest("header, #problem, #cards");
        const { zIndex } = getComputedStyle(own);
        return [Number(/([\\d.]+)\\)/.exec(backgroundColor)[1]), Number(zIndex)];
    })""")
    (names, over), (problem, most), (_, cards) = seen
    assert min(names, problem) > 0.9
    assert most > over > cards


@pytest.mark.thorough
@pytest.mark.parametrize(("look", "scheme", "shown"), [
    ("dark", "light", "dark"), ("light", "dark", "light"), (None, "dark", "dark"),
])  # fmt: skip
def test_page_opens_in_the_requested_look(
    browser: Any, tmp_path: Path, look: Any, scheme: str, shown: str
) -> None:
    scene = load_scene("lwr")
    if look:
        scene.view.look = look
    write_page(capture(scene), tmp_path / "lwr.html")
    page = opened(browser, tmp_path / "lwr.html", color_scheme=scheme)
    assert page.evaluate("document.documentElement.dataset.look") == shown
    page.emulate_media(color_scheme=shown)
    page.emulate_media(color_scheme=scheme)  # as where the browser changes at dusk
    assert page.evaluate("player.view.look") == shown
    page.locator("#look").click()
    assert page.evaluate("document.documentElement.dataset.look") != shown
    page.context.close()


def test_click_on_a_billboard_link_or_arrow_shows_its_values(page: Any) -> None:
    page.evaluate("player.recording.seek(1.5)")
    page.locator(".card", has_text="A3").click()
    page.locator("#details h2", has_text="lwr/A3").wait_for()
    torque = page.evaluate("player.run.values.torques[3 * player.run.frames + 30]")
    details = page.locator("#details").inner_text()
    assert "lwr/A3" in details
    assert f"{torque:.1f} Nm" in details

    pixels = page.evaluate("""() => {
        const { stage } = player, place = stage.camera.position.clone(), found = {};
        for (let y = 60; y < stage.size.height; y += 4)
            for (let x = 0; x < stage.size.width; x += 4) {
                const hit = stage.pick(x, y);
                if (!hit) continue;
                found[hit.kind ? "vector" : hit.body ? hit.body : "arrow"] ??= [x, y];
            }
        const { left, top } = stage.canvas.getBoundingClientRect();
        for (const each of Object.values(found)) each[0] += left, each[1] += top;
        return found;
    }""")
    assert {"lwr/link2", "arrow", "vector"} <= pixels.keys()
    for what, word in (("lwr/link2", "lwr/link2"), ("arrow", "lwr/A"), ("vector", "push")):
        page.mouse.click(*pixels[what])
        page.locator("#details h2", has_text=word).wait_for()


def test_keys_are_those_of_windows(page: Any) -> None:
    page.evaluate("document.activeElement.blur(); player.recording.seek(1.0)")
    joint = page.evaluate("player.recording.chosen")
    page.keyboard.press(".")
    page.keyboard.press("]")
    page.keyboard.press("a")
    found = page.evaluate(
        "[player.recording.clock.frame, player.recording.chosen, player.recording.switches.arrows]"
    )
    assert found == [FPS + 1, (joint + 1) % 14, False]
    page.keyboard.press("a")
    page.keyboard.press("w")
    assert page.evaluate("player.recording.clock.time") == 1.0
    page.keyboard.press(" ")
    # The policy refuses what `wait_for_function` evaluates.
    page.evaluate("""() => new Promise(resolve => {
        const { clock } = player.recording;
        const look = () => clock.frame !== 20 ? resolve() : requestAnimationFrame(look);
        look();
    })""")
    page.keyboard.press(" ")


def test_content_security_policy_blocks_every_request(page: Any) -> None:
    # From a timer: what a debugger evaluates may do more than the page.
    refused = page.evaluate("""() => new Promise(resolve => setTimeout(async () => {
        const tries = [
            () => fetch("https://a.example/"),
            () => new Promise((good, bad) => {
                const socket = new WebSocket("wss://a.example/");
                socket.onerror = bad;
            }),
            () => (0, eval)("1"),
        ];
        const found = [];
        for (const each of tries) try { await each(); found.push(1); } catch { found.push(0); }
        resolve(found);
    }))""")
    assert refused == [0, 0, 0]


def test_robot_covers_the_same_pixels_as_in_our_images(page: Any, scene: sero_mj.Scene) -> None:
    width, height = SIZE
    digits = page.evaluate(SILHOUETTE, [width, height, 1.5])
    seen = np.frombuffer(digits.encode(), np.uint8).reshape(height, width) == ord("1")
    with Mirror(scene) as mirror, HeadlessRenderer(mirror.world, *SIZE, quality="draft") as drawn:
        mirror.advance(1.5)
        drawn.render(mirror.data)
        model = mirror.world.model
        own = mujoco.Renderer(model, height, width)
        own.update_scene(mirror.data, drawn.camera)
        own.enable_segmentation_rendering()
        found = own.render()
        own.close()
        doubles = np.concatenate([part.bodies.ravel() for part in mirror.world.doubles.values()])
        is_plane = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        opaque = ~is_plane & ~np.isin(model.geom_bodyid, doubles)
        is_geom = (found[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)) & (found[..., 0] >= 0)
        wanted = np.zeros((height, width), bool)
        wanted[is_geom] = opaque[found[..., 0][is_geom]]
        # Doubles hide parts of robots here; they are compared where no double is.
        free = ~is_geom | wanted
    assert (seen & wanted & free).sum() / ((seen | wanted) & free).sum() >= 0.99


@pytest.mark.thorough
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_phone_shows_everything_within_its_width(browser: Any, file: Path, scheme: str) -> None:
    phone = {"viewport": {"width": 390, "height": 844}, "color_scheme": scheme, "has_touch": True}
    page = opened(browser, file, **phone)
    assert page.evaluate("document.documentElement.dataset.look") == scheme
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    outside = page.evaluate("""() => [...document.querySelectorAll(".card, button, select")]
        .map(e => e.getBoundingClientRect())
        .filter(r => r.width && (r.left < -1 || r.right > 391)).length""")
    assert outside == 0
    rows = page.evaluate("""() => [...document.querySelectorAll("#tools button")]
        .filter(e => e.offsetParent).map(e => Math.round(e.getBoundingClientRect().top))""")
    assert len(set(rows)) == 1
    page.context.close()


def test_browser_without_webgl_shows_a_message_and_no_controls(browser: Any, file: Path) -> None:
    page = opened(browser, file, before="HTMLCanvasElement.prototype.getContext = () => null")
    assert page.locator("#problem").is_visible()
    assert "WebGL" in page.locator("#problem").inner_text()
    assert page.locator(":is(button, select, input, .names):visible").count() == 0
    assert page.locator("h1").inner_text() == HOSTILE
    page.context.close()


@pytest.mark.thorough
def test_lost_webgl_context_is_reported_and_restored(browser: Any, file: Path) -> None:
    page = opened(browser, file)
    page.evaluate(
        "() => { globalThis.graphics ="
        " player.view.renderer.getContext().getExtension('WEBGL_lose_context');"
        " graphics.loseContext(); }"
    )
    problem = page.locator("#problem", has_text="suspended WebGL")
    problem.wait_for(state="visible")
    page.evaluate("() => graphics.restoreContext()")
    problem.wait_for(state="hidden")
    page.evaluate("() => player.recording.seek(1.5)")
    again = page.evaluate(SILHOUETTE, [*SIZE, 1.5]).count("1")
    page.context.close()
    other = opened(browser, file)
    assert again == other.evaluate(SILHOUETTE, [*SIZE, 1.5]).count("1") > 1000
    other.context.close()


def test_robot_alone_is_a_static_page(browser: Any, tmp_path: Path) -> None:
    found = capture(load_scene("lwr"))
    assert found.frames == 1
    write_page(found, tmp_path / "lwr.html")
    page = opened(browser, tmp_path / "lwr.html")
    assert page.said == []
    assert not page.locator("#timeline").is_visible()
    page.context.close()


@pytest.mark.thorough
def test_camera_of_a_file_follows_like_that_of_a_video(browser: Any, tmp_path: Path) -> None:
    scene = load_scene("drive_home")
    found = capture(scene, fps=FPS, seconds=2.0, follow="lwr/flange")
    write_page(found, tmp_path / "run.html")
    with (
        Mirror(scene) as mirror,
        HeadlessRenderer(mirror.world, 64, 64, follow="lwr/flange") as renderer,
    ):
        looked_at = []
        for frame in range(2 * FPS + 1):
            mirror.advance(frame / FPS)
            renderer.render(mirror.data)
            looked_at.append(renderer.camera.lookat.copy())
    assert np.ptp(looked_at, axis=0).max() > 0.3
    one = browser.new_page()
    one.goto(f"{(tmp_path / 'run.html').as_uri()}#t=0")
    one.locator("html[data-ready]").wait_for(state="attached")
    places = """times => times.map((t) => { player.recording.seek(t); player.draw();
        const { orbit, camera } = player.stage;
        return [orbit.target.toArray(), camera.position.toArray()]; })"""
    times = [0.0, 1.0, 1.5, 0.5]
    seen = np.array(one.evaluate(places, times))
    # The time line of a page begins with the first frame, as that of the film does.
    wanted = np.array([looked_at[round(t * FPS)] for t in times])
    np.testing.assert_allclose(seen[:, 0] - seen[0, 0], wanted - wanted[0], atol=2e-4)
    turned = """() => { const { camera, orbit } = player.stage;
        camera.position.applyAxisAngle(camera.up, .5); orbit.update(); }"""
    one.evaluate(turned)
    again = np.array(one.evaluate(places, times))
    np.testing.assert_allclose(np.diff(again, axis=0), np.diff(seen, axis=0), atol=1e-6)
    assert np.linalg.norm(again[0, 1] - seen[0, 1]) > 0.1  # as its user has turned it
    one.close()
