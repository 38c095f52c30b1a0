"""Opens real windows on a virtual screen (Xvfb) and controls them like a user (xdotool)."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from driver import Driver

from sero_mj.viewer.session.input import DOUBLE_CLICK_TIME

SIZE = (640, 480)
MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]

# Shows frames, and evaluates expressions about the window from its standard input. Only every
# sixth unused frame is drawn, in draft quality, because software takes 80 ms for a full frame.
_DRIVER = """
import os
os.environ["MUJOCO_GL"] = "glfw"
from sero_mj.cli.arguments import read_scene, replay_instead
from sero_mj.data.drive.mirror import Mirror
from sero_mj.viewer.host.restoring import restore, save
from sero_mj.viewer.window.host import Window
from pathlib import Path
scene, settings, size, options, replay, control = json.loads(sys.argv[1])
scene = read_scene(scene, settings, by_hand=not replay)
if control:
    from sero_mj.simulate.endless_run import endless_scene
    scene = endless_scene(scene, control)
if replay:
    replay_instead(scene, Path(replay), None)
places = {}  # of the panel's widgets by label: left, top, right, bottom
from imgui_bundle import imgui
def noted(build):
    def built(label, *rest):
        found = build(label, *rest)
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        places[label] = [low.x, low.y, high.x, high.y]
        return found
    return built
for name in ("button", "checkbox", "combo", "slider_float", "input_double", "collapsing_header",
             "tree_node"):
    setattr(imgui, name, noted(getattr(imgui, name)))
clicks = []
if "stereo" in options:
    from functools import partial
    from sero_mj.viewer.window.viewport import StereoViewport
    options["make_viewport"] = partial(StereoViewport, stereo=options.pop("stereo"))
if "over" in options:  # a camera and its file
    from functools import partial
    from sero_mj.extensions.photo.camera_feed import CameraFeed
    from sero_mj.extensions.photo.photo_viewport import PhotoViewport
    what, camera_file = options.pop("over")
    feed = CameraFeed(what, Path(camera_file))
    options["make_viewport"] = partial(PhotoViewport, feed=feed)
with Mirror(scene) as mirror, Window(mirror, size=size, folder=Path(), **options) as w:
    w.pointer.on_click = lambda picked, gesture: clicks.append((gesture, picked and picked.kind))
    w.frame()
    print("ready", flush=True)
    frames = 0
    w._pace.is_quick = lambda view, now: True
    draw = w._draw
    def draw_some(*given):
        if frames % 6 == 0 or w.tools.takes_images:
            draw(*given)
    w._draw = draw_some
    while w.frame():
        frames += 1
        answer()
print("closed", flush=True)
"""


@contextmanager
def screen(size: tuple[int, int] = (1000, 700)) -> Iterator[str]:
    """Starts a virtual screen of this size in pixels and yields its DISPLAY."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{size[0]}x{size[1]}x24",
         "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    try:
        with os.fdopen(read) as number:
            yield f":{number.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


class Driven(Driver):
    """A window of another process."""

    goodbye = "w.gl.request_close()"
    opens_windows = True

    def __init__(
        self,
        display: str,
        folder: Path,
        scene: str,
        *,
        settings: tuple[str, ...] = (),
        replay: str = "",
        control: str = "",
        errors: IO[str] | None = None,
        **options: Any,
    ) -> None:
        self._environment = {**os.environ, "DISPLAY": display}
        self._environment.pop("WAYLAND_DISPLAY", None)
        self._pressed = 0.0  # time of the last button press
        arguments = [scene, list(settings), list(SIZE), options, replay, control]
        super().__init__(_DRIVER, arguments, folder, self._environment, errors)

    def tool(self, *arguments: object) -> None:
        """Runs `xdotool` with these arguments to move, click and type.

        A press never becomes the second one of a double click with an earlier call.
        """
        is_press = "click" in arguments or "mousedown" in arguments
        if is_press:
            time.sleep(max(self._pressed + 1.1 * DOUBLE_CLICK_TIME - time.monotonic(), 0.0))
        command = ["xdotool", *(str(argument) for argument in arguments)]
        subprocess.run(command, check=True, env=self._environment, timeout=20)
        if is_press:
            self._pressed = time.monotonic()

    def key(self, key: str) -> None:
        """Presses a key."""
        self.tool("key", key)
        self.settle()

    def click(self, x: float, y: float, *how: object) -> None:
        """Clicks on a pixel, counted from the upper left corner of the window."""
        self.tool("mousemove", round(x), round(y), *(how or ("click", 1)))
        self.settle()

    def middle(self, label: str) -> tuple[float, float]:
        """Returns the center of a panel widget by label, relative to the upper left corner."""
        left, top, right, bottom = self.until(f"places.get({label!r})")
        return (left + right) / 2, (top + bottom) / 2

    def on_time_line(self, share: float) -> tuple[int, int]:
        """Returns the position of a fraction of the timeline, from the upper left corner."""
        left, top, right, bottom = self.until("places.get('##time')")
        end = 6.5  # half of the knob and the space beside it
        return round(left + end + share * (right - left - 2 * end)), round((top + bottom) / 2)

    def settle(self) -> None:
        """Waits until frames were shown: the first one processes the user's input."""
        frames = self.ask("frames")
        self.until(f"frames >= {frames} + 3")
