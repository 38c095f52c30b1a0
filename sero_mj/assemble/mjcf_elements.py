"""Elements of MJCF for `MjSpec`: pieces that users have, mesh files, poses, generated shapes."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..describe.mesh_files import Rgba, read_mesh
from ..errors import DeclarationError, Problem
from ..frames import Array
from ..paths import open_file, read_file
from .shapes import LinkShape

_MOST_BYTES = 100_000_000  # of a file of MJCF
MOST_ASSET_BYTES = 500_000_000  # of a mesh (ten million triangles) or a texture
MESH = mujoco.mjtGeom.mjGEOM_MESH
_CONVEX = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
SITE_GROUP = 5  # frames are drawn by decor; MuJoCo shows groups 0 to 2


def as_spec(source: Any, folder: Path) -> mujoco.MjSpec:
    """Reads a piece of MJCF and the files it refers to, which are stored in the spec.

    Args:
        source: a file name; text that starts with `<`; or an object that `is_mjcf_object`
            accepts, which is not changed.
        folder: base folder of relative file names.

    Raises:
        DeclarationError: it cannot be read.
    """
    try:
        spec = _read(source, folder)
        _keep_files(spec)
    except OSError as error:
        reason = f"{error.filename or source}: {error.strerror or error}"
        raise DeclarationError([Problem("mjcf", f"cannot be read: {reason}")]) from error
    except (ValueError, TypeError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DeclarationError([Problem("mjcf", f"cannot be read: {reason}")]) from error
    for k, body in enumerate(spec.bodies[1:]):
        if not body.name:
            body.name = f"body{k + 1}"  # contacts are excluded by name
    return spec


def is_mjcf_object(source: Any) -> bool:
    """Whether an object contains MJCF: an `MjSpec`, PyMJCF's `RootElement`, a composer entity."""
    root = _root_element(source)
    return isinstance(source, mujoco.MjSpec) or (
        hasattr(root, "to_xml_string") and hasattr(root, "get_assets")
    )


def _root_element(source: Any) -> Any:
    """Returns the PyMJCF root element of a composer entity; anything else as it is."""
    return getattr(source, "mjcf_model", source)


def _read(source: Any, folder: Path) -> mujoco.MjSpec:
    if isinstance(source, mujoco.MjSpec):
        return source.copy()
    if not isinstance(source, str):
        root = _root_element(source)
        return mujoco.MjSpec.from_string(root.to_xml_string(), assets=root.get_assets())
    if not source.lstrip().startswith("<"):
        open_file(folder / source, _MOST_BYTES).close()  # MuJoCo would read a pipe forever
        return mujoco.MjSpec.from_file(str(folder / source))
    spec = mujoco.MjSpec.from_string(source, include=_included(source, folder))
    spec.modelfiledir = str(folder)
    return spec


def _included(text: str, folder: Path) -> Mapping[str, bytes]:
    """Returns the contents of the files that a text includes, recursively, by name."""
    found: dict[str, bytes] = {}
    waiting = [text.encode()]
    while waiting:
        try:
            names = {
                tag.get("file", "") for tag in ElementTree.fromstring(waiting.pop()).iter("include")
            }
        except ElementTree.ParseError:
            continue  # MuJoCo reports the position
        for name in names - set(found):
            found[name] = read_file(folder / name, _MOST_BYTES)
            waiting.append(found[name])
    return found


def _keep_files(spec: mujoco.MjSpec) -> None:
    """Reads the files of meshes, height fields, skins and textures into the spec's assets."""
    for folder, elements in (
        (spec.meshdir, [*spec.meshes, *spec.skins]),
        (spec.texturedir, [*spec.textures]),
        (spec.meshdir, [*spec.hfields]),
    ):
        for element in elements:
            element.file = _kept(spec, folder, element.file)
    for texture in spec.textures:
        texture.cubefiles = [_kept(spec, spec.texturedir, file) for file in texture.cubefiles]
    spec.meshdir = spec.texturedir = ""


def _kept(spec: mujoco.MjSpec, folder: str, file: str) -> str:
    """Stores a file that an element refers to and returns its name in the assets."""
    if not file or file in spec.assets:
        return file
    name = Path(file).name if spec.strippath else file
    path = Path(spec.modelfiledir) / folder / name
    return add_file(spec, path, read_file(path, MOST_ASSET_BYTES))


def add_file(spec: mujoco.MjSpec, path: Path, contents: bytes) -> str:
    """Stores a file's contents in the assets of a spec and returns its name there.

    The name is unique across folders, so that specs can be attached to each other.
    """
    file = f"{path.stem}-{sha256(contents).hexdigest()[:16]}{path.suffix.lower()}"
    spec.assets[file] = contents
    return file


def pose(T: Array) -> dict[str, Array]:
    """Returns `pos` and `quat` of an element for a frame (4, 4)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    return {"pos": T[:3, 3], "quat": quat}


def mesh_assets(
    spec: mujoco.MjSpec, name: str, path: Path, scale: ArrayLike, *, solid: bool
) -> list[tuple[str, Rgba | None]]:
    """Adds a mesh file to the assets.

    Args:
        spec: gets it; meshes of these names that it has are used again.
        name: of the mesh.
        path: of the file, in any format that `read_mesh` takes.
        scale: m per unit, one number or along x, y and z; negative ones mirror it.
        solid: whether it has to have a volume, as it touches or has a mass.

    Returns:
        name and colour of a mesh for each colour in the file; None where the file has none.

    Raises:
        DeclarationError: the file cannot be read.
    """
    meshes = []
    for k, piece in enumerate(read_mesh(path)):
        meshes.append((f"{name}_{k}" if k else name, piece.rgba))
        if spec.mesh(meshes[-1][0]) is None:
            spec.add_mesh(
                name=meshes[-1][0],
                file=add_file(spec, path.with_suffix(piece.ending), piece.contents),
                scale=np.broadcast_to(scale, 3),
                # By the convex hull, so that a mesh with holes has a mass; a flat one has no hull.
                inertia=_CONVEX if solid or not piece.is_flat else _SHELL,
            )
    return meshes


def hull_asset(spec: mujoco.MjSpec, name: str, corners: Array) -> str:
    """Adds a mesh of vertices (k, 3), m, to the assets and returns its name."""
    spec.add_mesh(name=name, uservert=corners.ravel(), inertia=_CONVEX)
    return name


# Declared sizes are full lengths, MuJoCo's are half lengths; radii are the same.
_HALF: dict[str, Any] = {"box": 0.5, "cylinder": np.array([1, 0.5]), "capsule": np.array([1, 0.5])}


def half_sizes(kind: str, size: Array) -> Array:
    """Returns MuJoCo's `size` of a shape that is declared with this one, m."""
    return np.asarray(size * _HALF.get(kind, 1.0))


def geom_type(kind: str) -> Any:
    """Returns MuJoCo's constant for `box`, `sphere`, ..."""
    return getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")


def shape_geom(shape: LinkShape, scale: float = 1.0) -> dict[str, Any]:
    """Returns the attributes of a geom for a generated shape, scaled about its centre."""
    middle = shape.ends.mean(axis=0)
    look = {"type": geom_type(shape.kind), "size": np.atleast_1d(shape.size * scale)}
    if shape.kind == "box":
        return {**look, "pos": middle, "zaxis": shape.ends[1] - shape.ends[0]}
    ends = shape.ends if scale == 1.0 else middle + scale * (shape.ends - middle)
    return {**look, "fromto": ends.ravel()}
