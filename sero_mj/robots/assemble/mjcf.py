"""Builds the robots and surroundings of a scene as a `mujoco.MjSpec`.

A robot consists of a body at its base frame and one body per row of its DH table. Body i is at
T_{i-1,i}(q_i = 0). The joint axis is z of its own frame (craig) or of the parent frame (standard).
The base is a mocap body, or the child of a body of the robot on which it is mounted.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base import frames
from ...base.errors import DeclarationError, Problem, collect
from ...base.frames import Array, round_down_1_2_5
from ..declared.double import DOUBLE_GROUP, Double, path_fade
from ..declared.inputs import moving
from ..declared.mounts import base_frames, carrier, mount_order
from ..declared.robot import SerialRobot
from ..declared.scene import Scene
from ..declared.surroundings import KEY_DIRECTION, PALETTES, Look, Object, Palette
from ..importers.mjcf_file import as_spec
from .link_geometry import drawn_geoms, trim_geoms
from .mjcf_dynamics import (
    ON,
    add_dynamics,
    exclude_mounted,
    exclude_neighbours,
    is_limited,
    position_range,
    set_friction,
    set_inertia,
    set_up_dynamics,
)
from .mjcf_elements import (
    MESH,
    SITE_GROUP,
    finish_material,
    geom_type,
    half_sizes,
    mesh_assets,
    pose,
)
from .rigid_urdf import urdf_piece
from .robot_dynamics import RobotDynamics, declared_inertia

OBJECT_GROUP, ROBOT_GROUP = 0, 1
SKY = "sky"  # name of the sky texture
_DIRECTIONAL = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
_KEY_LIGHT = -4.0 * np.array(KEY_DIRECTION)  # position relative to the middle of the robots, m
_TILE = 0.25  # edge length of a floor tile, m
_SCENE_SIZE = 1.25  # size of a robot for which these values are suitable, m
_SLICES, _STACKS = 24, 10  # subdivisions of round geoms about and along their axis
_ROUND, _FINEST = 0.14, 2.5  # radius for which these suffice, m, and maximum refinement factor
_BALLS = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_TUBES = (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE)
_SPOT = mujoco.mjtLightType.mjLIGHT_SPOT
# A double is slightly smaller than its robot. Where both nearly coincide, the surface of the double
# is hidden in the robot, which avoids flicker (z-fighting).
_SHRINK = 0.985


def build_spec(scene: Scene, dynamics: Mapping[str, RobotDynamics] | None = None) -> mujoco.MjSpec:
    """Builds a scene as one `MjSpec`, with names scoped by robot (`lwr/link1`).

    `dynamics` contains the dynamics of the robots for simulation, or is None for display. Raises
    DeclarationError if a file is missing or cannot be read.
    """
    root = mujoco.MjSpec()
    root.modelname = scene.name
    root.compiler.degree = False
    # A moving body needs a mass, even if it is a link without geometry, as in a wrist.
    root.compiler.boundmass, root.compiler.boundinertia = 1e-9, 1e-12
    moved = moving(scene)
    _surroundings(root, scene, moved)
    if dynamics is not None:
        set_up_dynamics(root, has_free=any(item.is_free for item in scene.objects))
    problems = _clashes(scene)
    if problems:
        raise DeclarationError(scene.located(problems))
    for item in scene.objects:
        with collect(problems, f"objects.{item.name}"):
            _add_scene_object(root, item, moved, is_dynamic=dynamics is not None)
    unbuilt: set[str | None] = set()
    for name in mount_order(scene.robots):
        robot, count = scene.robots[name], len(problems)
        if carrier(robot) not in unbuilt:  # Otherwise, errors of the carrier are reported.
            with collect(problems, f"robots.{name}"):
                _add_robot(root, robot, None if dynamics is None else dynamics[name])
        if len(problems) > count or carrier(robot) in unbuilt:
            unbuilt.add(name)
    if problems:
        raise DeclarationError(scene.located(problems))
    if dynamics is not None:
        exclude_mounted(root, scene.robots, _standing_together(scene))
    bases = base_frames(scene.robots)
    for double in scene.doubles.values():
        _add_double(root, double, scene.robots[double.of], bases[double.of])
    _add_frames(root, scene)
    _refine_round_geoms(root)
    return root


def _refine_round_geoms(root: mujoco.MjSpec) -> None:
    # Round geoms that are so large that their edges are visible need more triangles. MuJoCo has one
    # setting for the whole model, and robots with many cylinders would take twice the time.
    largest = max((max(geom.size) for geom in root.geoms if geom.type in _BALLS), default=0.0)
    tubes = (float(geom.size[0]) for geom in root.geoms if geom.type in _TUBES)
    finer = np.clip(np.sqrt(max(largest, *tubes, 0.0) / _ROUND), 1.0, _FINEST)
    quality = root.visual.quality
    quality.numslices, quality.numstacks = round(_SLICES * finer), round(_STACKS * finer)


def _add_frames(root: mujoco.MjSpec, scene: Scene) -> None:
    for name in scene.frames:
        body = root.worldbody.add_body(name=f"frame-{name}", mocap=True)
        body.add_site(name=f"frame-{name}", group=SITE_GROUP)
    for arrow in scene.arrows.values():
        if arrow.site is not None:
            root.worldbody.add_site(name=arrow.site, pos=arrow.at, group=SITE_GROUP)


def _add_robot(root: mujoco.MjSpec, robot: SerialRobot, dynamics: RobotDynamics | None) -> None:
    piece = _robot_spec(robot)
    if dynamics is not None:
        add_dynamics(piece, robot, dynamics)
    if robot.mount is None:
        base = _attach(root, root.worldbody, piece, robot.name, robot.base_frame)
        base.mocap = dynamics is None or not robot.free_base
        if dynamics is not None and robot.free_base:
            _free_base(base, robot)
    else:
        at = root.site(_mount_site(robot.mount))
        T_body_mount = frames.frame(frames.rotation_from_quat(at.quat), at.pos)
        base = _attach(root, at.parent, piece, robot.name, T_body_mount @ robot.base_frame)
    if dynamics is not None:
        set_inertia(base, dynamics, 0)
        exclude_neighbours(root, robot)


def _free_base(base: mujoco.MjsBody, robot: SerialRobot) -> None:
    name = f"{robot.name}/{robot.base_joint}"
    if robot.free_base != "planar":
        base.add_freejoint(name=name)
        return
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for along, kind, axis in zip(("x", "y", "yaw"), kinds, robot.planar_base.axes, strict=True):
        base.add_joint(name=f"{name}_{along}", type=kind, axis=axis)


def _standing_together(scene: Scene) -> list[list[str]]:
    models = [scene.members(name) or [] for name, group in scene.groups.items() if group._declared]
    return [[name for name in robots if scene.robots[name].mount is None] for robots in models]


def _mount_site(mount: str) -> str:
    name, _, label = mount.partition("/")
    sites = {"base": "base", "flange": "flange_frame"}
    if label.startswith("link") and label[4:].isdigit():
        return f"{name}/frame{label[4:]}"
    return f"{name}/{sites.get(label, f'axes_{label}')}"


def _attach(
    root: mujoco.MjSpec, parent: Any, piece: mujoco.MjSpec, name: str, T: Array
) -> mujoco.MjsBody:
    prefix = f"{name}/"
    piece.compiler.boundmass = max(piece.compiler.boundmass, root.compiler.boundmass)
    piece.compiler.boundinertia = max(piece.compiler.boundinertia, root.compiler.boundinertia)
    base = parent.add_body(name=prefix, **pose(T))
    root.attach(piece, prefix=prefix, frame=base.add_frame())
    return base


def moved_body(name: str) -> str:
    """Returns the body name of an object or camera that a route or the simulation moves."""
    return f"moved-{name}"


def _moved_body(root: mujoco.MjSpec, name: str, T: Array) -> mujoco.MjsBody:
    return root.worldbody.add_body(name=moved_body(name), mocap=True, **pose(T))


def _clashes(scene: Scene) -> list[Problem]:
    problems = []
    taken = {"floor": "the floor already has this name"} if scene.floor else {}
    pieces = {name: "a robot already has this name" for name in scene.robots}
    for item in scene.objects:
        names = pieces if item.mjcf is not None or item.urdf is not None else taken
        if item.name in names:
            message = f"{names[item.name]}; expected a different name"
            problems.append(Problem(f"objects.{item.name}", message))
        taken[item.name] = pieces[item.name] = "two objects have this name"
    return problems


def _robot_spec(robot: SerialRobot) -> mujoco.MjSpec:
    root = mujoco.MjSpec()
    root.compiler.degree = False
    problems: list[Problem] = []
    inertia = declared_inertia(robot)
    # If no masses are declared, the masses of the meshes determine the scale of the arrows.
    geoms = drawn_geoms(root, robot, problems, hull="never" if inertia else "unless flat")
    geoms = [own + more for own, more in zip(geoms, trim_geoms(robot), strict=True)]
    body = root.worldbody
    _add_geoms(body, geoms[0])
    body.add_site(name="base", group=SITE_GROUP)
    links, centres = add_links(body, robot), joint_centres(robot)
    for i, body in enumerate(links):
        _add_geoms(body, geoms[i + 1])
        if inertia is not None:
            set_inertia(body, inertia, i + 1)
        body.add_site(name=f"frame{i + 1}", group=SITE_GROUP)
        # Arrows and billboards are at this site. Its z axis is the joint axis in both conventions.
        body.add_site(name=f"centre{i + 1}", group=SITE_GROUP, **pose(centres[i]))
    carrying = [root.worldbody, *links][robot.flange_link]
    flange = carrying.add_body(name="flange", **pose(robot.T_n_flange))
    flange.add_site(name="flange_frame", group=SITE_GROUP)
    wrong_children: list[Problem] = []
    for k, (child, T) in enumerate(zip(robot.children, robot.child_frames, strict=True)):
        with collect(wrong_children, f"children.{k}"):
            body = flange if child.on == "flange" else _body_on(root, child.on)
            _add_object(root, body, child, T, mirrored=robot.mirrored)
    if wrong_children or problems:
        raise DeclarationError(wrong_children + problems)
    return root


def add_links(base: mujoco.MjsBody, robot: SerialRobot) -> list[mujoco.MjsBody]:
    """Adds the bodies and joints of all n links to a base, and returns the bodies."""
    table, bodies = robot.kinematics, [base]
    at_zero, axes = table.link_transforms(np.zeros(robot.n)), table.axis_frames
    for i, carrier_index in enumerate(table.carriers.tolist()):
        body = bodies[carrier_index].add_body(name=f"link{i + 1}", **pose(at_zero[i]))
        bodies.append(body)
        joint: dict[str, Any] = {"axis": axes[i, :3, 2], "pos": axes[i, :3, 3]}
        if is_limited(robot, i):
            joint |= {"range": position_range(robot, i), "limited": True}
        kind = mujoco.mjtJoint.mjJNT_HINGE if table.revolute[i] else mujoco.mjtJoint.mjJNT_SLIDE
        body.add_joint(name=robot.names[i], type=kind, **joint)
    return bodies[1:]


def _body_on(root: mujoco.MjSpec, label: str) -> mujoco.MjsBody:
    name = f"{ON}{label}"
    body = root.worldbody if label == "base" else root.body(label)
    return root.body(name) or body.add_body(name=name)


def joint_centres(robot: SerialRobot) -> Array:
    """Returns poses of the joints' arrows and billboards in link frames, shape (n, 4, 4), m."""
    at = np.tile(np.eye(4), (robot.n, 1, 1))
    at[:, :3, 3] = robot.offsets
    return np.asarray(robot.kinematics.axis_frames @ at)


