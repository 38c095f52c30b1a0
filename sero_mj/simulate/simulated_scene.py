"""Scenes of simulations, with routes, doubles and arrows that show the run."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from ..base.frames import Array, frame
from ..data.record.csv_files import is_table
from ..data.record.formats import open_recording
from ..robots.declared.cartesian import ReceivedFrame, SmartArrow
from ..robots.declared.double import Double
from ..robots.declared.scene import Scene
from .disturbances import Force
from .drag_force import DragForce
from .runs.run_log import event_of, recorded_event
from .runs.run_recording import read_run
from .runs.run_source import RunSource
from .scenario import Scenario
from .simulation import Simulation

SOURCE = "simulation"
# Robot inputs that are routed from the log.
_SHOWN = ("joint_angles", "torques", "commanded_torques", "base_frame")


def simulated_scene(simulation: Simulation, source: RunSource | None = None) -> Scene:
    """Returns a scene that shows and advances a simulation.

    If the run sets `show_paths`, a series of doubles shows the path of each target.

    Args:
        source: source of the log rows (default: a source that ends with the run).
    """
    scenario, columns = simulation.scenario, simulation.layout.columns
    scene = with_routes(scenario, columns, source or RunSource(run=simulation))
    if scenario.run.show_paths:
        for name in simulation.layout.targets:
            angles = simulation.rows[:, columns[event_of(name, "target_angles")]]
            _add_path(scene, name, angles)
    if simulation.drag_force is not None:
        _show_drag(scene, simulation.drag_force)
    return scene


def replayed_scene(scenario: Scenario, file: Path) -> Scene:
    """Returns a scene that shows a recording of a scenario without simulating it.

    Args:
        scenario: recorded scenario, whose controllers are not created.
        file: recording or table. If a recording has no simulation, `replay_instead` reports it.

    Raises:
        RecordingError: the file cannot be read.
    """
    if is_table(file):
        return with_routes(scenario, (), {"kind": "table", "file": str(file)})
    with open_recording(file) as recording:
        source = recording.sources.get(SOURCE)
        recorded = [] if source is None else [*source.events]
        scene = with_routes(scenario, recorded, {"kind": "replay", "file": str(file)})
        if scenario.run.show_paths and source is not None:
            log = read_run(file, SOURCE, scene=scenario.scene)
            for name in log.robots:
                if (event := event_of(name, "target_angles")) in log.signals:
                    _add_path(scene, name, log.signals[event])
    return scene


def with_routes(scenario: Scenario, events: Collection[str], source: object) -> Scene:
    """Returns the scenario's scene with a source, and routes from its events.

    Robots get measured angles, measured and commanded torques, and all signals with the name of an
    input. Targets get transparent doubles, pushes get arrows, and carried objects move. Existing
    routes of the scene take precedence.

    Args:
        events: names of log events. A recording may have old names (see `recorded_event`).
    """

    def is_there(event: str) -> bool:
        return recorded_event(event, events) in events

    scene = copy.copy(scenario.scene)
    scene.sources = {SOURCE: source, **scene.sources}
    scene.robots = dict(scene.robots)
    scene.doubles, scene.arrows = dict(scene.doubles), dict(scene.arrows)
    routes = {}
    for name, robot in scene.robots.items():
        for key in (*_SHOWN, *robot.inputs):
            if is_there(event_of(name, key)):
                routes[f"{name}.{key}"] = f"{SOURCE}.{event_of(name, key)}"
        if is_there(event_of(name, "target_angles")) and scenario.run.show_targets:
            double = _add_double(scene, name)
            routes[f"{double}.joint_angles"] = f"{SOURCE}.{event_of(name, 'target_angles')}"
    routes |= _show_pushes(scene, scenario, is_there)
    for each in scene.objects:
        if is_there(event := event_of(each.name, "frame")):
            routes[f"{each.name}.frame"] = f"{SOURCE}.{event}"
    own = {target: origin for target, origin in routes.items() if scene.routed(target) is None}
    scene.routes = {**own, **scene.routes}
    return scene


def _show_pushes(
    scene: Scene, scenario: Scenario, is_there: Callable[[str], bool]
) -> dict[str, str]:
    """Adds arrows for pushes and contacts, and returns their routes."""
    routes = {}
    for name, disturbance in scenario.disturbances.items():
        if not isinstance(disturbance, Force) or not disturbance.show:
            continue
        for key in ("force", "torque"):
            if is_there(event := event_of(name, key)):
                arrow = _add_arrow(scene, name, key, disturbance)
                routes[f"{arrow}.vector"] = f"{SOURCE}.{event}"
    for name in scene.robots:
        event = event_of(name, "contact_force")
        if is_there(event) and (scenario.obstacles or len(scene.robots) > 1):
            arrow = _free(scene, f"{name}_contact")
            scene.arrows[arrow] = SmartArrow(
                name=arrow, kind="force", at=f"{name}/flange", expressed_in="world"
            )
            routes[f"{arrow}.vector"] = f"{SOURCE}.{event}"
    return routes


def _add_path(scene: Scene, name: str, angles: Array) -> None:
    if len(angles) == 0 or np.ptp(angles, axis=0).max() < 1e-6:
        return
    # The poses are evenly spaced along the path, not in time, so that poses at rest do not repeat.
    steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    way = np.hstack([0.0, np.cumsum(steps)])
    picked = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], 40)))
    double = _free(scene, f"{name}_path")
    scene.doubles[double] = Double(name=double, of=name, path=angles[picked], path_length=6)


def _add_double(scene: Scene, robot: str) -> str:
    name = _free(scene, f"{robot}_target")
    scene.doubles[name] = Double(name=name, of=robot)
    return name


def _show_drag(scene: Scene, drag: DragForce) -> None:
    point = f"{drag.name}_point"
    scene.frames = {**scene.frames, point: ReceivedFrame(name=point, show_axes=False)}
    scene.arrows[drag.name] = SmartArrow(
        name=drag.name, kind="force", at=point, expressed_in="world", decimals=1, show=False
    )
    scene.routes = {
        **scene.routes,
        f"{point}.frame": f"{SOURCE}.{event_of(drag.name, 'frame')}",
        f"{drag.name}.vector": f"{SOURCE}.{event_of(drag.name, 'force')}",
    }


def _add_arrow(scene: Scene, name: str, key: str, force: Force) -> str:
    arrow = _free(scene, name if key == "force" else f"{name}_{key}")
    at = within = scene.frame_name(force.at)
    if force.point.any():
        at = _free(scene, f"{arrow}_point")
        there = frame(np.eye(3), force.point)
        received = ReceivedFrame(name=at, relative_to=within, frame=there, show_axes=False)
        scene.frames = {**scene.frames, at: received}
    scene.arrows[arrow] = SmartArrow(
        name=arrow,
        kind="force" if key == "force" else "torque",
        at=at,
        expressed_in=scene.frame_name(force.expressed_in),
    )
    return arrow


def _free(scene: Scene, name: str) -> str:
    taken = {*scene.robots, *scene.doubles, *scene.arrows, *scene.frames, *scene.cameras}
    taken |= {each.name for each in scene.objects}
    while name in taken:
        name += "_"
    return name
