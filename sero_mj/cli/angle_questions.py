"""Questions about angles that sources send to robots, and that look like degrees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..robots.declared.degrees import degrees_warning

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..base.frames import Array
    from ..data.drive.route import Route
    from ..data.drive.wiring import Wiring
    from ..data.receive.source import Source
    from ..data.record.file_source import FileSource
    from ..robots.declared.scene import Scene

_CHECKED = 5  # positions of a recording


class AngleQuestions:
    """Questions about the joint angles that routes lead from a source to a robot.

    Args:
        scene: with the robots.
        wiring: of the scene's sources.
    """

    def __init__(self, scene: Scene, wiring: Wiring) -> None:
        self._routes = [
            (route, scene.robots[name])
            for route in wiring.routes
            for name, _, key in (route.to.target.partition("."),)
            if key == "joint_angles" and route.direct and name in scene.robots
        ]

    def about_latest(self, source: Source) -> str:
        """Returns a question about the newest good packet of a source; empty for none."""
        latest = source.latest()
        for route, robot in self._routes:
            if latest is not None and str(route.direct) == source.name:
                numbers = {key: values.ravel() for key, values in latest.values.items()}
                if found := degrees_warning(robot, _evaluated(route, numbers)):
                    return found
        return ""

    def about_recording(self, replay: FileSource) -> str:
        """Returns a question about packets at some positions of a recording; empty for none.

        Raises:
            SourceError: the recording cannot be read.
        """
        leads = any(str(route.direct) == replay.name for route, _ in self._routes)
        if not leads or replay.recorded.is_unreadable:
            return ""
        with replay:
            begin = replay.position
            for position in np.linspace(begin, begin + replay.duration, _CHECKED):
                replay.seek(float(position))
                if found := self.about_latest(replay):
                    return found
        return ""


def _evaluated(route: Route, numbers: Mapping[str, Array]) -> Array:
    with np.errstate(all="ignore"):
        return route.value.evaluate(lambda origin: numbers[origin.key])
