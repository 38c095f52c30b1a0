"""Writes the bodies of a scene and their motion as a glTF animation."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ...base.errors import UsageError
from ...base.frames import Array
from ...cli.export import CAPTURE_OPTIONS, capture_run, report_size
from ...viewer.decor.arrow_shapes import BANDS, RATIOS, STRIPE_RGB, nearest_ratio, shapes
from ...viewer.decor.round_arrows import (
    NEGATIVE_RGBA,
    POSITIVE_RGBA,
    TURNING_SPEED,
    drawn_widths,
)
from ...viewer.player.capture import CapturedRun
from ...viewer.player.model import field_corners, geom_colors, mesh_corners

if TYPE_CHECKING:
    from ...cli.export import ExportOptions

_FLOAT, _UINT = 5126, 5125  # component types of glTF
_METALLIC, _ROUGHNESS = 0.1, 0.5  # default properties of materials
_GAMMA = 2.2  # exponent that converts displayed colors to linear colors of glTF
_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # rotation from z up to y up
_SECTIONS = 24  # number of sides of a cylinder
_SHOWN, _HIDDEN = 1.0, 1e-6  # scale factors of bodies, because glTF has no visibility flag


def write_animation(options: ExportOptions) -> int:
    """Runs `sero-mj export` for .glb files, and returns exit code 0."""
    options.accept(*CAPTURE_OPTIONS)
    _, captured = capture_run(options)
    write_glb(captured, options.path)
    return report_size(options)


class _Blob:
    def __init__(self, gltf: Any) -> None:
        self.gltf, self.data = gltf, bytearray()

    def put(self, array: np.ndarray, component: int, kind: str, *, bounds: bool = False) -> int:
        import pygltflib

        self.data += bytes(-len(self.data) % 4)
        gltf, raw = self.gltf, array.tobytes()
        view = pygltflib.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(raw))
        gltf.bufferViews.append(view)
        self.data += raw
        accessor = pygltflib.Accessor(
            bufferView=len(gltf.bufferViews) - 1, componentType=component, count=len(array),
            type=kind,
        )  # fmt: skip
        if bounds:
            accessor.min = np.atleast_1d(array.min(axis=0)).tolist()
            accessor.max = np.atleast_1d(array.max(axis=0)).tolist()
        gltf.accessors.append(accessor)
        return len(gltf.accessors) - 1


def write_glb(captured: CapturedRun, path: Path) -> None:
    """Writes the bodies of a captured run, their motion and round arrows to a .glb file.

    Raises:
        UsageError: pygltflib is not installed, or the file cannot be written.
    """
    try:
        import pygltflib
    except ModuleNotFoundError:
        raise UsageError("glTF needs pygltflib: pip install 'sero-mj[gltf]'") from None

    model, colours = captured.world.model, geom_colors(captured.world.model)
    gltf = pygltflib.GLTF2(scene=0)
    blob = _Blob(gltf)
    meshes: dict[Any, int] = {}  # maps properties of geoms to meshes
    equal: dict[bytes, int] = {}  # maps digests of shapes and materials to meshes
    bodies: list[list[int]] = [[] for _ in captured.bodies]
    for i in captured.geoms.tolist():
        key = (int(model.geom_dataid[i]), model.geom_size[i].tobytes(), int(model.geom_type[i]),
               colours[i].tobytes(), int(model.geom_matid[i]))  # fmt: skip
        if key not in meshes:
            look = np.append(colours[i], _metal(model, i))
            meshes[key] = _mesh(blob, _corners(model, i), look, equal)
        if meshes[key] < 0:
            continue
        w, x, y, z = model.geom_quat[i].tolist()
        gltf.nodes.append(
            pygltflib.Node(
                mesh=meshes[key], translation=model.geom_pos[i].tolist(), rotation=[x, y, z, w]
            )
        )
        at = int(np.searchsorted(captured.bodies, model.geom_bodyid[i]))
        bodies[at].append(len(gltf.nodes) - 1)
    animation = pygltflib.Animation(name="run")
    times = (np.arange(captured.frames) / captured.fps).astype(np.float32)
    clock = blob.put(times, _FLOAT, "SCALAR", bounds=True) if captured.frames > 1 else -1
    nodes = {
        b: _add_body(captured, blob, animation, clock, b, children)
        for b, children in enumerate(bodies)
        if children
    }
    if captured.world.has_sites:
        _add_arrows(captured, blob, animation, clock, nodes)
    roots = list(nodes.values())
    gltf.nodes.append(pygltflib.Node(name="world", rotation=_UP, children=roots))
    gltf.scenes.append(pygltflib.Scene(nodes=[len(gltf.nodes) - 1]))
    if animation.channels:
        gltf.animations.append(animation)
    gltf.buffers.append(pygltflib.Buffer(byteLength=len(blob.data)))
    gltf.set_binary_blob(bytes(blob.data))
    try:
        gltf.save_binary(str(path))
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _add_body(
    captured: CapturedRun, blob: _Blob, animation: Any, clock: int, body: int, children: list[int]
) -> int:
    import pygltflib

    positions = captured.positions[:, body].astype(np.float32)
    rotations = captured.rotations[:, body][:, [1, 2, 3, 0]].astype(np.float32)
    visible = captured.opacity[:, body] > 0.0
    gltf, number = blob.gltf, len(blob.gltf.nodes)
    name = captured.world.model.body(int(captured.bodies[body])).name
    gltf.nodes.append(
        pygltflib.Node(
            name=name, translation=positions[0].tolist(), rotation=rotations[0].tolist(),
            children=children, scale=[_SHOWN if visible[0] else _HIDDEN] * 3,
        )
    )  # fmt: skip
    scales = np.where(visible, _SHOWN, _HIDDEN)[:, None].repeat(3, axis=1).astype(np.float32)
    moving = {"translation": positions, "rotation": rotations, "scale": scales}
    _animate(blob, animation, clock, number, moving)
    return number


def _animate(
    blob: _Blob, animation: Any, clock: int, node: int, moving: dict[str, np.ndarray]
) -> None:
    import pygltflib

    for path, values in moving.items():
        if clock < 0 or np.ptp(values, axis=0).max() < 1e-6:
            continue
        way = "STEP" if path == "scale" else "LINEAR"
        kind = f"VEC{values.shape[1]}"
        animation.samplers.append(
            pygltflib.AnimationSampler(
                input=clock, output=blob.put(values, _FLOAT, kind), interpolation=way
            )
        )
        target = pygltflib.AnimationChannelTarget(node=node, path=path)
        channel = pygltflib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        animation.channels.append(channel)


def _add_arrows(
    captured: CapturedRun, blob: _Blob, animation: Any, clock: int, nodes: dict[int, int]
) -> None:
    """Adds the round arrows of joints to the nodes of their bodies, one for each direction."""
    joints, model = captured.world.joints, captured.world.model
    widths = np.array([drawn_widths(joints, each, captured.limit) for each in captured.arrows])
    angles = captured.values.get("joint_angles", np.zeros_like(widths))
    times = captured.begin + np.arange(captured.frames) / captured.fps
    for j in np.flatnonzero(captured.toggles.arrows & joints.revolute).tolist():
        site, values = int(joints.centre_site[j]), captured.arrows[:, j]
        body = int(np.searchsorted(captured.bodies, model.site_bodyid[site]))
        for sign, (*rgb, _) in ((1.0, POSITIVE_RGBA), (-1.0, NEGATIVE_RGBA)):
            shown = (widths[:, j] > 0.0) & (np.sign(values) == sign)
            if not shown.any() or body not in nodes:
                continue
            radius = joints.arrow_radius[j]
            ratio = int(nearest_ratio(np.median(widths[shown, j]) / radius))
            size = np.full((captured.frames, 3), radius)
            size[:, 2] = widths[:, j] / RATIOS[ratio]
            turns = _turns(model.site_quat[site], TURNING_SPEED * times - sign * angles[:, j], sign)
            over = shown & (np.abs(values) > captured.limit[j])
            for shape, colour, visible in ((ratio, rgb, shown), (BANDS + ratio, STRIPE_RGB, over)):
                if visible.any():
                    look = np.array([*colour, joints.arrow_alpha[j], _METALLIC, _ROUGHNESS])
                    scales = np.where(visible[:, None], size, _HIDDEN).astype(np.float32)
                    node = _arrow_node(blob, shape, look, model.site_pos[site], turns[0], scales[0])
                    blob.gltf.nodes[nodes[body]].children.append(node)
                    moving = {"rotation": turns, "scale": scales}
                    _animate(blob, animation, clock, node, moving)


def _arrow_node(
    blob: _Blob, shape: int, look: Array, place: Array, turn: np.ndarray, scale: np.ndarray
) -> int:
    import pygltflib
    import trimesh

    vertices, faces = shapes()[shape]
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    mesh = _add_mesh(blob, (vertices, np.asarray(normals), faces.ravel()), look)
    blob.gltf.nodes.append(
        pygltflib.Node(
            mesh=mesh, translation=place.tolist(), rotation=turn.tolist(), scale=scale.tolist()
        )
    )
    return len(blob.gltf.nodes) - 1


def _turns(own: Array, phases: Array, sign: float) -> np.ndarray:
    """Returns quaternions (x, y, z, w), shape (F, 4), of an arrow in the frame of its body."""
    found = np.zeros((len(phases), 4))
    flipped = own.copy()
    if sign < 0:
        mujoco.mju_mulQuat(flipped, own, np.array([0.0, 1.0, 0.0, 0.0]))  # about x
    for quat, phase in zip(found, phases, strict=True):
        turn = np.array([np.cos(phase / 2), 0.0, 0.0, np.sin(phase / 2)])
        mujoco.mju_mulQuat(quat, flipped, turn)
    return found[:, [1, 2, 3, 0]].astype(np.float32)


def _metal(model: mujoco.MjModel, geom: int) -> tuple[float, float]:
    material = int(model.geom_matid[geom])
    if material < 0:
        return _METALLIC, _ROUGHNESS
    metallic, roughness = model.mat_metallic[material], model.mat_roughness[material]
    return (
        float(metallic) if metallic >= 0 else _METALLIC,
        float(roughness) if roughness >= 0 else _ROUGHNESS,
    )


def _mesh(
    blob: _Blob, corners: tuple[Array, Array, Any] | None, look: Array, known: dict[bytes, int]
) -> int:
    if corners is None:
        return -1
    parts = [*corners, look]
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
    key = digest.digest()
    if key not in known:
        known[key] = _add_mesh(blob, corners, look)
    return known[key]


def _add_mesh(blob: _Blob, corners: tuple[Array, Array, Any], look: Array) -> int:
    import pygltflib

    points, normals, index = corners
    *rgb, opacity, metallic, roughness = map(float, look)
    gltf = blob.gltf
    gltf.materials.append(
        pygltflib.Material(
            pbrMetallicRoughness=pygltflib.PbrMetallicRoughness(
                baseColorFactor=[*(each**_GAMMA for each in rgb), opacity],
                metallicFactor=metallic,
                roughnessFactor=roughness,
            ),
            alphaMode="BLEND" if opacity < 1 else "OPAQUE",
        )
    )
    primitive = pygltflib.Primitive(
        attributes=pygltflib.Attributes(
            POSITION=blob.put(points.astype(np.float32), _FLOAT, "VEC3", bounds=True),
            NORMAL=blob.put(normals.astype(np.float32), _FLOAT, "VEC3"),
        ),
        indices=blob.put(np.asarray(index, np.uint32), _UINT, "SCALAR"),
        material=len(gltf.materials) - 1,
    )
    gltf.meshes.append(pygltflib.Mesh(primitives=[primitive]))
    return len(gltf.meshes) - 1


def _corners(model: mujoco.MjModel, geom: int) -> tuple[Array, Array, Any] | None:
    import trimesh

    kind, (a, b, c) = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    data = int(model.geom_dataid[geom])
    if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        points, normals, index, _ = mesh_corners(model, data)
        lengths = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return points, normals / lengths, index
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return field_corners(model, data)[:3]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shape = trimesh.creation.icosphere(radius=a)
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        shape = trimesh.creation.icosphere()
        shape.apply_scale((a, b, c))
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shape = trimesh.creation.capsule(height=2 * b, radius=a)
        shape.apply_translation((0, 0, -shape.bounds.mean(axis=0)[2]))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(radius=a, height=2 * b, sections=_SECTIONS)
        shape.unmerge_vertices()
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = trimesh.creation.box(extents=(2 * a, 2 * b, 2 * c))
        shape.unmerge_vertices()
    else:
        return None
    return np.array(shape.vertices), np.array(shape.vertex_normals), shape.faces.ravel()
