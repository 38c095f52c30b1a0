"""Records the packets of a scene's sources, and decoded values with the names in the scene.

Numbers of joints and arrows have names such as `lwr.A1.torque [Nm]`; all are in SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...base.frames import Array, Bools, Ints
from ...robots.declared.inputs import Input
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ..receive.source import Source
from ..receive.structure import Rows
from ..record.joint_state_messages import JointStates
from ..record.recorder import SIGNALS_RATE, Recorder
from ..record.recording_format import Signals, media_type
from ..record.scene_files import attached_files
from ..record.triggered_recorder import TriggeredRecorder
from .route import Route
from .trigger import Trigger
from .units import robot_of
from .wiring import wire

Shapes = Mapping[str, tuple[int, ...]]

# Singular and units (for revolute and prismatic joints) of per-joint quantities, by last word.
_ONE: dict[str, tuple[str, str, str]] = {
    "angles": ("angle", "rad", "m"),
    "velocities": ("velocity", "rad/s", "m/s"),
    "accelerations": ("acceleration", "rad/s2", "m/s2"),
    "torques": ("torque", "Nm", "N"),
    "temperatures": ("temperature", "", ""),
    "values": ("value", "", ""),
}


@contextmanager
def record_sources(
    sources: Mapping[str, Source],
    path: Path | str,
    *,
    scene: Scene | None = None,
    overwrite: bool = False,
    signals_rate: float = SIGNALS_RATE,
) -> Iterator[Recorder]:
    """Records all packets that sources receive within the context; raises RecordingError.

    Args:
        sources: sources by name, such as `mirror.sources`. Replays are not recorded.
        scene: scene whose files are attached, and whose routes determine the names of decoded
            values.
        signals_rate: maximum rate at which decoded values of each source are recorded, 1/s.
    """
    about = {"sero-mj": __version__, "scene": "" if scene is None else scene.name}
    live = {name: source for name, source in sources.items() if source.is_live}
    recorder = Recorder(path, about=about, overwrite=overwrite, signals_rate=signals_rate)
    with recorder, _connected(recorder, live, scene):
        yield recorder


@contextmanager
def record_events(
    sources: Mapping[str, Source],
    trigger: Trigger | None,
    path_of: Callable[[int, float], Path],
    scene: Scene,
    **options: Any,
) -> Iterator[TriggeredRecorder]:
    """Records the packets around each time at which a condition holds, within the context.

    Raises RecordingError if a file exists or cannot be written, also at the end of the context.

    Args:
        sources: sources by name, live or replays.
        trigger: condition; None to record only on `record_now`.
        path_of: function from the number and arrival time of an event to the file.
        **options: options of `TriggeredRecorder`, such as `before` and `after`.
    """

    def find(name: str, rows: Rows, lengths: Ints) -> tuple[Bools, Callable[[int], str]]:
        if trigger is None:
            return np.zeros(len(rows), bool), str
        events, index = sources[name].decode_rows(rows, lengths)
        hits = trigger.find(name, events)
        holds = np.zeros(len(rows), bool)
        holds[index] = hits.holds
        return holds, lambda row: hits.describe(int(np.searchsorted(index, row)))

    about = {"sero-mj": __version__, "scene": scene.name}
    about |= {} if trigger is None else {"trigger": trigger.text}
    recorder = TriggeredRecorder(path_of, find, about=about, **options)
    with recorder, _connected(recorder, sources, scene):
        yield recorder


def record_last(
    sources: Mapping[str, Source],
    path_of: Callable[[int, float], Path],
    scene: Scene,
    seconds: float,
    signals_rate: float = SIGNALS_RATE,
) -> AbstractContextManager[TriggeredRecorder]:
    """Buffers the packets of the last `seconds` within the context; `record_now` writes them."""
    return record_events(
        sources, None, path_of, scene, before=seconds, after=0.0, signals_rate=signals_rate
    )


@contextmanager
def _connected(
    recorder: Recorder | TriggeredRecorder, sources: Mapping[str, Source], scene: Scene | None
) -> Iterator[None]:
    routes = [] if scene is None else wire(scene).routes
    try:
        files = {} if scene is None else attached_files(scene, scene.files())
        for of_file, file in files.items():
            recorder.attach(of_file, media_type(of_file), file.read_bytes())
        for name, source in sources.items():
            _add(recorder, name, source, scene, routes)
        yield
    finally:
        for source in sources.values():
            source.record_to(None)


def _add(
    recorder: Recorder | TriggeredRecorder,
    name: str,
    source: Source,
    scene: Scene | None,
    routes: list[Route],
) -> None:
    routed = None if scene is None else RoutedSignals(scene, routes, name, source.events)

    def decode(packet: bytes) -> Mapping[str, Array] | None:
        values = source.decode(packet)
        return values if values is None or routed is None else routed.of(values)

    recorder.add_source(
        name,
        kind=source.original.kind,
        declared=source.original.decoding_fields(),
        events=source.events,
        size=source.size,
        decode=decode,
        signals=None if routed is None else routed.signals,
    )
    source.record_to(partial(recorder.take, name))


def joint_names(name: str, robot: SerialRobot, quantity: str) -> list[str]:
    """Returns the name of a quantity for each joint, such as `lwr.A1.torque [Nm]`.

    Args:
        quantity: `torques`, `joint_angles`, `target_velocities`, or an input that the robot
            declares. The unit of such an input is that of its billboard line.
    """
    *before, last = quantity.removeprefix("joint_").split("_")
    word, revolute, prismatic = _ONE.get(last, (last, "", ""))
    if not revolute and robot.billboard_lines:
        declared = [
            line.unit
            for line in robot.billboard_lines
            if line.value == quantity and line.scale == 1.0 and line.unit
        ]
        revolute = prismatic = next(iter(declared), "")
    word = "_".join((*before, word))
    units = [revolute if kind == "revolute" else prismatic for kind in robot.types]
    return [
        f"{name}.{joint}.{word}" + (f" [{unit}]" if unit else "")
        for joint, unit in zip(robot.names, units, strict=True)
    ]


def joint_states_of(
    robots: Mapping[str, SerialRobot], keys: Collection[str], key_of: Callable[[str, str], str]
) -> dict[str, JointStates]:
    """Returns the joint states of the robots whose joint angles are recorded.

    Args:
        keys: keys of the recorded values, such as `lwr.joint_angles`.
        key_of: function from the names of robot and quantity to a key.
    """
    found = {}
    for name, robot in robots.items():
        angles, velocities, torques = (
            key if (key := key_of(name, quantity)) in keys else ""
            for quantity in ("joint_angles", "joint_velocities", "torques")
        )
        if angles:
            found[name] = JointStates(robot.names, angles, velocities, torques)
    return found


class RoutedSignals:
    """Decoded values of a source, with the names of the joints and arrows that they set.

    Routed numbers are results of the routes, in SI units. Other values are unchanged. Routes that
    depend on more than one packet are ignored.
    """

    def __init__(self, scene: Scene, routes: Sequence[Route], source: str, events: Shapes) -> None:
        self._routes = [
            route
            for route in routes
            if route.direct == source and not route.negated and _is_named(route.to)
        ]
        names = {route.to.target: _names_of(scene, route.to) for route in self._routes}
        routed = {event: np.zeros(int(np.prod(shape)), bool) for event, shape in events.items()}
        origins = {}
        for route in self._routes:
            for index, name in enumerate(names[route.to.target]):
                if origin := route.origin_of(index):
                    origins[name] = origin
            for term in route.value.terms:
                routed[term.origin.key][term.take] = True
        self._events = [event for event in events if not routed[event].all()]
        shapes: dict[str, tuple[int, ...]] = {
            target: (len(each),) for target, each in names.items()
        }
        shapes |= {event: tuple(events[event]) for event in self._events}
        joints = joint_states_of(scene.robots, shapes, "{}.{}".format)
        self.signals = Signals(shapes, names, origins, joints)

    def of(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the values of a decoded packet by the keys of `signals`."""
        found = {}
        with np.errstate(over="ignore", invalid="ignore"):
            for route in self._routes:
                found[route.to.target] = route.value.evaluate(lambda o: values[o.key].ravel())
        return found | {event: values[event] for event in self._events}


def _is_named(item: Input) -> bool:
    return item.kind in ("angles", "values", "vector")


def _names_of(scene: Scene, item: Input) -> list[str]:
    if item.kind != "vector":
        return joint_names(item.name, robot_of(scene, item), item.key)
    arrow = scene.arrows[item.name]
    unit = arrow.unit_text
    return [f"{item.name}.{axis}" + (f" [{unit}]" if unit else "") for axis in "xyz"]