def _add_geoms(body: Any, geoms: list[dict[str, Any]]) -> None:
    for geom in geoms:  # Collision geoms are added only for simulation.
        body.add_geom(group=ROBOT_GROUP, contype=0, conaffinity=0, **geom)


def _surroundings(root: mujoco.MjSpec, scene: Scene, moved: Collection[str]) -> None:
    visual = root.visual
    palette = PALETTES[scene.view.look]
    _add_headlight(root, palette)
    visual.rgba.haze = [*palette.haze, 1]
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.quality.numslices, visual.quality.numstacks = _SLICES, _STACKS
    visual.quality.numquads = 1  # Boxes have 12 triangles, because arrows have hundreds of boxes.
    visual.map.znear, visual.map.zfar = 0.01, 50.0
    visual.map.haze = 0.92
    _add_sky(root, palette)
    if scene.floor:
        _add_floor(root, palette)
    for name, light in scene.lights.items():
        kind = _DIRECTIONAL if light.directional else _SPOT
        root.worldbody.add_light(
            name=name, pos=light.position, dir=light.direction, diffuse=light.diffuse, type=kind,
            castshadow=light.cast_shadow,
        )  # fmt: skip
    if not scene.lights:
        _add_key_light(root, palette, _middle_of(scene) + _KEY_LIGHT)
    for name, camera in scene.cameras.items():
        body = root.worldbody
        if name in moved:
            body = _moved_body(root, name, camera.frame)
        elif (camera.frame != np.eye(4)).any():
            body = body.add_body(name=f"camera-{name}", **pose(camera.frame))
        body.add_camera(
            name=name, pos=camera.position, fovy=camera.fovy_deg,
            xyaxes=_look_axes(camera.look_at - camera.position),
        )  # fmt: skip


