"""Pages of third-party models, and images of them by MuJoCo's classic renderer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sero_mj import Scene, World
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.camera import find_camera
from sero_mj.viewer.player import capture as capture_module
from sero_mj.viewer.player.capture import CapturedRun
from sero_mj.viewer.player.page import write_page
from sero_mj.viewer.player.soft import SoftParts, soft_of

NO_SKY = (0, 0, 0)  # color of uncovered pixels


def captured(
    model: mujoco.MjModel, states: Sequence[mujoco.MjData], camera: str, fps: float = 10.0
) -> CapturedRun:
    """Returns a captured run of a model in these states, without decor.

    Args:
        model: compiled model.
        states: data of each frame, after `mj_forward`.
        camera: camera as in `find_camera`.
        fps: frames per second.
    """
    world = World(Scene(floor=False))  # without joints and decor
    world.model = model
    bodies, parts = capture_module.shown_bodies(world), SoftParts(model)
    soft = [parts.take(data) for data in states]
    n, frames = len(world.joints.names), len(states)
    nothing = np.full((frames, n), np.nan)
    lines, details = capture_module._lines(world, {"torques": nothing}, Toggles(world))
    poses = np.array([np.hstack([d.xpos[bodies], d.xquat[bodies]]) for d in states])
    return CapturedRun(
        world=world, fps=fps, begin=0.0, toggles=Toggles(world), camera=find_camera(world, camera),
        lines=lines, details=details, bodies=bodies, positions=poses[..., :3],
        rotations=capture_module._continuous(poses[..., 3:]),
        opacity=np.ones((frames, len(bodies))), grey=np.zeros((frames, len(bodies)), bool),
        values={}, arrows=nothing, limit=np.full(n, np.inf),
        stale=np.zeros((frames, n), bool), soft=soft_of(soft), items=[],
        labels=[{}] * frames, notes=[""] * frames, legend=[""] * frames, arrow_texts={},
    )  # fmt: skip


def rolled_out(model: mujoco.MjModel, frames: int, steps: int) -> list[mujoco.MjData]:
    """Returns states of a falling model, `steps` steps apart."""
    data, states = mujoco.MjData(model), []
    mujoco.mj_forward(model, data)
    for _ in range(frames):
        states.append(mujoco.MjData(model))
        mujoco.mj_copyData(states[-1], model, data)
        mujoco.mj_step(model, data, steps)
        mujoco.mj_forward(model, data)
    return states


def classic(
    model: mujoco.MjModel, data: mujoco.MjData, camera: Any, size: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Returns an image, shape (h, w, 3), and a mask of the model's pixels, shape (h, w)."""
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        renderer.update_scene(data, camera)
        picture = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        covered = renderer.render()[..., 1] != -1
    return picture, covered


# Returns the image without the page at some size, as digits of red, green, blue and alpha.
DRAWN = """([width, height, time, hidden, hasShadows]) => {
    const { stage } = player;
    player.recording.seek(time);
    stage.resize(width, height);
    stage.renderer.setPixelRatio(1);
    stage.renderer.setSize(width, height, false);
    stage.chooseCamera(stage.run.eye.fixed);
    player.stage.hasShadows = hasShadows;
    player.draw();
    for (const each of hidden) (stage[each] ?? stage.surroundings[each]).visible = false;
    stage.draw();
    const gl = stage.renderer.getContext(), bytes = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    let text = "";
    for (let k = 0; k < bytes.length; k += 8192)
        text += String.fromCharCode(...bytes.subarray(k, k + 8192));
    return btoa(text);
}"""


def drawn(
    page: Any,
    size: tuple[int, int],
    time: float,
    hidden: Sequence[str] = (),
    *,
    shadows: bool = False,
) -> Any:
    """Returns the canvas of a page at a time (s), shape (h, w, 4), uint8."""
    import base64

    text = page.evaluate(DRAWN, [*size, time, list(hidden), shadows])
    pixels = np.frombuffer(base64.b64decode(text), np.uint8)
    return pixels.reshape(size[1], size[0], 4)[::-1]


def overlap(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Returns the number of pixels in both masks, divided by the number in any mask."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def page_of(found: CapturedRun, path: Path) -> Path:
    """Writes a page of a captured run and returns its path."""
    write_page(found, path, path.stem)
    return path
