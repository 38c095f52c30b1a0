"""`Watch`: what a window shows of data that the user's own loop moves."""

from __future__ import annotations

import mujoco

from ..foreign.model_world import ModelWorld
from .mirror import Listener, Mirror


class Watch(Mirror):
    """Follows the data of an overlay, as a mirror follows its sources.

    It shows a copy, so that a window that is paused stands still while the user's loop goes on.

    Args:
        world: of the overlay.
    """

    def __init__(self, world: ModelWorld) -> None:
        self.world = world
        self.data = world.make_data()
        self._theirs: mujoco.MjData = world.data
        self.routes = []
        self.sources = {}

    @property
    def is_live(self) -> bool:
        """True: its time is the user's."""
        return True

    def open(self) -> None:
        """Does nothing: there are no sources."""

    def close(self) -> None:
        """Does nothing: there are no sources."""

    def wait(self, timeout: float) -> list[str]:
        """Returns at once: no source is silent."""
        return []

    def listen(self, listener: Listener) -> None:
        """Does nothing: no packets come."""

    def reset(self) -> None:
        """Does nothing: the data is the user's."""

    def advance(self, now: float | None = None) -> bool:
        """Takes over the user's data as it is now; `now` has no meaning here."""
        mujoco.mj_copyData(self.data, self.world.model, self._theirs)
        return True
