"""Copies the geoms of a robot in MJCF from the compiled model of its file to the spec of a scene.

Vertices, normals and texture coordinates of meshes, textures of materials, and masks and contact
parameters of collision geoms are copied without changes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base.errors import mismatch
from ...base.frames import MIRROR, Array, Ints, frame, inverse, rotation_from_quat
from ..declared.robot import SerialRobot
from ..importers.mjcf_model import MjcfTree
from .mjcf_elements import MESH, pose

TOUCHING = "touching-"  # prefix of names of collision geoms
_CONVEX, _SHELL = (
    mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
)
_SHOWN_GROUPS = 3  # MuJoCo shows the groups 0 to 2
_HFIELD, _SDF = int(mujoco.mjtGeom.mjGEOM_HFIELD), int(mujoco.mjtGeom.mjGEOM_SDF)
_CONTACT = (
    "contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp",
    "margin", "gap",
)  # fmt: skip
_MATERIAL = ("rgba", "emission", "specular", "shininess", "reflectance", "metallic", "roughness")


def mjcf_tree(robot: SerialRobot) -> MjcfTree:
    """Reads the MJCF model of a robot.

    Raises DeclarationError if the model cannot be read or has a different number of joints.
    """
    from ..importers.mjcf_robot import cached_tree  # Few robots need this import.

    tree = cached_tree(robot.mjcf, Path(robot.directory))
    if len(tree.joints) != robot.n:
        expected = f"{robot.n}, as in the robot declaration"
        raise mismatch(len(tree.joints), expected, key="mjcf", of="joints in the model")
    return tree


def drawn_links(
    root: mujoco.MjSpec, robot: SerialRobot, scope: str = "", shrink: float = 1.0
) -> list[list[dict[str, Any]]]:
    """Returns the attributes of the visible geoms of the base and of each link, in link frames.

    Meshes and materials are added to `root` with names that begin with `scope`. Sizes are
    multiplied by `shrink`, about the origin of each link.
    """
    tree = mjcf_tree(robot)
    model, geoms = tree.model, tree.geoms
    visible = geoms[(model.geom_group[geoms] < _SHOWN_GROUPS) & (model.geom_rgba[geoms, 3] > 0)]
    links: list[list[dict[str, Any]]] = [[] for _ in tree.poses]
    # If a link has non-colliding geoms, colliding geoms in other groups are its collision shapes.
    links_of = tree.links[model.geom_bodyid[visible]]
    is_look = (model.geom_contype | model.geom_conaffinity)[visible] == 0
    replaced = np.isin(links_of, links_of[is_look])
    replaced &= ~np.isin(model.geom_group[visible], model.geom_group[visible[is_look]])
    visible = visible[~replaced]
    if model.nskin or not len(visible):  # Geoms may be under a skin, or be collision geoms only.
        bare = np.setdiff1d(np.arange(len(tree.poses)), tree.links[model.geom_bodyid[visible]])
        hidden = np.isin(tree.links[model.geom_bodyid[geoms]], bare)
        visible = np.union1d(visible, geoms[hidden])
    for geom in visible.tolist():
        look: dict[str, Any] = {"rgba": model.geom_rgba[geom]}
        material = int(model.geom_matid[geom])
        if material >= 0:
            look["material"] = _material(root, model, material, scope)
        _add(links, root, robot, tree, geom, look, scope, shrink)
    return links


def touching_links(root: mujoco.MjSpec, robot: SerialRobot) -> list[list[dict[str, Any]]]:
    """Returns the attributes of the collision geoms of each link, with contact parameters."""
    tree = mjcf_tree(robot)
    model, geoms = tree.model, tree.geoms
    touches = (model.geom_contype | model.geom_conaffinity)[geoms] > 0
    links: list[list[dict[str, Any]]] = [[] for _ in tree.poses]
    for geom in geoms[touches].tolist():
        contact = {key: getattr(model, f"geom_{key}")[geom] for key in _CONTACT}
        _add(links, root, robot, tree, geom, contact, TOUCHING, 1.0)
    return links


def excluded_links(robot: SerialRobot) -> list[tuple[int, int]]:
    """Returns index pairs of links whose collisions the MJCF file excludes, 0 for the base."""
    tree = mjcf_tree(robot)
    pairs = []
    for signature in tree.model.exclude_signature.tolist():
        one, other = int(tree.links[signature >> 16]), int(tree.links[signature & 0xFFFF])
        if one >= 0 and other >= 0 and one != other:
            pairs.append((one, other))
    return pairs


def _add(
    links: list[list[dict[str, Any]]],
    root: mujoco.MjSpec,
    robot: SerialRobot,
    tree: MjcfTree,
    geom: int,
    attributes: dict[str, Any],
    scope: str,
    shrink: float,
) -> None:
    model = tree.model
    kind, link = int(model.geom_type[geom]), int(tree.links[model.geom_bodyid[geom]])
    if kind in (_HFIELD, _SDF):
        return
    body = int(model.geom_bodyid[geom])
    shape: dict[str, Any] = {"type": kind, "size": model.geom_size[geom] * shrink}
    if kind == int(MESH):
        mesh = int(model.geom_dataid[geom])
        shape = {"type": MESH, "meshname": _mesh(root, robot, model, mesh, scope, shrink)}
    T = (
        inverse(tree.poses[link])
        @ tree.bodies[body]
        @ frame(rotation_from_quat(model.geom_quat[geom]), model.geom_pos[geom])
    )
    if robot.mirrored:
        T = MIRROR @ T @ MIRROR
    T[:3, 3] *= shrink
    links[link].append({**shape, **attributes, **pose(T)})


def _rows(values: Array, start: Ints, count: Ints, k: int) -> Array:
    return values[start[k] : start[k] + count[k]]


def _mesh(
    root: mujoco.MjSpec,
    robot: SerialRobot,
    model: mujoco.MjModel,
    mesh: int,
    scope: str,
    shrink: float,
) -> str:
    name = f"{scope}mesh{mesh}"
    if root.mesh(name) is not None:
        return name
    mirror = MIRROR.diagonal()[:3] if robot.mirrored else np.ones(3)
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    vertices = _rows(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum, mesh)
    normals = _rows(model.mesh_normal, model.mesh_normaladr, model.mesh_normalnum, mesh)
    corners = model.mesh_face[faces].ravel()
    normal_of = model.mesh_facenormal[faces].ravel()
    if scope != TOUCHING and (corners != normal_of).any():
        # MuJoCo's compiler ignores `userfacenormal` and uses one normal per vertex. Therefore
        # vertices with several normals, as at the edges of an OBJ, are repeated.
        _, first, parted = np.unique(
            corners.astype(np.int64) * len(normals) + normal_of,
            return_index=True,
            return_inverse=True,
        )
        vertices, normals, corners = vertices[corners[first]], normals[normal_of[first]], parted
    arrays: dict[str, Any] = {
        "uservert": vertices.ravel(),
        "usernormal": normals.ravel(),
        "userface": corners,
    }
    if model.mesh_texcoordadr[mesh] >= 0:
        coordinates = _rows(
            model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_texcoordnum, mesh
        )
        arrays |= {
            "usertexcoord": coordinates.ravel(),
            "userfacetexcoord": model.mesh_facetexcoord[faces].ravel(),
        }
    root.add_mesh(
        name=name,
        scale=shrink * mirror,
        # Visual geometry may be flat, and has no hull.
        inertia=_CONVEX if scope == TOUCHING else _SHELL,
        **arrays,
    )
    return name


def _material(root: mujoco.MjSpec, model: mujoco.MjModel, material: int, scope: str) -> str:
    name = f"{scope}material{material}"
    if root.material(name) is not None:
        return name
    values = {key: getattr(model, f"mat_{key}")[material] for key in _MATERIAL}
    added = root.add_material(
        name=name,
        texrepeat=model.mat_texrepeat[material],
        texuniform=bool(model.mat_texuniform[material]),
        **values,
    )
    textures = list(added.textures)
    for role, texture in enumerate(model.mat_texid[material].tolist()):
        if texture >= 0:
            textures[role] = _texture(root, model, texture, scope)
    added.textures = textures
    return name


def _texture(root: mujoco.MjSpec, model: mujoco.MjModel, texture: int, scope: str) -> str:
    name = f"{scope}texture{texture}"
    if root.texture(name) is None:
        width, height = int(model.tex_width[texture]), int(model.tex_height[texture])
        channels, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
        added = root.add_texture(
            name=name,
            type=int(model.tex_type[texture]),
            width=width,
            height=height,
            nchannel=channels,
            colorspace=int(model.tex_colorspace[texture]),
        )
        added.data = model.tex_data[start : start + width * height * channels].tobytes()
    return name
