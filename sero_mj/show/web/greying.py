"""Shows robots without fresh data grey in the browser.

Studio 4.0 sends colours only with a model. So a model with other colours is announced in advance;
browsers fetch it in the background and switch to it within one or two frames (45 ms for the LWR).
"""

from __future__ import annotations

import copy
import time
import zlib

import mujoco
import numpy as np
from mujoco.studio.web import state_payload
from numpy.typing import NDArray

from ...decor.pen import GREY
from ...decor.scene_writer import GREYNESS
from .studio import StudioViewer

_FETCHING = 1.0  # time for browsers to fetch a model, and minimum time between two changes, s
_DEFAULT_RGBA = 0.5, 0.5, 0.5, 1.0  # rgba of a geom that has the colour of its material


def greyed(model: mujoco.MjModel, grey: NDArray[np.bool_]) -> mujoco.MjModel:
    """Returns a copy of a model in which the geoms `grey`, (ngeom,) bool, are grey."""
    model = copy.deepcopy(model)
    rgba = model.geom_rgba
    of_material = (rgba == np.array(_DEFAULT_RGBA, rgba.dtype)).all(axis=1)
    of_material &= model.geom_matid >= 0
    rgba[of_material] = model.mat_rgba[model.geom_matid[of_material]]
    rgba[grey, :3] += GREYNESS * (np.array(GREY) - rgba[grey, :3])
    return model


class Greying:
    """Switches browsers between models with different colours.

    Args:
        viewer: of the page.
    """

    def __init__(self, viewer: StudioViewer) -> None:
        self._viewer = viewer
        self._shown = b""
        self._changed = time.monotonic() - _FETCHING
        self._announced: dict[bytes, tuple[int, float]] = {}  # crc32, and time of the announcement
        self._is_first = True

    def show(self, grey: NDArray[np.bool_] | None) -> None:
        """Switches to a model with these grey geoms once browsers have had time to fetch it.

        Changes that revert faster are not shown; the label of the robot shows them.

        Args:
            grey: geoms, (ngeom,) bool; None for none.
        """
        key = b"" if grey is None or not grey.any() else grey.tobytes()
        if key == self._shown:
            self._is_first = False
            return
        now = time.monotonic()
        server = self._viewer.server
        if key not in self._announced or server.cached_model(self._announced[key][0]) is None:
            self._announced[key] = self._announce(grey if key else None), now
        crc32, since = self._announced[key]
        if not self._is_first and now - max(since, self._changed) < _FETCHING:
            return
        self._shown, self._changed, self._is_first = key, now, False
        bundle = server.cached_model(crc32)
        assert bundle is not None  # just announced, or found above
        self._viewer.change_model(bundle, crc32)

    def _announce(self, grey: NDArray[np.bool_] | None) -> int:
        model = self._viewer.model
        bundle = state_payload.serialize_model_bundle(
            model if grey is None else greyed(model, grey)
        )
        self._viewer.server.add_model(bundle)
        return zlib.crc32(bundle)