def _middle_of(scene: Scene) -> Array:
    # MuJoCo's shadows have dark specks far from the axis of a light. The joint angles of a scene do
    # not matter, so that the same pose is drawn in the same way whether it is declared or received.
    bases = base_frames(scene.robots)
    links = [
        robot.kinematics.frames(np.zeros(robot.n), bases[name])[:, :3, 3].mean(axis=0)
        for name, robot in scene.robots.items()
    ]
    return np.mean(links, axis=0) if links else np.zeros(3)


def build_surroundings(
    look: Look,
    *,
    floor: float | None,
    sky: bool,
    lights: bool,
    middle: Array,
    size: float,
) -> mujoco.MjSpec:
    """Builds the default surroundings of scenes, without robots, for an external model.

    Args:
        floor: height of the floor, m; None for no floor.
        middle: center of the lit region, shape (3,), m.
        size: size of the lit region, m.
    """
    root = mujoco.MjSpec()
    palette = PALETTES[look]
    root.visual.headlight.active = int(lights)
    root.visual.rgba.haze = [*palette.haze, 1]
    if lights:
        _add_headlight(root, palette)
        _add_key_light(root, palette, middle + size / _SCENE_SIZE * _KEY_LIGHT)
    if sky:
        _add_sky(root, palette)
    if floor is not None:
        _add_floor(root, palette, floor, round_down_1_2_5(size / _SCENE_SIZE * _TILE))
    return root


