"""What sero-mj uses of MuJoCo that is not public: all of it stands here, each with its reason.

Therefore `mujoco>=4.0,<4.1`. Where another version lacks a part, `RenderError` names it.
"""

from __future__ import annotations

from typing import Any

import mujoco

from ...base.errors import RenderError

_EXPECTED = "4.0"


def _private(owner: Any, name: str, wanted_for: str) -> Any:
    try:
        return getattr(owner, name)
    except AttributeError:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no {getattr(owner, '__name__', type(owner).__name__)}"
            f".{name}, which is needed for {wanted_for}; expected MuJoCo {_EXPECTED}"
        ) from None


def context_of(renderer: mujoco.Renderer) -> mujoco.MjrContext:
    """The OpenGL context of a renderer.

    `mujoco.Renderer` hands it out nowhere; textures of drafts are uploaded into it, and the widths
    of its letters lay out panels.
    """
    context: mujoco.MjrContext = _private(renderer, "_mjr_context", "pictures")
    return context


def filament() -> Any:
    """The module of MuJoCo's Filament renderer, with its materials registered.

    `mujoco.mjrf` is used as it is, because the wrapper in `mujoco.rendering.filament` needs Python
    3.12. Importing `mujoco.studio` is what registers where materials (`filament:pbr.filamat`) are
    found; without it the first object ends the process.

    Raises:
        RenderError: this MuJoCo has none.
    """
    try:
        from mujoco import mjrf, studio  # noqa: F401
    except ImportError as error:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no Filament renderer ({error}); expected MuJoCo "
            f"{_EXPECTED} with mujoco.mjrf and mujoco.studio"
        ) from None
    return mjrf
