"""Converts shapes, viewpoints and lights of X3D to objects, cameras and lights of scene files."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.frames import Array, rotation_about
from .vrml_nodes import Node, Problems, get, instance
from .wrl import VisitedNode, by_color, color_of, rotation, triangles_of
from .wrl_geometry import Triangles, is_open, with_hull

LIGHT_SHARE = 0.7  # factor for X3D intensities, which compensates headlight and ambient light
_CAMERA_DISTANCE = 1.0  # distance of the look-at point if the center is behind the camera, m
_LIGHT_DISTANCE = 4.0  # distance of directional lights from the origin, m
_MIN_ROLL = np.deg2rad(1.0)


def object_table(
    seen: VisitedNode, problems: Problems, left_out: dict[str, int]
) -> tuple[dict[str, Any] | None, str, int]:
    """Converts a Shape to the table of an object.

    The kind and line of an unknown geometry are added to `left_out`.

    Returns:
        table with a primitive or MJCF, or None for an invisible Shape; suggested name of the
        object; and number of triangles.
    """
    geometry: Node | None = get(seen.node, "geometry", "SFNode", None, problems)
    geometry = geometry and (instance(geometry) or geometry)
    if geometry is None:
        return None, "", 0
    name = geometry.name or geometry.kind.lower()
    table = _primitive(geometry, seen.T, problems)
    if table is not None:
        rgba = color_of(seen.node, problems)
        if rgba is not None:
            table["rgba"] = rgba.round(6).tolist()
        return table, name, 0
    pieces = by_color(triangles_of(seen, problems, left_out))
    count = sum(len(faces) for _, faces, _ in pieces)
    return {"mjcf": mesh_text(pieces)} if pieces else None, name, count


def _primitive(geometry: Node, T: Array, problems: Problems) -> dict[str, Any] | None:
    scales = np.linalg.norm(T[:3, :3], axis=0)
    if not (scales > 0).all():
        return None
    axes = T[:3, :3] / scales
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0  # The primitives below equal their mirror images.
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-9:
        return None
    shape, turned = "", np.eye(3)
    if geometry.kind == "Box":
        shape = "box"
        size = get(geometry, "size", "SFVec3f", np.full(3, 2.0), problems) * scales
    elif geometry.kind == "Sphere":
        radii = get(geometry, "radius", "SFFloat", 1.0, problems) * scales
        is_round = np.ptp(radii) < 1e-9 * np.abs(radii).max()
        shape, size = ("sphere", radii[:1]) if is_round else ("ellipsoid", radii)
    elif geometry.kind == "Cylinder":
        parts = [get(geometry, key, "SFBool", True, problems) for key in ("top", "bottom", "side")]
        radius = get(geometry, "radius", "SFFloat", 1.0, problems)
        height = get(geometry, "height", "SFFloat", 2.0, problems)
        if not all(parts) or abs(scales[0] - scales[2]) > 1e-9 * scales[0]:
            return None
        shape, size = "cylinder", np.array([radius * scales[0], height * scales[1]])
        turned = rotation_about(0, -np.pi / 2)  # Cylinder axes are y in X3D and z in MuJoCo.
    else:
        return None
    if not (size > 0).all():
        message = f"found {size.tolist()}; expected lengths above 0"
        problems.add(geometry.label, message, geometry.line)
        return None
    there = np.eye(4)
    there[:3, :3], there[:3, 3] = axes @ turned, T[:3, 3]
    table: dict[str, Any] = {"shape": shape, "size": rounded(size)}
    if not np.allclose(there, np.eye(4), rtol=0, atol=1e-15):
        table["frame"] = rounded(there)
    return table


def mesh_text(pieces: list[Triangles]) -> str:
    """Returns MJCF text with a mesh for each piece. Open surfaces have no mass."""
    meshes, geoms = [], []
    for k, (vertices, faces, rgba) in enumerate(pieces):
        points = " ".join(f"{value:.7g}" for value in with_hull(vertices).ravel())
        corners = " ".join(map(str, faces.ravel().tolist()))
        kind, mass = ("shell", ' mass="0"') if is_open(vertices, faces) else ("convex", "")
        mesh = f'<mesh name="m{k}" inertia="{kind}" vertex="{points}" face="{corners}"/>'
        meshes.append(mesh)
        color = "" if rgba is None else f' rgba="{" ".join(f"{value:.6g}" for value in rgba)}"'
        geoms.append(f'<geom type="mesh" mesh="m{k}" contype="0" conaffinity="0"{mass}{color}/>')
    assets, body = "\n".join(meshes), "\n".join(geoms)
    return f"<mujoco><asset>\n{assets}\n</asset><worldbody>\n{body}\n</worldbody></mujoco>\n"


def view_axes(viewpoint: Node, problems: Problems) -> Array:
    """Returns the right, up and backward axes of a Viewpoint in its parent's frame, as columns."""
    default = np.array([0.0, 0.0, 1.0, 0.0])
    with problems.collect(f"{viewpoint.label}.orientation", viewpoint.line):
        return rotation(get(viewpoint, "orientation", "SFRotation", default, problems))
    return np.eye(3)


