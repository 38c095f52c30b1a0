"""Where billboards stand in the picture: two tidy columns beside each robot.

A column holds the panels of every second joint, in the order of the chain, as near to the height
of their joints as they can be without covering each other. The order never changes and heights
follow the joints continuously, so nothing jumps while the camera moves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def spread(centres: Array, heights: Array, gap: float, low: float, high: float) -> Array:
    """Moves intervals apart, in their given order, as little as needed.

    Args:
        centres: where they would like to be, (k,), pixels.
        heights: how tall they are, (k,), pixels.
        gap: least space between two, pixels.
        low: none begins below.
        high: none ends above. When there is no room for all, they shrink the gap, then overlap
            evenly, rather than leave the picture.

    Returns:
        centres (k,), the first lowest.
    """
    if not len(centres):
        return centres
    room = high - low
    needed = heights.sum() + gap * (len(heights) - 1)
    if needed > room and len(heights) > 1:
        gap = (room - heights.sum()) / (len(heights) - 1)
        needed = room
    below = np.concatenate([[0.0], np.cumsum(heights[:-1] + gap)])  # packed from zero
    start = centres - heights / 2 - below
    # The mean of the least non-decreasing sequence above and the greatest below is itself
    # non-decreasing, and continuous in the centres.
    rising = np.maximum.accumulate(start)
    falling = np.minimum.accumulate(start[::-1])[::-1]
    start = (rising + falling) / 2
    start = np.minimum(np.maximum(start, low), max(high - needed, low))
    return np.asarray(start + below + heights / 2)


def columns(
    anchors: Array,
    sizes: Array,
    side: NDArray[np.intp],
    gap: float,
    beside: float,
    width: int,
    height: int,
) -> Array:
    """Lays out the panels of one robot.

    Args:
        anchors: pixel of every joint, (k, 2).
        sizes: width and height of every panel, (k, 2), pixels.
        side: 0 for the left column, 1 for the right one, (k,).
        gap: space between panels, pixels.
        beside: space between a column and the outermost joint, pixels.
        width: of the picture, pixels.
        height: of the picture, pixels.

    Returns:
        centres of the panels, (k, 2), pixels from the lower left corner.
    """
    centres = np.empty((len(anchors), 2))
    for which, edge in ((0, anchors[:, 0].min() - beside), (1, anchors[:, 0].max() + beside)):
        index = (side == which).nonzero()[0]
        if not len(index):
            continue
        widths = sizes[index, 0]
        x = edge - widths / 2 if which == 0 else edge + widths / 2
        inner = widths / 2 + gap
        centres[index, 0] = np.maximum(np.minimum(x, width - inner), inner)
        # The chain's order, turned over when its last joint hangs below its first.
        order = index if anchors[index[-1], 1] >= anchors[index[0], 1] else index[::-1]
        centres[order, 1] = spread(anchors[order, 1], sizes[order, 1], gap, gap, height - gap)
    return centres
