"""Serves pages from a process of their own, and works them in Chromium as a user does."""

from __future__ import annotations

import importlib.util
import io
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from driver import Driver
from numpy.typing import NDArray
from PIL import Image

POSE = "lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0"
TORQUES = "lwr.torques=20,60,-30,40,-9,5,3"
FEW = 60  # pixels of an arrow, at least
SIZE = (560, 400)  # small: software draws a few such pictures a second
_SCALE = 0.5  # pixels of pictures by those of pages, likewise
_CONTROL = (94, 16)  # its button in Studio's bar, from the lower right corner, pixels
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
MISSING = ["chromium"] * (CHROMIUM is None)
MISSING += ["playwright"] * (importlib.util.find_spec("playwright") is None)
# A browser that draws without a GPU, and finds the websites of tests.
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
    "--host-resolver-rules=MAP *.example 127.0.0.1",
]
# A page works as ever, but draws only its first frames and those that `Visitor.picture` asks for:
# software takes all processors to draw, and others have to wait.
DRAWS_ON_DEMAND = """
window.framesDrawn = 0;
window.framesWanted = 5;
window.frameWait = 50;
const next = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = frame => setTimeout(next, frameWait, time => {
    frame(time);
    if (framesDrawn < framesWanted) framesDrawn += 1;
});
const calls = WebGL2RenderingContext.prototype;
for (const name of ["clear", "clearBufferfi", "clearBufferfv", "blitFramebuffer", "drawArrays",
                    "drawArraysInstanced", "drawElements", "drawElementsInstanced",
                    "drawRangeElements"]) {
    const call = calls[name];
    calls[name] = function (...given) {
        if (framesDrawn < framesWanted) call.apply(this, given);
    };
}
"""
_DRAW = """() => new Promise(resolve => {
    framesWanted = framesDrawn + 1;
    const look = () => framesDrawn < framesWanted ? setTimeout(look, 20) : resolve();
    look();
})"""
_PASS = """() => new Promise(resolve => {
    let left = 4;
    const look = () => left-- ? requestAnimationFrame(look) : resolve();
    look();
})"""
# Not for ever: what was pressed may have been without effect.
_AWAIT_CONTROL = """(wanted) => new Promise(resolve => {
    let left = 100;
    const look = () => isInControl === wanted || !left-- ? resolve(isInControl)
        : requestAnimationFrame(look);
    look();
})"""
# Serves frames, and answers what is asked about the page on its standard input.
_PROGRAM = """
from mujoco.studio.dear_imgui import dear_imgui as imgui
from sero_mj.cli._arguments import read_scene, replay_instead
from sero_mj.data.drive.mirror import Mirror
from sero_mj.viewer.session.viewer import open_page
from sero_mj.viewer.web import page_windows, studio
from sero_mj.viewer.web.studio_controls import IMGUI_KEYS
from pathlib import Path
page_windows._NARROW = 0.0  # else the panel is folded on a page as narrow as ours
studio.RATE = 25.0  # as many as browsers here draw: what they do with more costs as much again

places = {}  # of what can be clicked on in the panels, by its label
def noted(build):
    def built(label, *rest):
        found = build(label, *rest)
        low, high = imgui.GetItemRectMin(), imgui.GetItemRectMax()
        places[label] = [low.x, low.y, high.x, high.y]
        return found
    return built
for name in ("Button", "Checkbox", "Combo", "SliderFloat", "CollapsingHeader", "TreeNode",
             "BeginMenu", "MenuItem"):
    setattr(imgui, name, noted(getattr(imgui, name)))

windows = {}  # left, top, right, bottom of every window, by its title
def placed(build):
    def built(title, *rest):
        found = build(title, *rest)
        low, size = imgui.GetWindowPos(), imgui.GetWindowSize()
        windows[title.partition("###")[0]] = [low.x, low.y, low.x + size.x, low.y + size.y]
        return found
    return built
imgui.Begin = placed(imgui.Begin)

seen = {"at": [-1, -1], "is_down": False, "is_key_down": False}  # of the browser's mouse and keys
def looked(build):
    def built():
        seen["at"] = [imgui.GetIO().MousePos.x, imgui.GetIO().MousePos.y]
        seen["is_down"] = imgui.IsMouseDown(int(imgui.MouseButton.Left))
        seen["is_key_down"] = any(imgui.IsKeyDown(key) for key in IMGUI_KEYS.values())
        return build()
    return built
imgui.BeginMainMenuBar = looked(imgui.BeginMainMenuBar)

scene, settings, replay, options, control = json.loads(sys.argv[1])
scene = read_scene(scene, settings, by_hand=not replay)
if control:
    from sero_mj.simulate.endless_run import endless_scene
    scene = endless_scene(scene, control)
if replay:
    replay_instead(scene, Path(replay), None)
clicks = []
with Mirror(scene) as mirror, open_page(mirror, **options) as w:
    w.on_click = lambda picked, gesture: clicks.append((gesture, picked and picked.name))
    w.frame()
    print("ready", flush=True)
    frames = 0
    while w.frame():
        frames += 1
        answer()
print("closed", flush=True)
"""


