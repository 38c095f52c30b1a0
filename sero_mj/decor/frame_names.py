"""The names of coordinate axes that were clicked on (section 2.5)."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world import World
from .panels import Panels, panel_sizes
from .pen import Kind
from .toggles import Toggles
from .view import View


def name_panels(world: World, data: mujoco.MjData, toggles: Toggles, view: View) -> Panels | None:
    """Returns a panel under the origin of every frame whose name is shown, or None."""
    shown = toggles.frame_names.nonzero()[0]
    if not len(shown):
        return None
    origins, depth = view.project(data.site_xpos[world.frames.site[shown]])
    inside = (depth > view.near) & (origins >= 0).all(1)
    inside &= (origins < [view.width, view.height]).all(1)
    shown, origins = shown[inside], origins[inside]
    texts = [[world.frames.names[i].encode("ascii", "replace")[:99]] for i in shown]
    widths = np.array([view.font.width(text) for (text,) in texts], float)
    sizes = panel_sizes(widths, 1, view)
    # Frames at one place have their names under each other, first frame on top.
    places = np.round(origins / (2 * view.font.height)).astype(int)
    seen: dict[tuple[int, ...], int] = {}
    centres = origins - [0.0, 1.0 * view.font.height]
    for k, place in enumerate(map(tuple, places)):
        centres[k, 1] -= seen.get(place, 0) * sizes[k, 1] * 1.1
        seen[place] = seen.get(place, 0) + 1
    half = sizes / 2
    centres = np.clip(centres, half, np.maximum([view.width, view.height] - half, half))
    return Panels(centres, sizes, texts, kind=Kind.NAME, items=shown)
