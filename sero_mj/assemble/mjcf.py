"""A scene's robots and surroundings as MJCF, built with PyMJCF.

A robot becomes one mocap body at its base frame with a chain of bodies, one per row of its DH
table, whose frames are the DH frames: body i stands at T_{i-1,i}(q_i = 0) and turns about, or
slides along, z of its own frame (craig) or of its parent's (standard).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from ..errors import DeclarationError, Problem
from .inputs import moving
from .looks import PALETTES
from .mjcf_double import add_double
from .mjcf_dynamics import add_dynamics, exclude_neighbours, set_up_dynamics
from .mjcf_geoms import SITE_GROUP, joint_axis_frame, joint_centre, mesh_asset, set_pose, shape_geom
from .mjcf_piece import read_piece
from .objects import Object
from .robot import SerialRobot
from .robot_dynamics import RobotDynamics
from .robot_parts import LinkMesh
from .scene import Scene
from .shapes import SHELL, grow_links

Array = NDArray[np.float64]

OBJECT_GROUP, ROBOT_GROUP = 0, 1
_DENSITY = 1000.0  # kg/m3: what links weigh when their file does not say
# Declared sizes are full lengths, MuJoCo's are half lengths; radii are the same.
_HALF: dict[str, Any] = {"box": 0.5, "cylinder": np.array([1, 0.5]), "capsule": np.array([1, 0.5])}
_STILL = {"contype": 0, "conaffinity": 0}  # what only mirrors a robot does not collide


def build_mjcf(
    scene: Scene, dynamics: Mapping[str, RobotDynamics] | None = None
) -> mjcf.RootElement:
    """Returns the scene as one MJCF tree, names scoped by robot (`lwr/link1`).

    Args:
        scene: what to build.
        dynamics: of every robot, for the variant that is simulated; None for that which is
            looked at.

    Raises:
        DeclarationError: an MJCF piece cannot be read, or a file is missing.
    """
    root = mjcf.RootElement(model=scene.name)
    _set_up(root)
    moved = moving(scene)
    _surroundings(root, scene, moved)
    if dynamics is not None:
        set_up_dynamics(root)
    problems = _clashes(scene)
    if problems:
        raise DeclarationError(scene.located(problems))
    for item in scene.objects:
        try:
            if item.name in moved:
                _add_object(root, _moved_body(root, item.name, item.frame), item, np.eye(4))
            else:
                _add_object(root, root.worldbody, item, item.frame)
        except DeclarationError as error:
            problems += [problem.inside(f"objects.{item.name}") for problem in error.problems]
    for name, robot in scene.robots.items():
        try:
            _add_robot(root, robot, None if dynamics is None else dynamics[name])
        except DeclarationError as error:
            problems += [problem.inside(f"robots.{name}") for problem in error.problems]
    if problems:
        raise DeclarationError(scene.located(problems))
    for double in scene.doubles.values():
        add_double(root, double, scene.robots[double.of])
    _add_frames(root, scene)
    return root


def _add_frames(root: mjcf.RootElement, scene: Scene) -> None:
    for name in scene.frames:
        body = root.worldbody.add("body", name=f"frame-{name}", mocap=True)
        _add_site(body, f"frame-{name}")
    for arrow in scene.arrows.values():
        if arrow.site is not None:
            root.worldbody.add("site", name=arrow.site, pos=arrow.at, group=SITE_GROUP)


def _add_robot(root: mjcf.RootElement, robot: SerialRobot, dynamics: RobotDynamics | None) -> None:
    piece = build_robot_mjcf(robot)
    if dynamics is not None:
        add_dynamics(piece, robot, dynamics)
    base = root.attach(piece)
    base.mocap = True
    set_pose(base, robot.base_frame)
    if dynamics is not None:
        exclude_neighbours(root, base, robot)


def moved_body(name: str) -> str:
    """Name of the body of an object or camera that a route moves."""
    return f"moved-{name}"


def _moved_body(root: mjcf.RootElement, name: str, T: Array) -> Any:
    body = root.worldbody.add("body", name=moved_body(name), mocap=True)
    set_pose(body, T)
    return body


def _clashes(scene: Scene) -> list[Problem]:
    """Names that two things of the model would have."""
    problems = []
    taken = {"floor": "the floor has this name"} if scene.floor else {}
    pieces = {name: "a robot has this name" for name in scene.robots}
    for item in scene.objects:
        names = taken if item.mjcf is None else pieces
        if item.name in names:
            message = f"{names[item.name]}; expected another name"
            problems.append(Problem(f"objects.{item.name}", message))
        taken[item.name] = pieces[item.name] = "two objects have this name"
    return problems


def xml_text(root: mjcf.RootElement) -> str:
    """Returns the tree as XML."""
    # A floor in its own shadow map is strewn with speckles. PyMJCF 1.0.50 does not know the
    # attribute that MuJoCo 4 has for it.
    text: str = root.to_xml_string()
    return re.sub(r'(<geom name="floor"(?=[^>]*type="plane"))', r'\1 castshadow="false"', text)


def build_robot_mjcf(robot: SerialRobot) -> mjcf.RootElement:
    """Returns one robot; its world body is the robot's base."""
    root = mjcf.RootElement(model=robot.name)
    geometry = _Geometry(root, robot)
    body = root.worldbody
    geometry.add_link(body, 0)
    _add_site(body, "base")
    table = robot.dh
    at_zero = table.link_transforms(np.zeros(robot.n))
    for i in range(robot.n):
        body = body.add("body", name=f"link{i + 1}")
        set_pose(body, at_zero[i])
        axis_frame = joint_axis_frame(robot, i)
        joint: dict[str, Any] = {"axis": axis_frame[:3, 2], "pos": axis_frame[:3, 3]}
        if robot.position_limits is not None:
            joint |= {"range": robot.position_limits[i], "limited": True}
        kind = "hinge" if table.revolute[i] else "slide"
        body.add("joint", name=robot.names[i], type=kind, **joint)
        geometry.add_link(body, i + 1)
        _add_site(body, f"frame{i + 1}")
        # Arrows and billboards stand here; its z is the joint's axis in both conventions.
        centre = body.add("site", name=f"centre{i + 1}", group=SITE_GROUP)
        set_pose(centre, joint_centre(robot, i))
    flange = body.add("body", name="flange")
    set_pose(flange, robot.flange_frame)
    _add_site(flange, "flange_frame")
    problems: list[Problem] = []
    for k, child in enumerate(robot.children):
        try:
            _add_object(root, flange, child, child.frame)
        except DeclarationError as error:
            problems += [problem.inside(f"children.{k}") for problem in error.problems]
    problems += geometry.problems
    if problems:
        raise DeclarationError(problems)
    return root


