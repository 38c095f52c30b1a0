"""Reads mesh files, splits them by color, and converts the pieces to formats that MuJoCo reads.

STL and OBJ files are not converted if MuJoCo accepts them. pycollada reads COLLADA, extensions read
their own formats, and trimesh reads all other formats. This module checks OBJ files itself, because
trimesh takes 0.3 s to import, is four times slower, and assigns no material to faces before the
first `usemtl`.

The up axis of a file is ignored, because RViz and Gazebo ignore it and most exporters do not write
the true axis. A textured material gets the mean color of its image.

Transparency follows the specification of each format: `d` and `Tr` of OBJ materials
(`Tr` = 1 - `d`), alpha in PLY, OFF, 3MF and VRML, and alphaMode of glTF materials. Some exporters
write the opposite of what COLLADA specifies, so transparency of COLLADA files is logged. Invisible
materials of OBJ and COLLADA become opaque.
"""

from __future__ import annotations

import codecs
import io
import logging
import re
import struct
import threading
import warnings
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from ...base.declaration import LARGEST
from ...base.errors import DeclarationError, Problem, located, reason_of
from ...base.frames import Array, Ints
from ...base.paths import read_file
from ...base.plugins import MESHES, load_plugin, plugins

_BY_MUJOCO = (".stl", ".obj", ".msh")  # extensions of formats that MuJoCo reads
_CONVERTED = (".dae", ".ply", ".off", ".glb", ".gltf", ".3mf")
MAX_MESH_BYTES = 500_000_000  # maximum size of a file that MuJoCo reads (ten million triangles)
# Maximum size of other files, because conversion takes up to 30 times this amount of memory.
MAX_CONVERTED_BYTES = 100_000_000
_MAX_STL_FACES = 200_000  # MuJoCo's limit for STL files
_MAX_IMAGE_BYTES = 50_000_000  # maximum size of a texture file
_MAX_CACHE_BYTES = 150_000_000  # maximum size of cached meshes, including vertices
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
_FLATNESS = 1e-5  # ratio of thickness to length below which a mesh is flat
_INVISIBLE = 0.01  # opacity below which a material is invisible
_CUTOFF = 0.5  # default of alphaCutoff in glTF
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

log = logging.getLogger(__name__)

Rgba = tuple[float, float, float, float]


def mesh_endings() -> tuple[str, ...]:
    """Returns the extensions of all supported mesh files, including the dots.

    A package adds a format with an entry point in the group `sero_mj.meshes`, whose name is the
    extension without the dot. It refers to a function that reads a path and returns a list with one
    tuple per color: vertices (v, 3), triangles (f, 3), and RGBA (4,) or None.
    """
    return (*_BY_MUJOCO, *_CONVERTED, *(f".{name}" for name in plugins(MESHES)))


