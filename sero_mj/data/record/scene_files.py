"""Stores the files of a scene in a recording, which can then be displayed without these files.

TOML files of scene, scenario and robots are attached as `FOLDER/FILE`. All files in the folder of
the scene, including meshes, are also attached as `files/PATH`. Files of sero-mj are not attached.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from ...base import paths
from ...robots.declared.scene import Scene
from .recording import PacketFile

log = logging.getLogger(__name__)

_TREE = "files/"
_MAX_MESH_BYTES = 50_000_000


def attached_files(scene: Scene, tables: Iterable[Path]) -> dict[str, Path]:
    """Returns the files to attach, by their names in the recording. `tables` are TOML files."""
    own = [file.absolute() for file in tables]
    found = {f"{file.parent.name}/{file.name}": file for file in own}
    if scene.file is None:
        return found
    folder = scene.file.absolute().parent
    if folder.is_relative_to(paths.scenes_dir().absolute()):
        return found
    shipped = paths.models_dir().absolute()
    files = dict.fromkeys(file.absolute() for _, file in scene.meshes())
    meshes = [
        file
        for file in files
        if file.is_relative_to(folder) and not file.is_relative_to(shipped) and file.is_file()
    ]
    size = sum(file.stat().st_size for file in meshes)
    if size > _MAX_MESH_BYTES:
        log.warning(
            "meshes of %.0f MB are not recorded (maximum: %.0f MB). Showing the recording needs %s",
            size / 1e6,
            _MAX_MESH_BYTES / 1e6,
            scene.file,
        )
        return found
    inside = [file for file in (*own, *meshes) if file.is_relative_to(folder)]
    return found | {f"{_TREE}{file.relative_to(folder).as_posix()}": file for file in inside}


def table_names(recording: PacketFile) -> list[str]:
    """Returns the names of the attached TOML files."""
    return [each for each in recording.attachments if not each.startswith(_TREE)]


def write_scene(recording: PacketFile, name: str, folder: Path) -> Path | None:
    """Writes the files of the scene `name` to an empty folder, and returns the scene file.

    Returns None if the recording does not have the scene. Ignores paths outside of the folder.
    """
    scenes = [each for each in table_names(recording) if PurePosixPath(each).stem == name]
    if not scenes:
        return None
    scene = folder / PurePosixPath(scenes[0]).name
    beside = PurePosixPath(scenes[0]).parent
    for each in sorted(recording.attachments, key=lambda each: each.startswith(_TREE)):
        target = PurePosixPath(each)
        if each.startswith(_TREE):
            target = PurePosixPath(each.removeprefix(_TREE))
        elif target.parent == beside:
            target = PurePosixPath(target.name)
        elif (paths.models_dir() / target.parent.name).is_dir():
            continue  # included robots have meshes that are not in the recording
        if target.is_absolute() or ".." in target.parts:
            continue
        file = folder / target
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(recording.read_attachment(each))
    return scene
