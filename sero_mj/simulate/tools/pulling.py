"""`Pulling`: pulls links of simulated robots with the pointer, or shows why this is impossible."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...base.errors import SeroError
from ...viewer.image.picking import Pixel
from ...viewer.session.background_exports import BackgroundExports
from ...viewer.session.tool import Action, Grab, Shown, Tool
from ...viewer.tools.handle_drag import target_of
from ..runs.run_source import RunSource
from ..save_pushes import save_pushes, save_run

_SAME_TIME = 1e-6  # tolerance for equal times, s


class Pulling(Tool):
    """Pulls links of robots that are simulated while they are shown.

    Attributes:
        is_on: whether a link is being pulled.
    """

    order: ClassVar[int] = 30

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self._mirror, self._clock, self._toggles = shown.mirror, shown.clock, shown.toggles
        found = [
            each
            for each in shown.mirror.sources.values()
            if isinstance(each, RunSource) and each.drag_force is not None
        ]
        self._source: Any = found[0] if found else None
        self._force: Any = found[0].drag_force if found else None
        self._at: Pixel = (0.0, 0.0)
        self._card: int | None = None  # billboard of the force arrow, shown while pulling
        self.is_on = False
        self._exports = BackgroundExports()

    def actions(self) -> Mapping[str, Action]:
        is_live = any(source.is_live for source in self._mirror.sources.values())
        return {} if is_live else {"keep": self._keep}

    def grab(self, at: Pixel) -> Grab | None:
        """Grabs the link at a pixel, or returns why it cannot be pulled."""
        data = self._mirror.data
        found = self.shown.decor.link_at(data, at)
        if found is None:
            return None
        frame, point = found
        why = self._refusal(frame.partition("/")[0])
        if why:
            return Grab(why, is_refused=True)
        world = self._mirror.world
        site = world.frames.site[world.frames.names.index(frame)]
        in_frame = data.site_xmat[site].reshape(3, 3).T @ (point - data.site_xpos[site])
        try:
            self._force.grab(frame, in_frame)
        except SeroError as error:
            return Grab(str(error), is_refused=True)
        self.is_on, self._at = True, at
        self._show_card()
        paused = "; the force acts when the simulation continues" if self._clock.is_paused else ""
        return Grab(f"pulls {frame} with {self._strength()}{paused}")

    def announce(self, at: Pixel) -> Grab | None:
        """Returns what a drag from a pixel would pull."""
        found = self.shown.decor.link_at(self._mirror.data, at)
        if found is None:
            return None
        why = self._refusal(found[0].partition("/")[0])
        return Grab(why or f"drag to pull {found[0]}", bool(why))

    def _refusal(self, robot: str) -> str:
        if self._force is None:
            what = "not simulated"
            if self._mirror.sources:
                live = self._mirror.is_live
                what = "mirrored from packets" if live else "played from a recording"
            return f"{robot} is {what}; only simulated robots can be pulled"
        if self._source.error is not None:
            return f"the simulation has stopped: {self._source.error}"
        now, run = self._clock.time, self._source.run
        if now < run.time - run.scenario.run.timestep - _SAME_TIME:
            return f"the past cannot be changed. Return to the current time, {run.time:.2f} s"
        if self._clock.is_at_end:
            return f"the run has ended at {run.time:g} s; --set run.duration=60 extends it"
        return ""

    def _show_card(self) -> None:
        names = self._mirror.world.arrows.names
        if self._force.name in names:
            index = names.index(self._force.name)
            self._toggles.vectors[index] = True
            if not self._toggles.cards[index]:
                self._toggles.cards[index], self._card = True, index

    def move(self, at: Pixel) -> None:
        self._at = at

    def drag(self) -> str:
        """Pulls the point toward the pointer, in a plane parallel to the image."""
        view = self.shown.decor.view
        if not self.is_on or view is None:
            return ""
        if self._refusal(""):  # the run has ended, or the past is shown
            self.release()
            return ""
        self._force.target = target_of(view.position, view.forward, self._force.place,
                                      view.at(np.array(self._at, float), 1.0))  # fmt: skip
        return ""

    def wheel(self, notches: float) -> str | None:
        if not self.is_on:
            return None
        self._force.make_stronger(notches)
        return f"pulls with {self._strength()}"

    def _strength(self) -> str:
        return f"{self._force.stiffness:.0f} N/m, at most {self._force.limit:.0f} N"

    def release(self) -> None:
        if self.is_on:
            self.is_on = False
            self._force.release()
        if self._card is not None:
            self._toggles.cards[self._card], self._card = False, None

    def _keep(self) -> str:
        """Saves the pushes with `save_pushes`, or only the run, and returns a message.

        Raises:
            SeroError: there are no pushes, or the file cannot be written.
        """
        if self._force is None:
            return "no robot is simulated; only pushes of simulated robots can be saved"
        folder, run = self.shown.folder or Path(), self._source.run
        if self._source.end is None or run.scenario.file is None:
            path = save_run(run, folder)
            self._exports.add_page(path)
            return f"saved {path.name}; sero-mj plot {path.name} plots it"
        path = save_pushes(run, folder)
        self._exports.add_page(path.with_suffix(".mcap"))
        return (
            f"saved the scenario {path.name}, which repeats the pushes, and the recording "
            f"{path.stem}.mcap"
        )

    def next_message(self) -> tuple[str, bool] | None:
        return self._exports.advance()

    def close(self) -> None:
        self._exports.close(finish=False)
