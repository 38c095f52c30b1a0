"""Serves pages from a separate process, and controls them in Chromium like a user."""

from __future__ import annotations

import importlib.util
import io
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
FEW = 60  # minimum number of pixels of an arrow
SIZE = (560, 400)  # small, because software rendering is slow
_SCALE = 0.5  # ratio of image pixels to page pixels
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
MISSING = ["chromium"] * (CHROMIUM is None)
MISSING += ["playwright"] * (importlib.util.find_spec("playwright") is None)
# Arguments of a browser that draws without a GPU and resolves the websites of tests.
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
    "--host-resolver-rules=MAP *.example 127.0.0.1",
]
# Serves frames, and answers questions about the page on its standard input.
_PROGRAM = """
from sero_mj.cli.arguments import read_scene, replay_instead
from sero_mj.data.drive.mirror import Mirror
from sero_mj.viewer.program.viewer import open_page
from pathlib import Path

scene, settings, replay, options, control = json.loads(sys.argv[1])
scene = read_scene(scene, settings, by_hand=not replay)
if control:
    from sero_mj.simulate.endless_run import endless_scene
    scene = endless_scene(scene, control)
if replay:
    replay_instead(scene, Path(replay), None)
clicks = []
with Mirror(scene) as mirror, open_page(mirror, **options) as w:
    w.pointer.on_click = lambda picked, gesture: clicks.append((gesture, picked and picked.name))
    w.frame()
    print("ready", flush=True)
    while w.frame():
        answer()
print("closed", flush=True)
"""


class Served(Driver):
    """A page of another process."""

    goodbye = "w.request_close()"
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
        arguments = [scene, list(settings), replay, options, control]
        super().__init__(_PROGRAM, arguments, folder, errors=errors)
        self.url: str = self.ask("w.url")
        self.visitors: list[Visitor] = []

    def close(self) -> None:
        """Ends the server; open pages would otherwise connect to the next one on its port."""
        for visitor in self.visitors:
            visitor.page.close()
        super().close()


class Visitor:
    """A browser page that shows a `Served`.

    Args:
        browser: browser of Playwright.
        served: served page.
        size: size of the page, pixels. If the width is below 800, the panel is initially closed.
        view: view in the link, from `ViewState.to_text`.
        **options: options of pages in Playwright.

    Attributes:
        page: page of Playwright.
        faults: errors on the console of the page.
    """

    def __init__(
        self,
        browser: Any,
        served: Served,
        size: tuple[int, int] = SIZE,
        view: str = "",
        **options: Any,
    ) -> None:
        self._served = served
        viewport = {"width": size[0], "height": size[1]}
        options = {"device_scale_factor": _SCALE, **options}
        self.page = browser.new_page(viewport=viewport, **options)
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on(
            "console",
            lambda line: self.faults.append(line.text) if line.type == "error" else None,
        )
        self.page.goto(f"{served.url}#view={view}" if view else served.url)
        self.until(
            "document.documentElement.dataset.ready === '1' && player.state && player.now.control"
        )
        served.visitors.append(self)
        if served.ask("w.has_timeline"):  # which takes space from the image
            self.until("!document.getElementById('timeline').hidden")
        if self.page.evaluate("player.isInControl"):
            self.has_told_its_size()

    def until(self, expression: str) -> None:
        """Waits until an expression of the page is true and its values are drawn."""
        self.page.wait_for_function(
            f"() => ({expression}) && !player.view.isDirty", timeout=60_000, polling=50
        )

    def has_told_its_size(self) -> None:
        """Waits until the server knows the image size, on which pixel positions depend."""
        told = self.page.evaluate("(({ size }) => [size.width, size.height])(player.stage)")
        self._served.until(f"[*w.view.size] == {told}")

    def sees_camera(self) -> None:
        """Waits until the page shows the server's camera."""
        self.until(f"player.serial >= {self._served.ask('w.view._serial')}")

    def joint(self, index: int) -> tuple[float, float]:
        """Returns the pixel of a joint of the world on the page, from the upper left corner."""
        x, y = self.page.evaluate(
            """joint => {
                const { x, y } = player.stage.pixel(player.stage.centre(joint));
                const { left, top } = document.getElementById("picture").getBoundingClientRect();
                return [x + left, y + top];
            }""",
            index,
        )
        return x, y

    def finger(self, x: float, y: float) -> Callable[..., None]:
        """Returns a function that touches a page with fingers at distances right of a pixel."""
        send = self.page.context.new_cdp_session(self.page).send

        def touch(kind: str, *offsets: float) -> None:
            points = [{"x": x + by, "y": y, "id": i} for i, by in enumerate(offsets)]
            send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        return touch

    def picture(self) -> NDArray[np.int16]:
        """Returns the visible image, shape (height / 2, width / 2, 3)."""
        png = self.page.screenshot(timeout=60_000)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.int16)

    def shows(self, what: Callable[[NDArray[np.int16]], Any], seconds: float = 60.0) -> None:
        """Waits until something is visible in the image."""
        end = time.monotonic() + seconds
        while not what(self.picture()):
            assert time.monotonic() < end, f"never seen: {what}; {self.faults[-5:]}"

    def close(self) -> None:
        """Closes the page and checks that no error has occurred."""
        self.page.close()
        assert self.faults == []


def orange(pixels: NDArray[np.int16]) -> int:
    """Returns the number of page pixels with the color of positive arrows."""
    red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return on_page((red > 170) & (green > 60) & (green < 150) & (blue < 60))


def blue(pixels: NDArray[np.int16]) -> int:
    """Returns the number of page pixels with the color of negative arrows."""
    red, green, blue_ = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return on_page((blue_ > 120) & (red < 60) & (green < 110))


def on_page(mask: NDArray[np.bool_]) -> int:
    """Returns the number of page pixels that correspond to the pixels of an image mask."""
    return round(mask.sum() / _SCALE**2)
