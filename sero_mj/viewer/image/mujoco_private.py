"""Access to private parts of MuJoCo, with the reason for each.

The parts exist in `mujoco>=4.0,<4.1`. If another version lacks a part, a RenderError names it.
"""

from __future__ import annotations

from typing import Any

import mujoco

from ...base.errors import RenderError
from ..decor.arrow_shapes import shapes_model

_EXPECTED = "4.0"


def context_of(renderer: mujoco.Renderer) -> mujoco.MjrContext:
    """Returns the OpenGL context of a renderer, which `mujoco.Renderer` does not expose.

    Textures of draft images are uploaded to the context, and its font widths determine the layout
    of panels.
    """
    try:
        context: mujoco.MjrContext = renderer._mjr_context
    except AttributeError:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no {type(renderer).__name__}._mjr_context, which is "
            f"needed for images; expected MuJoCo {_EXPECTED}"
        ) from None
    return context


def lend_shapes(context: mujoco.MjrContext) -> int:
    """Uploads the meshes of arrows and axes to the current OpenGL context.

    An `MjrContext` draws only meshes of its own model. They are display lists of OpenGL, which all
    `MjrContext` of one OpenGL context share. The lists exist until the OpenGL context is destroyed.

    Returns:
        `dataid` of the first mesh in scenes that are rendered with `context`.
    """
    buffer = context.currentBuffer
    lender = mujoco.MjrContext(shapes_model(), mujoco.mjtFontScale.mjFONTSCALE_50)
    first = int(lender.baseMesh) - int(context.baseMesh)
    lender.baseMesh = lender.rangeMesh = 0  # not freed with the lender
    lender.free()
    mujoco.mjr_setBuffer(buffer, context)
    return first


def lend_shapes_to(renderer: mujoco.Renderer) -> int:
    """Calls `lend_shapes` in the OpenGL context of a renderer, which becomes the current one."""
    context = context_of(renderer)
    if renderer._gl_context is not None:
        renderer._gl_context.make_current()
    return lend_shapes(context)


def filament() -> Any:
    """Returns the module of the Filament renderer of MuJoCo after registering its materials.

    This is `mujoco.mjrf`, because the wrapper `mujoco.rendering.filament` needs Python 3.12. The
    import of `mujoco.studio` registers the location of materials (`filament:pbr.filamat`), without
    which the first object would end the process.

    Raises:
        RenderError: this version of MuJoCo has no Filament renderer.
    """
    try:
        from mujoco import mjrf, studio  # noqa: F401
    except ImportError as error:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no Filament renderer ({error}); expected MuJoCo "
            f"{_EXPECTED} with mujoco.mjrf and mujoco.studio"
        ) from None
    return mjrf
