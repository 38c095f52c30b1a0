"""`Pulling`: pulls links of simulated robots by the pointer, or says why that cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import SeroError
from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ..decor.toggles import Toggles
from ..session.clock import Clock
from ..session.picking import Pixel
from ..session.scene_decor import SceneDecor

_SAME_TIME = 1e-6  # s


class Pulling:
    """Pulls what a mirror simulates while it is shown.

    Args:
        mirror: what is shown.
        clock: of it.
        toggles: what is shown of it; the values of the force are while it acts.

    Attributes:
        is_on: whether something is pulled.
    """

    def __init__(self, mirror: LiveWorld, clock: Clock, toggles: Toggles) -> None:
        self._mirror, self._clock, self._toggles = mirror, clock, toggles
        found = [each for each in mirror.sources.values() if getattr(each, "drag_force", None)]
        self._source: Any = found[0] if found else None
        self._hand: Any = found[0].hand if found else None  # type: ignore[attr-defined]
        self._at: Pixel = (0.0, 0.0)
        self._card: int | None = None  # of the arrow, shown only while it is pulled
        self.is_on = False

    @property
    def can_pull(self) -> bool:
        """Whether anything here is simulated."""
        return self._hand is not None

    def begin(self, decor: SceneDecor, at: Pixel) -> tuple[str, bool] | None:
        """Grabs the link at a pixel of the picture.

        Args:
            decor: of the picture.
            at: the pixel, y up.

        Returns:
            a message for the user, and whether it says why nothing is pulled; None where no link
            is at the pixel.
        """
        data = self._mirror.data
        found = decor.link_at(data, at)
        if found is None:
            return None
        frame, point = found
        why = self._refusal(frame.partition("/")[0])
        if why:
            return why, True
        world = self._mirror.world
        site = world.frames.site[world.frames.names.index(frame)]
        in_frame = data.site_xmat[site].reshape(3, 3).T @ (point - data.site_xpos[site])
        try:
            self._hand.grab(frame, in_frame)
        except SeroError as error:
            return str(error), True
        self.is_on, self._at = True, at
        self._show_card()
        goes_on = "; it acts when time goes on" if self._clock.is_paused else ""
        return f"pulls {frame} with {self._strength()}{goes_on}", False

    def announce(self, decor: SceneDecor, at: Pixel) -> tuple[str, bool] | None:
        """Says what a drag from there would pull; see `begin`, which does it."""
        found = decor.link_at(self._mirror.data, at)
        if found is None:
            return None
        why = self._refusal(found[0].partition("/")[0])
        return why or f"drag to pull {found[0]}", bool(why)

    def _refusal(self, robot: str) -> str:
        """Why nothing can be pulled now; empty where it can."""
        if self._hand is None:
            what = "not simulated"
            if self._mirror.sources:
                live = self._mirror.is_live
                what = "mirrored from packets" if live else "played from a recording"
            return f"{robot} is {what}; only simulated robots can be pushed"
        if self._source.error is not None:
            return f"the simulation has stopped: {self._source.error}"
        now, run = self._clock.time, self._source.run
        if now < run.time - run.scenario.run.timestep - _SAME_TIME:
            return f"the past cannot be pushed: go on from {run.time:.2f} s, where the run is"
        if self._clock.is_at_end:
            return f"the run is over at {run.time:g} s; --set run.duration=60 makes it longer"
        return ""

    def _show_card(self) -> None:
        names = self._mirror.world.arrows.names
        if self._hand.name in names:
            index = names.index(self._hand.name)
            self._toggles.vectors[index] = True
            if not self._toggles.cards[index]:
                self._toggles.cards[index], self._card = True, index

    def move(self, at: Pixel) -> None:
        """Moves the pointer."""
        self._at = at

    def update(self, decor: SceneDecor) -> str:
        """Pulls to where the pointer is, in the plane of the picture through the point.

        Returns:
            what to tell the user of trouble with it: nothing.
        """
        view = decor.view
        if not self.is_on or view is None:
            return ""
        if self._refusal(""):  # it has ended, or the past is shown
            self.end()
            return ""
        self._hand.target = target_of(view.position, view.forward, self._hand.place,
                                      view.at(np.array(self._at, float), 1.0))  # fmt: skip
        return ""

    def stronger(self, steps: float) -> str:
        """Makes the spring stiffer by so many steps of the wheel; returns what to tell."""
        self._hand.make_stronger(steps)
        return f"pulls with {self._strength()}"

    def _strength(self) -> str:
        return f"{self._hand.stiffness:.0f} N/m, at most {self._hand.limit:.0f} N"

    def end(self) -> None:
        """Lets go."""
        if self.is_on:
            self.is_on = False
            self._hand.release()
        if self._card is not None:
            self._toggles.cards[self._card], self._card = False, None

    def keep(self, folder: Path) -> str:
        """Saves what was pulled, see `save_pushes`, or the run alone; returns what to tell.

        Raises:
            SeroError: nothing was pulled, or it cannot be written.
        """
        if self._hand is None:
            return "nothing is simulated here; only pushes of simulated robots can be kept"
        from ...simulate.save_pushes import save_pushes, save_run

        if self._source.end is None or self._source.run.scenario.file is None:
            path = save_run(self._source.run, folder)
            return f"kept: {path.name}; sero-mj plot {path.name} draws it"
        path = save_pushes(self._source.run, folder)
        return f"kept: {path.name} repeats the pushes, {path.stem}.mcap is the run"


def target_of(eye: Array, forward: Array, point: Array, ray: Array) -> Array:
    """Returns where a ray meets the plane through a point that is parallel to the picture.

    Args:
        eye: position of the camera, (3,), m.
        forward: its direction, unit vector (3,).
        point: of the plane, (3,), m.
        ray: any other point of the ray from the eye, (3,), m.
    """
    depth = (point - eye) @ forward
    return eye + (ray - eye) * (depth / ((ray - eye) @ forward))
