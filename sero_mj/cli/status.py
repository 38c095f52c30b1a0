"""`sero-mj status`: shows packet rates and errors of the sources of a scene."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import UsageError
from ..base.options import Duration
from ..base.plugins import NETWORKS, load_plugin, plugins
from ..robots.declared.degrees import degrees_warning
from .arguments import command, print_json, until_ended
from .shared_options import JsonOptions, ReplayOptions, SceneArgument
from .terminal import make_console

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..base.frames import Array
    from ..data.drive.route import Route
    from ..data.drive.wiring import Wiring
    from ..data.receive.source import Source
    from ..data.record.file_source import FileSource
    from ..robots.declared.scene import Scene

_HELP = """\
examples:
  sero-mj status lwr_udp                    live, until Ctrl+C
  sero-mj status lwr_udp --duration 5 --json
  sero-mj status run.mcap --duration 5      a recording, while it plays

The command opens the sources of the scene, so no viewer can use the same ports at the same time.
It counts rejected packets by cause. The exit status is 1 if a source received no valid packet.
"""

_INTERVAL = 0.25  # time between updates, s
_INFO_ROWS = ("state", "controller", "clock", "received", "blanked")  # other rows report errors
GROUP, ORDER = "receive", 20


class StatusOptions(SceneArgument, ReplayOptions, JsonOptions):
    """Show packet rates and errors of the sources of a scene.

    Attributes:
        scene: file or included name of a scene or recording.
        duration: observation time in seconds (default: until Ctrl+C).
        topics: list the topics at an address such as ros2://, and the robots that a topic can move.
        as_json: print only JSON, at the end.
    """

    duration: Duration | None = None
    topics: bool = False


def run(options: StatusOptions) -> int:
    """Shows the sources; returns 0 if every source received a valid packet, otherwise 1."""
    from ..data.drive.wiring import wire
    from .opening import with_scene

    if options.topics:
        return _print_topics(options)
    options = with_scene(options)
    scene = options.read_replayed(options.scene)
    wiring = wire(scene).check(scene)
    sources = list(wiring.sources.values())
    if not sources:
        raise UsageError(f"scene '{scene.name}' has no source to watch")
    reports = _Reports(scene, wiring)
    with ExitStack() as stack:
        for source in sources:
            source.open()
            stack.callback(source.close)
        with until_ended():
            _watch(reports, sources, options.duration, live=not options.as_json)
        found = reports()
    if options.as_json:
        print_json(found)
    elif not sys.stdout.isatty():
        _print(found)
        silent = [entry["source"] for entry in found if not entry["received"]]
        for port in [place[1] for name in silent if (place := wiring.sources[name].place)][:1]:
            hint = f"sero-mj structure --sniff {port or 'PORT'} shows all packets at its port"
            print(hint, file=sys.stderr)
    return 0 if all(entry["good"] for entry in found) else 1


add_to = command("status", run, StatusOptions, _HELP)


def _print_topics(options: StatusOptions) -> int:
    scheme, separator, _ = options.scene.partition("://")
    if not separator or scheme not in plugins(NETWORKS):
        known = " or ".join(f"{name}://" for name in plugins(NETWORKS)) or "an extension"
        raise UsageError(f"--topics: found {options.scene}; expected {known}")
    duration = 2.0 if options.duration is None else options.duration
    network = load_plugin(NETWORKS, scheme)
    return int(network.print_topics(options.scene, duration, as_json=options.as_json))


class _Reports:
    def __init__(self, scene: Scene, wiring: Wiring) -> None:
        self._sources = wiring.sources
        self._degrees = DegreesCheck(scene, wiring)
        self._warnings = dict.fromkeys(wiring.sources, "")

    def __call__(self) -> list[dict[str, Any]]:
        from ..data.receive.report import report

        for name, source in self._sources.items():
            self._warnings[name] = self._warnings[name] or self._degrees.check_latest(source)
        return [
            {**report(source), "angles": self._warnings[name]}
            for name, source in self._sources.items()
        ]


def _watch(reports: _Reports, sources: list[Source], duration: float | None, *, live: bool) -> None:
    from rich.live import Live

    begin = time.monotonic()
    end = begin + (float("inf") if duration is None else duration)

    def wait() -> bool:
        left = end - time.monotonic()
        time.sleep(min(max(left, 0.0), _INTERVAL))
        for source in sources:
            source.advance_to(time.monotonic() - begin)
        return left > 0

    if not (live and sys.stdout.isatty()):
        while wait():
            reports()
        return
    with Live(console=make_console(), refresh_per_second=1 / _INTERVAL) as screen:
        while wait():
            screen.update(_table(reports()))


def _rows(entry: dict[str, Any]) -> list[tuple[str, str, str]]:
    from ..data.receive.report import describe

    return describe(entry) + ([("angles", "", entry["angles"])] if entry["angles"] else [])


def _table(found: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    table = Table("source", "", "", "")
    for entry in found:
        title = f"{entry['source']}\n{entry['about']}"
        for row in _rows(entry):
            style = "" if row[0] in _INFO_ROWS else "bold red"
            table.add_row(title, *row, style=style)
            title = ""
        table.add_section()
    return table


def _print(found: list[dict[str, Any]]) -> None:
    for entry in found:
        print(f"{entry['source']}: {entry['about']}")
        for what, count, why in _rows(entry):
            print(f"  {what:15} {count:>10}  {why}")


_CHECKED = 5  # number of checked times in a recording


class DegreesCheck:
    """A check that warns if joint angles from sources look like degrees instead of radians."""

    def __init__(self, scene: Scene, wiring: Wiring) -> None:
        self._routes = [
            (route, scene.robots[name])
            for route in wiring.routes
            for name, _, key in (route.to.target.partition("."),)
            if key == "joint_angles" and route.direct and name in scene.robots
        ]

    def check_latest(self, source: Source) -> str:
        """Returns a warning about the latest valid packet of a source, or an empty string."""
        latest = source.latest()
        for route, robot in self._routes:
            if latest is not None and str(route.direct) == source.name:
                numbers = {key: values.ravel() for key, values in latest.values.items()}
                if found := degrees_warning(robot, _evaluated(route, numbers)):
                    return found
        return ""

    def check_recording(self, replay: FileSource) -> str:
        """Returns a warning about packets at sampled times of a recording, or an empty string."""
        is_routed = any(str(route.direct) == replay.name for route, _ in self._routes)
        if not is_routed or replay.recorded.is_unreadable:
            return ""
        with replay:
            begin = replay.position
            for position in np.linspace(begin, begin + replay.duration, _CHECKED):
                replay.seek(float(position))
                if found := self.check_latest(replay):
                    return found
        return ""


def _evaluated(route: Route, numbers: Mapping[str, Array]) -> Array:
    with np.errstate(all="ignore"):
        return route.value.evaluate(lambda origin: numbers[origin.key])
