"""How large the text of decor is in a picture of some height."""

from __future__ import annotations

from ..assemble.world_view import WorldView
from ..decor.font import nearest_font_scale

_TEXT_OF_SCALE = 0.7  # text height over picture height per unit of billboard_scale


def font_scale(world: WorldView, height: int) -> int:
    """Returns MuJoCo's font scale, percent, for a picture of `height` pixels."""
    scales = [part.robot.billboard_scale for part in world.robots.values()] or [0.05]
    return nearest_font_scale(_TEXT_OF_SCALE * max(scales) * height)