class _Geometry:
    """Adds the visible geometry of a robot's links: its mesh files, or shapes grown from DH."""

    def __init__(self, root: mjcf.RootElement, robot: SerialRobot) -> None:
        self._root = root
        self._robot = robot
        self._grown = (
            [] if robot.filenames else grow_links(robot.dh, robot.flange_frame, robot.strokes)
        )
        self.problems: list[Problem] = []

    def add_link(self, body: Any, i: int) -> None:
        if self._grown:
            for shape in self._grown[i]:
                look = {"rgba": shape.rgba, "group": ROBOT_GROUP}
                body.add("geom", **look, **shape_geom(shape), **_STILL)
            return
        for k, mesh in enumerate(self._robot.filenames[i]):
            try:
                self._add_mesh(body, f"link{i}_{k}", mesh)
            except DeclarationError as error:
                self.problems += [p.inside(f"filenames.{i}") for p in error.problems]

    def _add_mesh(self, body: Any, name: str, mesh: LinkMesh) -> None:
        path = Path(self._robot.directory) / mesh.file
        asset = mesh_asset(self._root, name, path, self._robot.mesh_scale)
        rgba = SHELL if mesh.color is None else self._robot.colors[mesh.color]
        body.add("geom", type="mesh", mesh=asset, rgba=rgba, group=ROBOT_GROUP, **_STILL)


def _set_up(root: mjcf.RootElement) -> None:
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    # A link without geometry (an axis of a wrist) still needs a mass to be a moving body.
    root.compiler.boundmass, root.compiler.boundinertia = 1e-3, 1e-6
    root.default.geom.density = _DENSITY