def _add_headlight(root: mujoco.MjSpec, palette: Palette) -> None:
    headlight = root.visual.headlight
    ambient, diffuse = palette.headlight
    headlight.ambient, headlight.diffuse = [ambient] * 3, [diffuse] * 3
    headlight.specular = [0.05] * 3


def _add_key_light(root: mujoco.MjSpec, palette: Palette, at: Array) -> None:
    root.worldbody.add_light(
        name="key", pos=at, dir=KEY_DIRECTION, type=_DIRECTIONAL,
        diffuse=[palette.key] * 3, specular=[0.2] * 3, castshadow=True,
    )  # fmt: skip


def _add_sky(root: mujoco.MjSpec, palette: Palette) -> None:
    root.add_texture(
        name=SKY, type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=palette.sky[1], rgb2=palette.sky[0], width=64, height=384,
    )  # fmt: skip


def _add_floor(
    root: mujoco.MjSpec, palette: Palette, height: float = 0.0, tile: float = _TILE
) -> None:
    root.add_texture(
        name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=palette.tiles[0], rgb2=palette.tiles[1], markrgb=palette.tiles[2],
        width=256, height=256,
    )  # fmt: skip
    floor = root.add_material(
        name="floor", texrepeat=[0.5 / tile] * 2, texuniform=True, specular=0, shininess=0
    )
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    # A floor that casts shadows shows artifacts of its own shadow map.
    root.worldbody.add_geom(
        name="floor", type=geom_type("plane"), pos=[0, 0, height], size=[0, 0, 0.05],
        material="floor", group=OBJECT_GROUP, castshadow=False,
    )  # fmt: skip


def _look_axes(forward: Array) -> Array:
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(forward, up)) < 1e-9 * max(float(np.linalg.norm(forward)), 1.0):
        up = np.array([0.0, 1.0, 0.0])  # looking straight up or down
    right = np.cross(forward, up)
    return np.concatenate([right, np.cross(right, forward)])


def _add_scene_object(
    root: mujoco.MjSpec, item: Object, moved: Collection[str], *, is_dynamic: bool
) -> None:
    if is_dynamic and item.is_free:
        body = root.worldbody.add_body(name=moved_body(item.name), **pose(item.frame))
        body.add_freejoint(name=moved_body(item.name))
        _add_object(root, body, item, np.eye(4))
    elif item.shape == "limb":
        _add_limb(root, item)
    elif item.name in moved:
        _add_object(root, _moved_body(root, item.name, item.frame), item, np.eye(4))
    else:
        _add_object(root, root.worldbody, item, item.frame)


