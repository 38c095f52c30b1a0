"""`Canvas`: the scene, picture size and camera that an overlay draws with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco

from ..decor.font import DEFAULT_FONT, Font
from ..errors import UsageError

DEFAULT_SIZE = (640, 480)


@dataclass(frozen=True, eq=False)
class Canvas:
    """A scene to draw on.

    Attributes:
        scene: takes the geoms.
        size: width and height of its picture, pixels.
        font: of its labels.
        camera: to update the scene with; None if the scene has one already.
    """

    scene: mujoco.MjvScene
    size: tuple[int, int]
    font: Font
    camera: Any


def canvas_of(target: Any, camera: Any, size: tuple[int, int] | None) -> Canvas:
    """Returns the canvas of an object that the user wants to draw on.

    Args:
        target: a `mujoco.Renderer`, the handle of MuJoCo's passive viewer, or an `MjvScene`.
        camera: None for the target's own.
        size: None for the target's own.

    Raises:
        UsageError: the target is something else, or its camera is unknown.
    """
    if isinstance(target, mujoco.MjvScene):
        canvas = Canvas(target, size or DEFAULT_SIZE, DEFAULT_FONT, camera)
    elif isinstance(target, mujoco.Renderer):
        context = getattr(target, "_mjr_context", None)
        font = DEFAULT_FONT if context is None else Font.of_context(context)
        canvas = Canvas(target.scene, size or (target.width, target.height), font, camera)
    elif getattr(target, "user_scn", None) is not None and hasattr(target, "cam"):
        view = target.viewport
        seen = DEFAULT_SIZE if view is None else (int(view.width), int(view.height))
        look = target.cam if camera is None else camera
        canvas = Canvas(target.user_scn, size or seen, DEFAULT_FONT, look)
        canvas.scene.ngeom = 0  # clears the geoms of the last frame; MuJoCo does not
    else:
        raise UsageError(
            f"found {type(target).__name__}; expected a mujoco.Renderer, a viewer of "
            "mujoco.viewer.launch_passive, or a mujoco.MjvScene"
        )
    width, height = canvas.size
    if not (width > 0 and height > 0):
        raise UsageError(f"size: found {width} x {height}; expected pixels above 0")
    if canvas.camera is None and not canvas.scene.camera[0].frustum_near > 0:
        raise UsageError(
            "the scene has no camera yet: call update_scene before draw, or give draw a camera"
        )
    return canvas