def camera_table(seen: VisitedNode, problems: Problems) -> tuple[dict[str, Any], float]:
    """Returns the camera table of a Viewpoint, and its roll in degrees, which cameras lack."""
    node = seen.node
    axes = seen.T[:3, :3] @ view_axes(node, problems)
    axes = axes / np.linalg.norm(axes, axis=0)
    at = get(node, "position", "SFVec3f", np.array([0.0, 0.0, 10.0]), problems)
    at = seen.T[:3, :3] @ at + seen.T[:3, 3]
    center = get(node, "centerOfRotation", "SFVec3f", np.zeros(3), problems)
    center = seen.T[:3, :3] @ center + seen.T[:3, 3]
    forward = -axes[:, 2]
    distance = float((center - at) @ forward)
    looks_at = at + forward * (distance if distance > 0.05 else _CAMERA_DISTANCE)
    right, roll = np.cross(forward, [0.0, 0.0, 1.0]), 0.0
    if np.linalg.norm(right) > 1e-6:
        roll = np.arccos(np.clip(axes[:, 0] @ right / np.linalg.norm(right), -1.0, 1.0))
    angle = get(node, "fieldOfView", "SFFloat", np.pi / 4, problems)
    fovy_deg = float(np.rad2deg(angle).round(9))
    table = {"position": rounded(at), "look_at": rounded(looks_at), "fovy_deg": fovy_deg}
    return table, float(np.rad2deg(roll)) if roll > _MIN_ROLL else 0.0


def light_table(seen: VisitedNode, problems: Problems) -> dict[str, Any] | None:
    """Converts a DirectionalLight or SpotLight to a table, or returns None if it is off."""
    node = seen.node
    if not get(node, "on", "SFBool", True, problems):
        return None
    down = get(node, "direction", "SFVec3f", np.array([0.0, 0.0, -1.0]), problems)
    down = seen.T[:3, :3] @ down
    if not np.any(down):
        problems.add(f"{node.label}.direction", "found 0 0 0; expected a direction", node.line)
        return None
    color = get(node, "color", "SFColor", np.ones(3), problems)
    color = color * get(node, "intensity", "SFFloat", 1.0, problems) * LIGHT_SHARE
    is_spot = node.kind == "SpotLight"
    at = -_LIGHT_DISTANCE * down / np.linalg.norm(down)
    if is_spot:
        at = get(node, "location", "SFVec3f", np.zeros(3), problems)
        at = seen.T[:3, :3] @ at + seen.T[:3, 3]
    table: dict[str, Any] = {"position": rounded(at), "direction": rounded(down)}
    table["diffuse"] = rounded(np.clip(color, 0.0, 1.0))
    return {**table, "directional": False} if is_spot else table


def rounded(values: Array) -> list[Any]:
    """Rounds numbers to 12 decimals, and returns them as nested lists for files."""
    numbers: list[Any] = (np.asarray(values, np.float64).round(12) + 0.0).tolist()
    return numbers