def _add_object(
    root: mujoco.MjSpec, body: mujoco.MjsBody, item: Object, T: Array, *, mirrored: bool = False
) -> None:
    if item.mjcf is not None:
        _attach(root, body, as_spec(item.mjcf, Path(item.directory)), item.name, T)
        return
    if item.urdf is not None:
        _attach(root, body, urdf_piece(Path(item.directory) / item.urdf), item.name, T)
        return
    if item.shape == "axes":
        body.add_site(name=f"axes_{item.name}", group=SITE_GROUP, **pose(T))
        return
    looks: list[dict[str, Any]] = [{}]
    if item.mesh is not None:
        path = Path(item.directory) / item.mesh
        try:
            scale = item.mesh_scale * (frames.MIRROR.diagonal()[:3] if mirrored else 1.0)
            meshes = mesh_assets(root, f"object_{item.name}", path, scale)
        except DeclarationError as error:
            raise DeclarationError([p.inside("mesh") for p in error.problems]) from error
        looks = [{"type": MESH, "meshname": mesh, "rgba": rgba} for mesh, rgba in meshes]
        if len(meshes) > 1 and item.mass is not None:
            for look, share in zip(looks, _mass_shares(path, scale), strict=True):
                look["mass"] = item.mass * share
    else:
        assert item.size is not None and item.shape is not None  # checked by Object
        looks = [{"type": geom_type(item.shape), "size": half_sizes(item.shape, item.size)}]
    for k, look in enumerate(looks):
        if look.get("rgba") is None or "rgba" in item.model_fields_set:
            look["rgba"] = item.rgba
        look.update(finish_material(root, item.finish))
        if item.mass is not None:
            look.setdefault("mass", item.mass)
        name = f"{item.name}_{k}" if k else item.name
        geom = body.add_geom(name=name, group=OBJECT_GROUP, **look, **pose(T))
        if item.friction is not None:
            set_friction(geom, item.friction)


def limb_bodies(name: str) -> list[str]:
    """Returns the body names of the two links of a limb."""
    return [f"limb-{name}", f"limb-{name}_1"]


def _add_limb(root: mujoco.MjSpec, item: Object) -> None:
    assert item.size is not None  # checked by Object
    for k, (body, length, radius) in enumerate(
        zip(limb_bodies(item.name), item.size[:2], item.size[2:], strict=True)
    ):
        link = root.worldbody.add_body(name=body, mocap=True, **pose(item.frame))
        link.add_geom(
            name=f"{item.name}_{k}" if k else item.name,
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0, 0, 0, 0, 0, length],
            size=[radius, 0, 0],
            rgba=item.rgba,
            group=OBJECT_GROUP,
            contype=0,
            conaffinity=0,
            **finish_material(root, item.finish),
        )


def _mass_shares(path: Path, scale: Any) -> Array:
    root = mujoco.MjSpec()
    for mesh, _ in mesh_assets(root, "mesh", path, scale):
        root.worldbody.add_body().add_geom(type=MESH, meshname=mesh)
    masses = root.compile().body_mass[1:]
    return np.asarray(masses / masses.sum())


def body_names(double: Double, robot: SerialRobot) -> list[list[str]]:
    """Returns the body names of a double, one row from base to last link for each drawn pose."""
    rows = 1 if double.path is None else double.path_length
    return [
        [f"double-{double.name}-{row}-link{i}" for i in range(robot.n + 1)] for row in range(rows)
    ]


def frame_names(double: Double, robot: SerialRobot) -> list[str]:
    """Returns the names of the bodies at the link frames of a double; none for a path."""
    if double.path is not None:
        return []
    return [f"double-{double.name}-frame{i + 1}" for i in range(robot.n)]


def _add_double(
    root: mujoco.MjSpec, double: Double, robot: SerialRobot, T_world_base: Array
) -> None:
    # Doubles are compiled at zero joint angles, and the world hides them later. If they were
    # compiled far away, MuJoCo would scale near plane, far plane and shadows to this distance.
    rows = body_names(double, robot)
    geoms = drawn_geoms(root, robot, [], _SHRINK)  # Problems are reported for the robot itself.
    at_zero = robot.kinematics.frames(np.zeros(robot.n), T_world_base)
    centres = joint_centres(robot)
    for names, share in zip(rows, path_fade(len(rows)), strict=True):
        rgba = double.rgba * [1, 1, 1, share]
        look = {"rgba": rgba, "group": DOUBLE_GROUP, "material": ""}
        for i, name in enumerate(names):
            body = root.worldbody.add_body(name=name, mocap=True, **pose(at_zero[i]))
            for geom in geoms[i]:
                body.add_geom(contype=0, conaffinity=0, mass=0, **{**geom, **look})
    # Frames need separate bodies, as links that coincide with the robot are moved out of sight.
    for i, name in enumerate(frame_names(double, robot)):
        body = root.worldbody.add_body(name=name, mocap=True, **pose(at_zero[i + 1]))
        body.add_site(name=name, group=SITE_GROUP)
        centre = f"double-{double.name}-centre{i + 1}"
        body.add_site(name=centre, group=SITE_GROUP, **pose(centres[i]))
        if i == robot.flange_link - 1:
            flange = f"double-{double.name}-flange"
            body.add_site(name=flange, group=SITE_GROUP, **pose(robot.T_n_flange))
