"""Private parts of MuJoCo that sero-mj uses, with the reason for each.

They exist in `mujoco>=4.0,<4.1`. If another version lacks one, a RenderError names the missing
part.
"""

from __future__ import annotations

from typing import Any

import mujoco

from ...base.errors import RenderError

_EXPECTED = "4.0"


def context_of(renderer: mujoco.Renderer) -> mujoco.MjrContext:
    """Returns the OpenGL context of a renderer, which `mujoco.Renderer` does not expose.

    Textures of drafts are uploaded into the context, and panels are laid out with its font widths.
    """
    try:
        context: mujoco.MjrContext = renderer._mjr_context
    except AttributeError:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no {type(renderer).__name__}._mjr_context, which is "
            f"needed for images; expected MuJoCo {_EXPECTED}"
        ) from None
    return context


def filament() -> Any:
    """Returns the module of MuJoCo's Filament renderer, with its materials registered.

    The wrapper `mujoco.rendering.filament` needs Python 3.12, so this is `mujoco.mjrf`. Importing
    `mujoco.studio` registers the location of materials (`filament:pbr.filamat`); without it, the
    first object ends the process.

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
