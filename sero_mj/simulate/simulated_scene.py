"""The scene of a simulation: with it as a source, and routes, doubles and arrows that show it."""

from __future__ import annotations

import copy

import numpy as np

from ..base.frames import frame
from ..robots.declared.cartesian import ReceivedFrame, SmartArrow
from ..robots.declared.double import Double
from ..robots.declared.scene import Scene
from .disturbances import Force
from .drag_force import DragForce
from .runs.run_log import RunLayout, event_of
from .runs.run_source import RunSource
from .scenario import Scenario
from .simulation import Simulation

SOURCE = "simulation"
# Inputs that robots get of the log, unless the scene routes something else there.
_SHOWN = ("joint_angles", "torques", "commanded_torques", "base_frame")


def simulated_scene(simulation: Simulation, source: RunSource | None = None) -> Scene:
    """Returns a scene that shows a simulation and advances it.

    Rows of doubles stand along the targets' paths where `[run]` asks for them.

    Args:
        simulation: that is shown.
        source: that hands in its rows; one to its end when None.
    """
    scenario, layout = simulation.scenario, simulation.layout
    scene = with_routes(scenario, layout, source or RunSource(run=simulation))
    if scenario.run.show_paths:
        _add_paths(scene, scenario, layout, simulation.rows)
    if simulation.drag_force is not None:
        _show_drag(scene, simulation.drag_force)
    return scene


def with_routes(scenario: Scenario, layout: RunLayout, source: object) -> Scene:
    """Returns the scene as it is shown: with the source, and routes from it.

    Robots get measured angles and torques and commanded torques, and their external torques where
    an input has that name; targets get transparent doubles, pushes get arrows, and what is carried
    goes along. What the scenario's scene routes itself is left as it is.

    Args:
        scenario: what is simulated.
        layout: of the log's rows.
        source: that hands them in, or a table that declares it.
    """
    scene = copy.copy(scenario.scene)
    scene.sources = {SOURCE: source, **scene.sources}
    scene.robots = dict(scene.robots)
    scene.doubles, scene.arrows = dict(scene.doubles), dict(scene.arrows)
    routes = {}
    for name, robot in scene.robots.items():
        for key in (*_SHOWN, *robot.inputs):
            if event_of(name, key) in layout.columns:
                routes[f"{name}.{key}"] = f"{SOURCE}.{event_of(name, key)}"
        if name in layout.targets and scenario.run.show_targets:
            double = _add_double(scene, name)
            routes[f"{double}.joint_angles"] = f"{SOURCE}.{event_of(name, 'target_angles')}"
    routes |= _show_pushes(scene, scenario, layout)
    for each in scene.objects:
        if (event := event_of(each.name, "frame")) in layout.columns:
            routes[f"{each.name}.frame"] = f"{SOURCE}.{event}"
    own = {target: origin for target, origin in routes.items() if scene.routed(target) is None}
    scene.routes = {**own, **scene.routes}
    return scene


def _show_pushes(scene: Scene, scenario: Scenario, layout: RunLayout) -> dict[str, str]:
    """Adds arrows for pushes and for what robots touch; returns routes to them."""
    routes = {}
    for name, disturbance in scenario.disturbances.items():
        if not isinstance(disturbance, Force) or not disturbance.show:
            continue
        for key in ("force", "torque"):
            if (event := event_of(name, key)) in layout.columns:
                arrow = _add_arrow(scene, name, key, disturbance)
                routes[f"{arrow}.vector"] = f"{SOURCE}.{event}"
    for name in scene.robots:
        event = event_of(name, "contact_force")
        if event in layout.columns and (scenario.obstacles or len(scene.robots) > 1):
            arrow = _free(scene, f"{name}_contact")
            scene.arrows[arrow] = SmartArrow(
                name=arrow, kind="force", at=f"{name}/flange", expressed_in="world"
            )
            routes[f"{arrow}.vector"] = f"{SOURCE}.{event}"
    return routes


def _add_paths(scene: Scene, scenario: Scenario, layout: RunLayout, rows: np.ndarray) -> None:
    """Adds a row of doubles along the way that every robot's target takes."""
    for name in layout.targets:
        angles = rows[:, layout.columns[event_of(name, "target_angles")]]
        if np.ptp(angles, axis=0).max() < 1e-6:
            continue
        # Evenly along the way, not in time: resting places would come again and again.
        steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
        way = np.hstack([0.0, np.cumsum(steps)])
        picked = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], 40)))
        path = angles[picked]
        double = _free(scene, f"{name}_path")
        scene.doubles[double] = Double(name=double, of=name, path=path, path_length=6)


def _add_double(scene: Scene, robot: str) -> str:
    name = _free(scene, f"{robot}_target")
    scene.doubles[name] = Double(name=name, of=robot)
    return name


def _show_drag(scene: Scene, drag: DragForce) -> None:
    """Adds an arrow for what is pulled by drag, shown once something is, at the grabbed point."""
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
    at = force.at
    if force.point.any():
        at = _free(scene, f"{arrow}_point")
        there = frame(np.eye(3), force.point)
        received = ReceivedFrame(name=at, relative_to=force.at, frame=there, show_axes=False)
        scene.frames = {**scene.frames, at: received}
    scene.arrows[arrow] = SmartArrow(
        name=arrow,
        kind="force" if key == "force" else "torque",
        at=at,
        expressed_in=force.expressed_in,
    )
    return arrow


def _free(scene: Scene, name: str) -> str:
    """The name, with a number if it is taken."""
    taken = {*scene.robots, *scene.doubles, *scene.arrows, *scene.frames, *scene.cameras}
    taken |= {each.name for each in scene.objects}
    while name in taken:
        name += "_"
    return name