@dataclass(frozen=True, eq=False)
class MeshPiece:
    """The triangles of a mesh that have the same color, as the contents of a file for MuJoCo."""

    contents: bytes
    ending: str
    rgba: Rgba | None = None

    @cached_property
    def points(self) -> Array:
        """Vertices in the unit of the file, shape (k, 3), with possible repetitions."""
        if self.ending == ".stl":
            corners = np.frombuffer(self.contents, _FACET, offset=84)["corners"]
            return np.asarray(corners.reshape(-1, 3), np.float64)
        if self.ending == ".obj":
            return _points_of_obj(self.contents)
        count = int.from_bytes(self.contents[:4], "little")
        return np.frombuffer(self.contents, "<f4", 3 * count, 16).reshape(-1, 3).astype(np.float64)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the contents as hexadecimal digits."""
        return sha256(self.contents).hexdigest()

    @cached_property
    def is_flat(self) -> bool:
        """Whether the vertices are coplanar, so that they have no convex hull."""
        away = self.points - self.points.mean(axis=0)
        moments = np.linalg.eigvalsh(away.T @ away)
        return bool(moments[0] < _FLATNESS**2 * moments[2])


def _points_of_obj(contents: bytes) -> Array:
    lines = re.findall(rb"\nv[ \t]([^\n]*)", contents)
    # Parsing is fast if all vertices have 3 numbers, or 6 with a color. It stops at other text.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        values = np.fromstring(b" ".join(lines), sep=" ")
    for count in (3, 6):
        if len(values) == count * len(lines) > 0:
            return values.reshape(-1, count)[:, :3]
    found = np.array(_VERTEX.findall(contents), np.bytes_)
    return found.reshape(-1, 3).astype(np.float64)


_Key = tuple[str, int, int, int]  # path, inode, modification time in ns, size
_cache: OrderedDict[_Key, tuple[MeshPiece, ...]] = OrderedDict()
_lock = threading.Lock()


def read_mesh(path: Path) -> tuple[MeshPiece, ...]:
    """Reads a mesh file as pieces of one color each, and caches them until the file changes.

    Lengths are converted to m only if the file declares a unit.

    Raises:
        DeclarationError: the file is missing or too large, has an unknown format, or contains no
            triangles that can be drawn.
    """
    ending = path.suffix.lower()
    if ending not in (known := mesh_endings()):
        raise _wrong(path, f"found '{path.suffix}'; expected {', '.join(known)}")
    passed = ending in _BY_MUJOCO
    try:
        status = path.stat()
        key = (str(path.absolute()), status.st_ino, status.st_mtime_ns, status.st_size)
        with _lock:
            if key in _cache:
                _cache.move_to_end(key)
                return _cache[key]
        contents = read_file(path, MAX_MESH_BYTES if passed else MAX_CONVERTED_BYTES)
    except (OSError, ValueError) as error:
        raise _wrong(path, reason_of(error)) from error
    if passed and (pieces := _as_it_is(path, ending, contents)) is not None:
        _store(key, pieces)
        return pieces
    if len(contents) > MAX_CONVERTED_BYTES:
        limit = f"{MAX_CONVERTED_BYTES / 1e6:g} MB"
        found = f"{len(contents) / 1e6:.1f} MB of {ending[1:].upper()} that MuJoCo cannot read"
        raise _wrong(path, f"found {found} without conversion; expected at most {limit}")
    pieces = _converted(path, ending, contents)
    _store(key, pieces)
    return pieces


def _store(key: _Key, pieces: tuple[MeshPiece, ...]) -> None:
    with _lock:
        _cache[key] = pieces
        sizes = [sum(len(p.contents) + p.points.nbytes for p in each) for each in _cache.values()]
        while sum(sizes) > _MAX_CACHE_BYTES:
            _cache.popitem(last=False)
            sizes.pop(0)


def _wrong(path: Path, reason: str) -> DeclarationError:
    return Problem("", located(f"mesh {path}", reason)).error()


def _as_it_is(path: Path, ending: str, contents: bytes) -> tuple[MeshPiece, ...] | None:
    if ending == ".obj":
        return _obj_as_it_is(path, contents)
    piece = MeshPiece(contents, ending)
    if ending == ".msh":
        vertices, normals, texture, faces = struct.unpack("<4i", contents[:16].ljust(16, b"\0"))
        size = 16 + 12 * vertices + 12 * normals + 8 * texture + 12 * faces
        if len(contents) != size or min(vertices, normals, texture, faces) < 0:
            raise _wrong(path, "does not have the size that its header requires")
        corners = np.frombuffer(contents, "<i4", 3 * faces, size - 12 * faces)
        _check_faces(path, corners, vertices)
    else:
        count = int.from_bytes(contents[80:84], "little")
        if _is_binary(contents) and len(contents) < 84 + 50 * count:
            found = max(len(contents) - 84, 0) // 50
            raise _wrong(path, f"is truncated: found {found} of {count} triangles")
        if len(contents) != 84 + 50 * count or not 1 <= count <= _MAX_STL_FACES:
            return None  # The file is ASCII text or has too many faces.
    _check(path, piece.points)
    return (piece,)


def _is_binary(contents: bytes) -> bool:
    """Returns whether an STL file is binary. Binary files may also begin with `solid`."""
    return len(contents) >= 84 and b"\0" in contents[:1000]


def _obj_as_it_is(path: Path, contents: bytes) -> tuple[MeshPiece, ...] | None:
    contents = b"\n" + without_bom(contents)  # The patterns start with a line break.
    colors = _material_colors(path, contents)
    used = list(dict.fromkeys(map(_plain_name, _statements(contents, b"usemtl"))))
    if len({colors.get(name) for name in used}) > 1:
        return None
    piece = MeshPiece(contents, ".obj", colors.get(used[0]) if used else None)
    try:
        points = piece.points
    except ValueError:
        raise _wrong(path, "has a vertex that is not three numbers") from None
    _check(path, points)
    corners = _corners_of_obj(contents, len(points))
    if corners is None:
        return None
    _check_faces(path, corners, len(points))
    return (piece,)


def _statements(contents: bytes, keyword: bytes) -> list[bytes]:
    lines = re.findall(rb"\n(?i:%b)[ \t]+([^\n]+)" % keyword, contents)
    return [line.strip() for line in lines if line.strip()]


def _plain_name(name: bytes) -> bytes:
    return b" ".join(name.split())


def without_bom(text: bytes) -> bytes:
    """Converts text from UTF-16 to UTF-8 if necessary, and removes the byte order mark."""
    if text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return text.decode("utf-16", "replace").encode()
    return text.removeprefix(codecs.BOM_UTF8)


def _corners_of_obj(contents: bytes, count: int) -> Ints | None:
    """Returns the vertex indices of all faces of an OBJ file, or None if they cannot be parsed.

    Negative indices count backward from the last of `count` vertices.
    """
    text = b" ".join(re.findall(rb"\nf[ \t]([^\n]*)", contents))
    # A corner is `vertex/texture/normal`, where texture and normal are optional. In most files, all
    # corners have the same form. Otherwise every corner is parsed separately.
    numbers = _integers(text.replace(b"/", b" "))
    if numbers is None:
        return None
    many = max(len(numbers) - text.count(b"/") + text.count(b"//"), 1)
    found: Ints | None = numbers[:: max(len(numbers) // many, 1)]
    for _ in range(2):
        if found is None:
            return None
        corners = np.where(found < 0, found + count, found - 1)
        if 0 <= corners.min() <= corners.max() < count:
            break
        found = _integers(re.sub(rb"/\S*", b"", text))
    return corners


def _integers(text: bytes) -> Ints | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # issued for text without a number
            numbers = np.fromstring(text, np.int64, sep=" ")
    except (DeprecationWarning, ValueError):
        return None
    return numbers if len(numbers) else None


def _check_faces(path: Path, corners: Any, count: int) -> None:
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        raise _wrong(path, "has faces with nonexistent vertices")


def _check(path: Path, points: Any) -> None:
    if not np.isfinite(points).all():
        raise _wrong(path, "has vertices that are not finite numbers")
    if len(points) and np.abs(points).max() > LARGEST:
        raise _wrong(path, f"has coordinates beyond {LARGEST:g}")
    if len(points) < 3:
        raise _wrong(path, "has no triangles")
    # MuJoCo requires four distinct vertices; only small meshes can have fewer.
    if len(points) < 100 and len(np.unique(points, axis=0)) < 4:
        raise _wrong(path, "has fewer than 4 distinct vertices")


def _material_colors(path: Path, contents: bytes) -> dict[bytes, Rgba]:
    colors: dict[bytes, Rgba] = {}
    for file in _material_files(path, contents):
        try:
            text = b"\n" + without_bom(read_file(file, _MAX_IMAGE_BYTES))
        except (OSError, ValueError):
            continue
        for block in re.split(rb"\n[ \t]*newmtl[ \t]+", text, flags=re.IGNORECASE)[1:]:
            name, _, rest = block.partition(b"\n")
            found = {
                key.lower(): value.strip()
                for key, value in re.findall(rb"^[ \t]*(\w+)[ \t]+([^\r\n]+)", rest, re.MULTILINE)
            }
            color = None
            if b"map_kd" in found:
                color = _mean_color(path.parent / found[b"map_kd"].decode("utf-8", "replace"))
            if color is None:
                color = _rgba(found.get(b"kd", b"").split())
            if color is not None:
                name = _plain_name(name)
                colors[name] = _visible(path, name, color, _opacity_of_obj(found))
    return colors


def _material_files(path: Path, contents: bytes) -> list[Path]:
    folder, files = path.parent, list[Path]()
    for line in _statements(contents, b"mtllib"):
        whole = line.decode("utf-8", "replace").replace("\\", "/")
        for names in ([whole], whole.split()):  # Spaces separate names or are part of a name.
            found = [each for name in names if (each := _existing(folder / name)) is not None]
            if found:
                files += found
                break
    return files


def _existing(path: Path) -> Path | None:
    try:
        if path.exists():
            return path
        return next((p for p in path.parent.iterdir() if p.name.lower() == path.name.lower()), None)
    except (OSError, ValueError):
        return None


def _opacity_of_obj(material: dict[bytes, bytes]) -> float:
    for key, sign, start in ((b"d", 1.0, 0.0), (b"tr", -1.0, 1.0)):
        try:
            return start + sign * float(material[key].split()[-1])
        except (KeyError, ValueError, IndexError):
            continue
    return 1.0


def _visible(path: Path, name: bytes | str, color: Rgba, alpha: float) -> Rgba:
    if not alpha > _INVISIBLE:  # This includes NaN.
        name = name if isinstance(name, str) else name.decode("utf-8", "replace")
        log.warning("mesh %s: material '%s' would be invisible, so it is drawn opaque", path, name)
        return color
    return (*color[:3], round(min(alpha, 1.0), 4))


def _rgba(values: Any, alpha: float = 1.0) -> Rgba | None:
    try:
        numbers = np.array([float(value) for value in values][:3])
    except (TypeError, ValueError):
        return None
    if len(numbers) < 3 or not np.isfinite([*numbers, alpha]).all():
        return None
    red, green, blue, opacity = (
        round(float(value), 4) for value in np.clip([*numbers, alpha], 0, 1)
    )
    return (red, green, blue, opacity)


def _mean_color(image: Any) -> Rgba | None:
    """Returns the mean color of the opaque pixels of an image, with the mean opacity of all."""
    from PIL import Image

    try:
        if isinstance(image, Path):
            image = Image.open(io.BytesIO(read_file(image, _MAX_IMAGE_BYTES)))
        pixels = np.asarray(image.convert("RGBA").resize((16, 16)), np.float64) / 255.0
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    shown = pixels[pixels[..., 3] > 0.5]
    return _rgba(shown[:, :3].mean(axis=0), pixels[..., 3].mean()) if len(shown) else None


def _converted(path: Path, ending: str, contents: bytes) -> tuple[MeshPiece, ...]:
    of_extension = ending[1:] in plugins(MESHES)
    read = _extension_parts if of_extension else _READERS.get(ending, _trimesh_parts)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Libraries warn about their dependencies.
            parts = read(path, ending, contents)
    except DeclarationError:
        raise
    except ImportError as error:
        raise _wrong(path, f"reading {ending} requires the package '{error.name}'") from error
    except RecursionError:
        raise _wrong(path, "is nested too deeply") from None
    except Exception as error:  # Libraries raise any exception for invalid files.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise _wrong(path, f"cannot be read: {reason}") from error
    by_color: dict[Rgba | None, list[_Part]] = {}
    for part in parts:
        by_color.setdefault(part.rgba, []).append(part)
    pieces = []
    for rgba, same in by_color.items():
        joined = _joined(same)
        _check_faces(path, joined.faces.ravel(), len(joined.vertices))
        used = joined.vertices[joined.faces].reshape(-1, 3)
        if len(used):
            _check(path, used)
            pieces.append(MeshPiece(_as_msh(joined), ".msh", rgba))
    if not pieces:
        raise _wrong(path, "has no triangles")
    return tuple(pieces)


@dataclass(frozen=True, eq=False)
class _Part:
    vertices: Array
    normals: Array | None
    faces: Ints
    rgba: Rgba | None


def _joined(parts: list[_Part]) -> _Part:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    normals = [part.normals for part in parts if part.normals is not None]
    return _Part(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(normals) if len(normals) == len(parts) else None,
        np.concatenate(faces),
        parts[0].rgba,
    )


def _as_msh(part: _Part) -> bytes:
    # MuJoCo's binary format: four counts, vertices, normals, texture coordinates and faces.
    used, faces = np.unique(part.faces, return_inverse=True)
    normals = None if part.normals is None else part.normals[used]
    counts = struct.pack("<4i", len(used), 0 if normals is None else len(used), 0, len(part.faces))
    return (
        counts
        + part.vertices[used].astype("<f4").tobytes()
        + (b"" if normals is None else normals.astype("<f4").tobytes())
        + faces.astype("<i4").tobytes()
    )


def _moved(
    vertices: Array, normals: Array | None, faces: Ints, T: Array, rgba: Rgba | None
) -> _Part:
    linear = T[:3, :3]
    if np.linalg.det(linear) < 0:
        faces = faces[:, ::-1]
    if normals is not None:
        normals = normals @ np.linalg.pinv(linear)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = None if (length < 1e-12).any() else normals / length
    return _Part(vertices @ linear.T + T[:3, 3], normals, faces, rgba)


def _collada_parts(path: Path, ending: str, contents: bytes) -> list[_Part]:
    import collada
    from collada.common import DaeBrokenRefError, DaeError

    document = collada.Collada(io.BytesIO(contents), ignore=[DaeError])
    if any(isinstance(error, DaeBrokenRefError) for error in document.errors):
        contents = _without_broken_materials(contents, {m.id for m in document.materials})
        document = collada.Collada(io.BytesIO(contents), ignore=[DaeError])
    if document.scene is None:
        return []
    unit = document.assetInfo.unitmeter
    unit = 1.0 if unit is None else float(unit)
    T_unit = np.diag([unit, unit, unit, 1.0])
    parts = []
    for bound in document.scene.objects("geometry"):
        for primitive in bound.original.primitives:
            # Polygons have `triangleset`, and lines do not.
            has_polygons = hasattr(primitive, "triangleset")
            triangles = primitive.triangleset() if has_polygons else primitive
            corners = np.asarray(getattr(triangles, "vertex_index", None))
            if corners.ndim != 2 or corners.shape[1] != 3 or not len(corners):
                continue
            node = bound.materialnodebysymbol.get(triangles.material)
            rgba = None if node is None else _collada_color(path, node.target)
            parts.append(_moved(*_with_normals(triangles, corners), T_unit @ bound.matrix, rgba))
    return parts


def _without_broken_materials(contents: bytes, known: set[str]) -> bytes:
    """Removes references to unknown materials, because pycollada would omit their geometry, too."""
    from lxml import etree

    from .xml_file import parse_xml

    root = parse_xml(contents)
    for bound in [*root.iter("{*}instance_material")]:
        if bound.get("target", "").removeprefix("#") not in known:
            bound.getparent().remove(bound)
    return bytes(etree.tostring(root))


def _with_normals(primitive: Any, corners: Ints) -> tuple[Array, Array | None, Ints]:
    vertices = np.asarray(primitive.vertex, np.float64)
    if primitive.normal is None or primitive.normal_index is None:
        return vertices, None, corners
    normals = np.asarray(primitive.normal, np.float64)
    pairs = corners.astype(np.int64) * len(normals) + np.asarray(primitive.normal_index)
    different, faces = np.unique(pairs, return_inverse=True)
    at = different // max(len(normals), 1)
    return vertices[at], normals[different % max(len(normals), 1)], faces.reshape(-1, 3)


def _collada_color(path: Path, material: Any) -> Rgba | None:
    diffuse = getattr(getattr(material, "effect", None), "diffuse", None)
    if diffuse is None:
        return None
    if hasattr(diffuse, "sampler"):  # The material has an image.
        file = getattr(diffuse.sampler.surface.image, "path", "") or ""
        color = _mean_color(path.parent / file.removeprefix("file://"))
        return None if color is None else (*color[:3], 1.0)
    color, alpha = _rgba(diffuse), _collada_opacity(material.effect)
    if color is None or alpha >= 1.0:
        return color
    name = material.name or material.id
    if alpha > _INVISIBLE:
        text = "mesh %s: material '%s' has opacity %.3g by COLLADA's definition of transparency; "
        log.warning(text + "some exporters write the opposite", path, name, alpha)
    return _visible(path, name, color, alpha)


def _collada_opacity(effect: Any) -> float:
    """Returns the opacity of an effect, as defined in COLLADA 1.5, "Determining Transparency"."""
    nodes = {key: effect.xmlnode.find(f".//{{*}}{key}") for key in ("transparent", "transparency")}
    if all(node is None for node in nodes.values()) or hasattr(effect.transparent, "sampler"):
        return 1.0
    color = np.ones(4)
    if effect.transparent is not None:
        color[: len(effect.transparent)] = effect.transparent
    factor = 1.0 if nodes["transparency"] is None else float(effect.transparency)
    node = nodes["transparent"]
    mode = "A_ONE" if node is None else node.get("opaque", "A_ONE")
    # The specification defines these weights of CIE 1931 luminance.
    value = color[3] if mode.startswith("A") else color[:3] @ [0.212671, 0.715160, 0.072169]
    opacity = factor * value
    return float(1.0 - opacity if mode.endswith("ZERO") else opacity)


def _extension_parts(path: Path, ending: str, contents: bytes) -> list[_Part]:
    parts = []
    for vertices, faces, color in load_plugin(MESHES, ending[1:])(path):
        rgba: Rgba | None = None
        if color is not None:
            red, green, blue, alpha = (float(value) for value in color)
            rgba = (red, green, blue, alpha)
        parts.append(_Part(vertices, None, faces, rgba))
    return parts


def _trimesh_parts(path: Path, ending: str, contents: bytes) -> list[_Part]:
    import trimesh

    resolver: Any = trimesh.resolvers.FilePathResolver(str(path))
    colors: dict[str, Rgba] = {}
    if ending == ".obj":
        contents, colors = _numbered_materials(path, contents)
        names = "".join(f"newmtl {number}\n" for number in colors)
        resolver = {_MATERIALS: names.encode()}
    scene = trimesh.load_scene(
        io.BytesIO(contents), file_type=ending[1:], resolver=resolver, process=False
    )
    parts = []
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        mesh = scene.geometry[name]
        faces = getattr(mesh, "faces", None)
        if faces is None or not len(faces):
            continue  # The geometry consists of lines or points.
        has_normals = ending in (".obj", ".glb", ".gltf") and "vertex_normals" in mesh._cache
        normals = np.asarray(mesh.vertex_normals, np.float64) if has_normals else None
        vertices = np.asarray(mesh.vertices, np.float64)
        name = getattr(getattr(mesh.visual, "material", None), "name", None)
        rgba = colors[name] if name in colors else _trimesh_color(mesh)
        parts.append(_moved(vertices, normals, np.asarray(faces), T, rgba))
    return parts


_MATERIALS = "materials"  # name of the virtual material file


def _numbered_materials(path: Path, contents: bytes) -> tuple[bytes, dict[str, Rgba]]:
    """Replaces the materials of an OBJ file by numbers. Returns the file and the colors by number.

    trimesh does not find all material files and names, but it can distinguish numbers.
    """
    contents = b"\n" + without_bom(contents)
    known = _material_colors(path, contents)
    numbers: dict[bytes, str] = {}

    def numbered(found: re.Match[bytes]) -> bytes:
        number = numbers.setdefault(_plain_name(found[1]), str(len(numbers)))
        return b"\nusemtl " + number.encode()

    contents = re.sub(rb"\n(?i:usemtl)[ \t]+([^\n]+)", numbered, contents)
    contents = re.sub(rb"\n(?i:mtllib)[ \t][^\n]*", b"", contents)
    colors = {number: known[name] for name, number in numbers.items() if name in known}
    return b"mtllib " + _MATERIALS.encode() + contents, colors


def _trimesh_color(mesh: Any) -> Rgba | None:
    visual = mesh.visual
    if visual is None or not visual.defined:
        return None
    if visual.kind != "texture":
        main = np.asarray(visual.main_color) / 255.0
        return _rgba(main, main[3])
    material = visual.material
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    color, main = None, np.asarray(material.main_color) / 255.0
    if image is not None and (color := _mean_color(image)) is not None:
        main[3] *= color[3]
    color = color or _rgba(main)
    # glTF ignores alpha unless the material has an alphaMode.
    mode = getattr(material, "alphaMode", None) or "OPAQUE"
    if mode == "MASK":
        cutoff = getattr(material, "alphaCutoff", None)
        main[3] = main[3] >= (_CUTOFF if cutoff is None else cutoff)
    return None if color is None else _rgba(color, 1.0 if mode == "OPAQUE" else main[3])


_READERS = {".dae": _collada_parts}
