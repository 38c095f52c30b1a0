"""Renders a picture or a film of a scene, including live sources.

A film of a live robot must show real time, but software rendering may be slower than that. So a
thread samples the state at exactly the film's rate, and frames are rendered from these samples at
any speed.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assemble.scene import Scene
from ...drive.mirror import Mirror, restore
from ...errors import RenderError
from ..picking import TOUCH_TOLERANCE
from .film import FilmWriter, check_writable, default_fps, save_picture
from .renderer import DEFAULT_SIZE, HeadlessRenderer

log = logging.getLogger(__name__)

MAX_FRAMES = 1_000_000  # nine hours at 30 fps; more is probably a typing error
State = NDArray[np.float64]
# Pixel from the upper left corner, x and y; `click`, `shift`, `double` or `hover`; by touch.
Click = tuple[float, float, str, bool]
OnProgress = Callable[[int, int], None]


def render_picture(
    scene: Scene,
    path: Path | str,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str | None = None,
    wait: float = 2.0,
    clicks: Sequence[Click] = (),
    at: float = 0.0,
) -> list[str]:
    """Renders a picture of the current state of a scene.

    Args:
        scene: what to show.
        path: the file; .png, or another format of Pillow.
        size: width and height, pixels.
        camera: see `find_camera`.
        wait: maximum time to wait for the first packet of every source, s.
        clicks: clicks to perform before rendering.
        at: time of recordings and simulations, s after their start.

    Returns:
        names of the sources without data; their robots have the declared pose.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or the file.
    """
    with Mirror(scene) as mirror:
        check_writable(Path(path))
        with HeadlessRenderer(mirror.world, *size, camera) as renderer:
            silent = mirror.wait(wait)
            mirror.advance(at)
            _click(renderer, mirror.data, clicks)
            save_picture(Path(path), renderer.render(mirror.data))
    return silent


def render_film(
    scene: Scene,
    path: Path | str,
    *,
    duration: float = 5.0,
    fps: float | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str | None = None,
    wait: float = 2.0,
    clicks: Sequence[Click] = (),
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Renders a film of a scene, in real time when it has live sources.

    Args:
        scene: what to show.
        path: the file; .mp4, .webm or .gif.
        duration: of the film, s.
        fps: frames per second; None for 30, or 20 for a GIF.
        size: width and height, pixels.
        camera: see `find_camera`.
        wait: maximum time to wait for the first packet of every source, s.
        clicks: clicks to perform before the first frame.
        on_progress: called with the number of rendered frames and of all frames.

    Returns:
        names of the sources without data.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or the file.
    """
    fps = default_fps(path) if fps is None else fps
    for what, value in (("duration", duration), ("fps", fps)):
        if not 0 < value < float("inf"):
            raise RenderError(f"{what} {value}: expected a number above 0")
    count = max(round(duration * fps), 1)
    if count > MAX_FRAMES:
        raise RenderError(f"a film of {count} frames: expected at most {MAX_FRAMES}")
    with Mirror(scene) as mirror:
        world = mirror.world
        data = world.make_data()
        with (
            FilmWriter(Path(path), *size, fps) as film,
            HeadlessRenderer(world, *size, camera) as renderer,
        ):
            silent = mirror.wait(wait)
            pixels = np.empty((size[1], size[0], 3), np.uint8)
            for done, state in enumerate(_states(mirror, count, fps), start=1):
                restore(world, data, state)
                if done == 1:
                    _click(renderer, data, clicks)
                film.add(renderer.render(data, out=pixels))
                if on_progress is not None:
                    on_progress(done, count)
    return silent


def _click(renderer: HeadlessRenderer, data: mujoco.MjData, clicks: Sequence[Click]) -> None:
    for x, y, gesture, finger in clicks:
        if gesture == "hover":
            picked = renderer.hover(data, x, y)
        else:
            tolerance = TOUCH_TOLERANCE if finger else 0.0
            picked = renderer.click(data, x, y, gesture, tolerance)  # type: ignore[arg-type]
        what = "nothing there" if picked is None else f"{picked.kind} {picked.name}"
        log.info("%s at %g,%g: %s", gesture, x, y, what)


def _states(mirror: Mirror, count: int, fps: float) -> Iterator[State]:
    """Yields the state at the time of every frame, sampled on a thread if sources are live."""
    if not mirror.is_live:
        for k in range(count):
            mirror.advance(k / fps)
            yield mirror.state()
        return
    taken: queue.SimpleQueue[State | BaseException] = queue.SimpleQueue()
    stop = threading.Event()

    def sample() -> None:
        try:
            start = time.monotonic()
            for k in range(count):
                if stop.wait(max(start + k / fps - time.monotonic(), 0.0)):
                    return
                mirror.advance(k / fps)
                taken.put(mirror.state())
        except BaseException as error:  # raised again on the caller's thread
            taken.put(error)

    sampler = threading.Thread(target=sample, name="film sampler", daemon=True)
    sampler.start()
    try:
        for _ in range(count):
            state = taken.get()
            if isinstance(state, BaseException):
                raise state
            yield state
    finally:
        stop.set()
        sampler.join()
