"""The names of coordinate axes that were clicked on (section 2.5)."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world import World
from .panels import Panels, labels_at, panel_sizes
from .pen import Kind
from .toggles import Bools
from .view import View


def name_panels(world: World, data: mujoco.MjData, named: Bools, view: View) -> Panels | None:
    """Returns a panel under the origin of every frame whose name is shown (M,), or None."""
    shown = named.nonzero()[0]
    if not len(shown):
        return None
    origins, depth = view.project(data.site_xpos[world.frames.site[shown]])
    inside = view.sees(origins, depth)
    shown, origins = shown[inside], origins[inside]
    if not len(shown):
        return None
    texts = [world.frames.names[i].encode("ascii", "replace")[:99] for i in shown]
    # Frames at one place have their names under each other, first frame on top.
    places = np.round(origins / (2 * view.font.height)).astype(int)
    seen: dict[tuple[int, ...], int] = {}
    centres = origins - [0.0, 1.0 * view.font.height]
    apart = 1.1 * float(panel_sizes(np.zeros(1), 1, view)[0, 1])
    for k, place in enumerate(map(tuple, places)):
        centres[k, 1] -= seen.get(place, 0) * apart
        seen[place] = seen.get(place, 0) + 1
    lines = [[text] for text in texts]
    centres, sizes = labels_at(view, centres, lines)
    return Panels(centres, sizes, lines, kind=Kind.NAME, items=shown)
