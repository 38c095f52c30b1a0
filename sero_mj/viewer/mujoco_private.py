"""What sero-mj uses of MuJoCo that is not public: all of it stands here, each with its reason.

Therefore `mujoco>=4.0,<4.1`. Where another version lacks a part, `RenderError` names it.
"""

from __future__ import annotations

from typing import Any

import mujoco

from ..base.errors import RenderError

_EXPECTED = "4.0"


def _private(owner: Any, name: str, wanted_for: str) -> Any:
    """A private part; raises RenderError where this MuJoCo has none."""
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