class Served(Driver):
    """A page of another process."""

    goodbye = "w._app.close()"
    patience = 60

    def __init__(
        self,
        folder: Path,
        scene: str,
        *,
        settings: tuple[str, ...] = (),
        replay: str = "",
        control: str = "",
        errors: IO[str] | None = None,
        **options: Any,
    ) -> None:
        environment = {
            **os.environ,
            "HOME": str(folder),  # Studio keeps its settings there
            "MUJOCO_GL": "egl",
        }
        arguments = [scene, list(settings), replay, options, control]
        super().__init__(_PROGRAM, arguments, folder, environment, errors)
        self.url: str = self.ask("w.url")

    def joint(self, index: int) -> tuple[float, float]:
        """Where a joint of the world is on the page, pixels from the upper left corner."""
        point = f"w.data.site_xpos[w.world.joints.centre_site][{index}]"
        (x, y), height = self.ask(
            f"[w.decor.view.project({point})[0].tolist(), w.decor.view.height]"
        )
        return x, height - y

    def middle(self, label: str) -> tuple[float, float]:
        """Where something in a panel is, by its label."""
        left, top, right, bottom = self.until(f"places.get({label!r})")
        return (left + right) / 2, (top + bottom) / 2

    def settle(self, frames: int = 6) -> None:
        """Waits until so many frames were served."""
        now = self.ask("frames")
        self.until(f"frames >= {now + frames}")


class Visitor:
    """A browser's page that looks at a `Served`.

    Mouse and keys are held until the server has seen them: a browser without a GPU draws, and
    tells, a few times a second only.

    Args:
        browser: Playwright's.
        served: the page.
        size: of the page, pixels.
        url: another address of it.
        **options: of Playwright's pages.

    Attributes:
        page: Playwright's.
    """

    def __init__(
        self,
        browser: Any,
        served: Served,
        size: tuple[int, int] = SIZE,
        url: str = "",
        **options: Any,
    ) -> None:
        self._served = served
        viewport = {"width": size[0], "height": size[1]}
        options = {"device_scale_factor": _SCALE, **options}
        self.page = browser.new_page(viewport=viewport, **options)
        self.page.add_init_script(DRAWS_ON_DEMAND)
        self.said: list[str] = []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.goto(url or served.url)

    def hears(self, text: str, seconds: float = 100.0) -> None:
        """Waits until the page has written something to its console."""
        self._until(lambda: any(text in line for line in self.said), seconds, text)

    def picture(self) -> NDArray[np.int16]:
        """What is seen, (height / 2, width / 2, 3), without Studio's bar below."""
        self.page.evaluate(_DRAW)
        png = self.page.screenshot(timeout=60_000)
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.int16)
        return pixels[: -round(32 * _SCALE)]

    def still(self) -> NDArray[np.int16]:
        """What is seen once nothing changes any more."""
        last = self.picture()
        while True:
            self.page.wait_for_timeout(500)
            now = self.picture()
            if (np.abs(now - last) > 8).sum() < 75:  # the pointer's name, a line of text
                return now
            last = now

    def shows(self, what: Callable[[NDArray[np.int16]], Any], seconds: float = 100.0) -> Any:
        """Waits until something is seen in the picture, and returns it."""
        return self._until(lambda: what(self.picture()), seconds, what)

    def _until(self, found: Callable[[], Any], seconds: float, what: object) -> Any:
        end = time.monotonic() + seconds
        while True:
            result = found()
            if result:
                return result
            assert time.monotonic() < end, f"never seen: {what}; {self.said[-5:]}"
            self.page.wait_for_timeout(100)

    def move(self, x: float, y: float) -> None:
        """Moves the pointer."""
        self.page.mouse.move(x, y)
        self._sees(f"abs(seen['at'][0] - {x}) + abs(seen['at'][1] - {y}) < 2")

    def settle(self) -> None:
        """Waits until the browser knows what the pointer is over."""
        self._served.settle()
        self.page.evaluate(_PASS)

    def hold(self) -> None:
        """Holds the left button down."""
        self.settle()
        self.page.mouse.down()
        self._sees("seen['is_down']")

    def release(self) -> None:
        """Lets it go."""
        self.page.mouse.up()
        self._sees("not seen['is_down']")

    def click(self, x: float, y: float) -> None:
        """Clicks at a pixel from the upper left corner."""
        self.move(x, y)
        self.hold()
        self.release()

    def press(self, key: str) -> None:
        """Presses a key of ours."""
        self.page.keyboard.down(key)
        self._sees("seen['is_key_down']")
        self.page.keyboard.up(key)
        self._sees("not seen['is_key_down']")

    def set_control(self, wanted: bool) -> None:
        """Asks for control, or releases it, as Studio's bar has it at one place."""
        self._until(lambda: self._press_control(wanted) is wanted, 100.0, f"control: {wanted}")

    def _press_control(self, wanted: bool) -> Any:
        """Presses there, if need be; what has been opened by a click before takes one more."""
        if self.page.evaluate("isInControl") is not wanted:
            self.page.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
            self.page.mouse.move(SIZE[0] - _CONTROL[0], SIZE[1] - _CONTROL[1])
            for do in (self.settle, self.page.mouse.down, self.page.mouse.up):
                do()
                self.page.evaluate(_PASS)
        return self.page.evaluate(_AWAIT_CONTROL, wanted)

    def _sees(self, expression: str) -> None:
        """Waits until the server has seen it."""
        self._served.until(expression)

    def close(self) -> None:
        """Leaves the page."""
        self.page.close()


def orange(pixels: NDArray[np.int16]) -> int:
    """How many pixels of the page have the colour of arrows of positive values."""
    red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return on_page((red > 170) & (green > 60) & (green < 150) & (blue < 60))


def blue(pixels: NDArray[np.int16]) -> int:
    """How many pixels of the page have the colour of arrows of negative values."""
    red, green, blue_ = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return on_page((blue_ > 120) & (red < 60) & (green < 110))


def on_page(mask: NDArray[np.bool_]) -> int:
    """How many pixels of the page those of a picture are."""
    return round(mask.sum() / _SCALE**2)
