"""Reads MJCF and the files it refers to as a `mujoco.MjSpec`, and writes an `MjSpec` as MJCF."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import mujoco

from ...base.errors import Problem
from ...base.paths import format_of_file, read_file

_LIBRARY_NAMES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")  # Linux, macOS, Windows
_MAX_BYTES = 100_000_000  # maximum size of an MJCF file
_MAX_ELEMENTS = 20_000  # MuJoCo needs quadratic time, for example 8 s for 40,000 geoms
_ELEMENT = re.compile(rb"<(?:geom|body|site)\b")
_REPEATED = re.compile(rb"""<replicate\b[^>]*?\bcount\s*=\s*["']\s*(\d+)""")
_INCLUDED = re.compile(rb"""<include\b[^>]*?\bfile\s*=\s*["']([^"']+)""")
MAX_ASSET_BYTES = 500_000_000  # maximum size of a texture or mesh (ten million triangles)


def as_spec(source: Any, folder: Path) -> mujoco.MjSpec:
    """Reads MJCF as a spec, and stores the files to which it refers in the spec.

    Args:
        source: file name, MJCF text that starts with `<`, or an object that `is_mjcf_object`
            accepts. The object is not changed.
        folder: folder to which file names are relative.
    """
    try:
        spec = _read(source, folder)
        _store_files(spec)
    except OSError as error:
        reason = f"{error.filename or source}: {error.strerror or error}"
        raise Problem("mjcf", f"cannot be read: {reason}").error() from error
    except (ValueError, TypeError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise Problem("mjcf", f"cannot be read: {reason}").error() from error
    for k, body in enumerate(spec.bodies[1:]):
        if not body.name:
            body.name = f"body{k + 1}"  # Contact exclusion requires body names.
    return spec


def is_mjcf_object(source: Any) -> bool:
    """Returns whether an object is an `MjSpec`, a PyMJCF element, or a dm_control entity."""
    root = _root_element(source)
    return isinstance(source, mujoco.MjSpec) or (
        hasattr(root, "to_xml_string") and hasattr(root, "get_assets")
    )


def is_file_name(source: Any) -> bool:
    """Returns whether an MJCF source is a file name instead of MJCF text or an object."""
    return isinstance(source, str) and not source.lstrip().startswith("<")


def _root_element(source: Any) -> Any:
    return getattr(source, "mjcf_model", source)


def _read(source: Any, folder: Path) -> mujoco.MjSpec:
    if isinstance(source, mujoco.MjSpec):
        return source.copy()
    if not isinstance(source, str):
        root = _root_element(source)
        return mujoco.MjSpec.from_string(root.to_xml_string(), assets=root.get_assets())
    if is_file_name(source):
        _read_included(read_file(folder / source, _MAX_BYTES), (folder / source).parent)
        found = format_of_file(folder / source)
        if found not in (None, "an MJCF file", "a URDF file"):  # MuJoCo reports invalid XML
            raise ValueError(f"is {found}; expected MJCF, which begins with <mujoco>")
        return mujoco.MjSpec.from_file(str(folder / source))
    spec = mujoco.MjSpec.from_string(source, include=_read_included(source.encode(), folder))
    spec.modelfiledir = str(folder)
    return spec


def _read_included(text: bytes, folder: Path) -> dict[str, bytes]:
    """Returns the contents of included files by name. Raises ValueError for too many elements."""
    found: dict[str, bytes] = {}
    waiting, count = [text], 0
    while waiting:
        part = waiting.pop()
        count += len(_ELEMENT.findall(part)) + sum(map(int, _REPEATED.findall(part)))
        if count > _MAX_ELEMENTS:
            raise ValueError(
                f"has too many bodies, geoms and sites; expected at most {_MAX_ELEMENTS:,}"
            )
        names = {name.decode("utf-8", "replace") for name in _INCLUDED.findall(part)}
        for name in names - found.keys():
            if (folder / name).is_file():  # otherwise MuJoCo reports the missing file
                found[name] = read_file(folder / name, _MAX_BYTES)
                waiting.append(found[name])
    return found


def _store_files(spec: mujoco.MjSpec) -> None:
    for folder, elements in (
        (spec.meshdir, [*spec.meshes, *spec.skins]),
        (spec.texturedir, [*spec.textures]),
        (spec.meshdir, [*spec.hfields]),
    ):
        for element in elements:
            element.file = _stored(spec, folder, element.file)
    for texture in spec.textures:
        texture.cubefiles = [_stored(spec, spec.texturedir, file) for file in texture.cubefiles]
    spec.meshdir = spec.texturedir = ""


def _stored(spec: mujoco.MjSpec, folder: str, file: str) -> str:
    if not file or file in spec.assets:
        return file
    name = Path(file).name if spec.strippath else file
    path = Path(spec.modelfiledir) / folder / name
    return add_file(spec, path, read_file(path, MAX_ASSET_BYTES))


def add_file(spec: mujoco.MjSpec, path: Path, contents: bytes, digest: str | None = None) -> str:
    """Stores a file in the assets of a spec, and returns the name of the asset.

    The name contains a hash of the contents, so that specs with assets can be attached to others.
    """
    digest = digest or sha256(contents).hexdigest()
    file = f"{path.stem}-{digest[:16]}{path.suffix.lower()}"
    spec.assets[file] = contents
    return file


def write_mjcf(spec: mujoco.MjSpec, path: Path, comment: str = "") -> list[Path]:
    """Writes a compiled spec as MJCF, and its assets to the folder `NAME_assets` next to it.

    Returns the paths of the written files, the XML file first.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    written, folder = [path], path.parent / f"{path.stem}_assets"
    with _full_precision():
        text = spec.to_xml().replace(">\n", f">\n{comment}", 1)
    for name, contents in spec.assets.items():
        file = folder / name.rpartition("/")[2]
        if f'file="{name}"' not in text:
            continue  # The model does not use this asset.
        folder.mkdir(exist_ok=True)
        file.write_bytes(contents)
        written.append(file)
        text = text.replace(f'file="{name}"', f'file="{folder.name}/{file.name}"')
    path.write_text(text, encoding="utf-8")
    return list(dict.fromkeys(written))


@contextmanager
def _full_precision() -> Iterator[None]:
    """Makes MuJoCo write numbers with 17 digits instead of six within the context.

    MuJoCo 4.0.0 has only a private function for this. If it is missing, six digits are written.
    """
    folder = Path(mujoco.__file__).parent
    files = (file for name in _LIBRARY_NAMES for file in folder.glob(name))
    library = ctypes.CDLL(str(next(files)))
    set_digits = getattr(library, "_mjPRIVATE__set_xml_precision", lambda digits: None)
    set_digits(17)
    try:
        yield
    finally:
        set_digits(6)
