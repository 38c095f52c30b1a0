"""`arrange`: where picture, a tool's area, time line and status line are in a window."""

from __future__ import annotations

from typing import NamedTuple

# Heights and widths in lines of the window's text.
_STATUS, _TIME = 1.6, 1.3
_AREA_SHARE = 0.34  # fraction of the width for the area beside the picture
_STRIP_SHARE = 0.36  # fraction of the height for the area below the picture, in a narrow window
_NARROW = 46.0  # in a narrower window the area is below the picture
_LEAST_STRIP = 10.0  # minimum height
_LEAST_AREA = 20.0  # minimum width


class Rect(NamedTuple):
    """A rectangle in a window, pixels from its lower left corner."""

    left: int
    bottom: int
    width: int
    height: int


class Places(NamedTuple):
    """Where the parts of a window are; None for one that is not shown."""

    picture: Rect
    area: Rect | None
    time: Rect | None
    status: Rect | None


def arrange(
    size: tuple[int, int], text: int, *, has_status: bool, has_time: bool, has_area: bool
) -> Places:
    """Returns the places of a window's parts, which do not cover each other."""
    width, whole = size
    low = round(_STATUS * text) if has_status else 0
    high = round(_TIME * text) if has_time else 0
    status = Rect(0, 0, width, low) if low else None
    line = Rect(0, low, width, high) if high else None
    bottom, height = low + high, max(whole - low - high, 1)
    if not has_area:
        return Places(Rect(0, bottom, width, height), None, line, status)
    if width < _NARROW * text:
        strip = round(min(max(_STRIP_SHARE * height, _LEAST_STRIP * text), 0.5 * height))
        picture = Rect(0, bottom + strip, width, max(height - strip, 1))
        return Places(picture, Rect(0, bottom, width, strip), line, status)
    beside = round(max(_AREA_SHARE * width, _LEAST_AREA * text))
    left = width - beside
    area = Rect(left, bottom, beside, height)
    return Places(Rect(0, bottom, left, height), area, line, status)