def _surroundings(root: mjcf.RootElement, scene: Scene, moved: Collection[str]) -> None:
    visual = root.visual
    palette = PALETTES[scene.view.look]
    ambient, diffuse = palette.headlight
    visual.headlight.ambient, visual.headlight.diffuse = [ambient] * 3, [diffuse] * 3
    visual.rgba.haze = [*palette.haze, 1]
    visual.headlight.specular = [0.05] * 3
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.quality.numslices, visual.quality.numstacks = 24, 10
    visual.quality.numquads = 1  # boxes of 12 triangles: arrows have hundreds of them
    visual.map.znear, visual.map.zfar = 0.01, 50.0
    root.asset.add(
        "texture", name="sky", type="skybox", builtin="gradient",
        rgb1=palette.sky[0], rgb2=palette.sky[1], width=64, height=384,
    )  # fmt: skip
    if scene.floor:
        root.asset.add(
            "texture", name="tiles", type="2d", builtin="checker", mark="edge",
            rgb1=palette.tiles[0], rgb2=palette.tiles[1], markrgb=palette.tiles[2],
            width=256, height=256,
        )  # fmt: skip
        root.asset.add("material", name="floor", texture="tiles", texrepeat=[2, 2], texuniform=True)
        root.worldbody.add(
            "geom", name="floor", type="plane", size=[0, 0, 0.05], material="floor",
            group=OBJECT_GROUP,
        )  # fmt: skip
    for name, light in scene.lights.items():
        root.worldbody.add(
            "light", name=name, pos=light.position, dir=light.direction, diffuse=light.diffuse,
            directional=light.directional, castshadow=light.cast_shadow,
        )  # fmt: skip
    if not scene.lights:
        root.worldbody.add(
            "light", name="key", pos=[1.5, -1.5, 4], dir=[-0.35, 0.4, -1], directional=True,
            diffuse=[palette.key] * 3, specular=[0.2] * 3, castshadow=True,
        )  # fmt: skip
    for name, camera in scene.cameras.items():
        body = root.worldbody
        if name in moved:
            body = _moved_body(root, name, camera.frame)
        elif (camera.frame != np.eye(4)).any():
            body = body.add("body", name=f"camera-{name}")
            set_pose(body, camera.frame)
        body.add(
            "camera", name=name, pos=camera.position, fovy=camera.fovy_deg,
            xyaxes=_look_axes(camera.look_at - camera.position),
        )  # fmt: skip


def _look_axes(forward: Array) -> Array:
    """Camera x and y axes (6,) that look along `forward` with the world's z up in the picture."""
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(forward, up)) < 1e-9 * max(float(np.linalg.norm(forward)), 1.0):
        up = np.array([0.0, 1.0, 0.0])  # looking straight up or down
    right = np.cross(forward, up)
    return np.concatenate([right, np.cross(right, forward)])


def _add_site(body: Any, name: str) -> None:
    body.add("site", name=name, group=SITE_GROUP)


def _add_object(root: mjcf.RootElement, body: Any, item: Object, T: Array) -> None:
    if item.mjcf is not None:
        piece = read_piece(item.mjcf, Path(item.directory))
        piece.model = item.name
        set_pose(body.add("site", name=f"{item.name}_at", group=SITE_GROUP).attach(piece), T)
        return
    if item.shape == "axes":
        set_pose(body.add("site", name=f"axes_{item.name}", group=SITE_GROUP), T)
        return
    kind: dict[str, Any]
    if item.mesh is not None:
        path = Path(item.directory) / item.mesh
        try:
            asset = mesh_asset(root, f"object_{item.name}", path, item.mesh_scale)
        except DeclarationError as error:
            raise DeclarationError([p.inside("mesh") for p in error.problems]) from error
        kind = {"type": "mesh", "mesh": asset}
    else:
        assert item.size is not None and item.shape is not None  # checked by Object
        kind = {"type": item.shape, "size": item.size * _HALF.get(item.shape, 1.0)}
    set_pose(body.add("geom", name=item.name, rgba=item.rgba, group=OBJECT_GROUP, **kind), T)
