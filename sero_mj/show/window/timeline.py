"""The time line: where in a recording or a simulation one is, and where a drag on it leads."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TimeLine:
    """A bar with a handle, in pixels from the lower left corner of the window.

    Attributes:
        left: where it begins.
        bottom: its lower edge.
        width: of the whole bar.
        height: likewise.
        end: the time at its right end, s.
    """

    left: float
    bottom: float
    width: float
    height: float
    end: float

    def hits(self, x: float, y: float) -> bool:
        """Whether a press there is meant for it; a bar's height above and below is."""
        inside = self.left - self.height <= x <= self.left + self.width + self.height
        return inside and self.bottom - self.height <= y <= self.bottom + 2 * self.height

    def time_at(self, x: float) -> float:
        """Which time a pixel is at, s; beyond the ends it is that of the end."""
        share = (x - self.left) / max(self.width, 1.0)
        return min(max(share, 0.0), 1.0) * self.end

    def x_of(self, time: float) -> float:
        """Where a time is, pixels."""
        share = min(max(time / self.end, 0.0), 1.0) if self.end > 0 else 0.0
        return self.left + share * self.width
