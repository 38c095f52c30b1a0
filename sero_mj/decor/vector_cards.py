"""What a click on a smart arrow brings up: name, components, magnitude, unit, frame (2.4)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world_view import WorldView
from .cards import Cards, heights_in_order
from .lines import NO_DATA
from .panels import panel_sizes
from .pen import Kind
from .picture_view import PictureView

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class VectorCards:
    """The cards of one world's smart arrows."""

    def __init__(self, world: WorldView) -> None:
        self._world = world
        heights = world.state(world.make_data()).site_xpos[world.arrows.site, 2]
        self._rank = heights_in_order(heights)

    def cards(
        self,
        data: mujoco.MjData,
        shown: Bools,
        view: PictureView,
        components: Array,
        reach: Array,
        stale: list[str],
    ) -> Cards | None:
        """Returns the cards that are to be shown and whose arrow is in the picture.

        Args:
            data: the world's state.
            shown: which ones, (K,).
            view: of the picture.
            components: as received, (K, 3), NaN for no data.
            reach: how far every arrow reaches from its point, (K,), m.
            stale: why there is no fresh data, for each; empty where there is.
        """
        index = shown.nonzero()[0]
        if not len(index):
            return None
        anchors, depth = view.project(data.site_xpos[self._world.arrows.site[index]])
        inside = view.sees(anchors, depth)
        index, anchors, depth = index[inside], anchors[inside], depth[inside]
        if not len(index):
            return None
        texts = [self._text(int(i), components[i], stale[i]) for i in index]
        widest = np.array([max(view.font.width(line) for line in lines) for lines in texts])
        return Cards(
            kind=Kind.CARD,
            items=index,
            anchors=anchors,
            sizes=panel_sizes(widest, np.array([len(lines) for lines in texts]), view),
            texts=texts,
            side=(index + 1) % 2,
            rank=self._rank[index],
            clear=float((reach[index] / view.pixel_size(1.0) / depth).max()),
        )

    def _text(self, i: int, components: Array, stale: str) -> list[bytes]:
        name = self._world.arrows.names[i]
        arrow = self._world.scene.arrows[name]
        lines = [f"{name}: {arrow.kind.replace('_', ' ')}"]
        if np.isfinite(components).all():
            width, decimals = arrow.decimals + 5, arrow.decimals
            numbers = {"x": components[0], "y": components[1], "z": components[2]}
            numbers["size"] = np.linalg.norm(components)
            lines += [
                f"  {label:4} {round(float(value), decimals) + 0.0:{width}.{decimals}f} "
                f"{arrow.unit_text}"
                for label, value in numbers.items()
            ]
        else:
            lines.append("  " + NO_DATA.decode())
        lines.append(f"  in {arrow.components_in}")
        if stale:
            lines.append(f"  {stale}")
        return [line.encode("ascii", "replace")[:99] for line in lines]
