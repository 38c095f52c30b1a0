"""The files of a scene in a recording, so that the recording alone can show it.

Tables (scene, scenario, robots) are there as `FOLDER/FILE`, for what computes with a recording.
All that is in the scene's folder, meshes too, is there again as `files/...`, by its path there.
What is shipped is installed wherever a recording is opened.
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
_MOST_BYTES = 50_000_000  # of meshes


def attached_files(scene: Scene, tables: Iterable[Path]) -> dict[str, Path]:
    """Returns what a recording is given, by the name there."""
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
    if size > _MOST_BYTES:
        log.warning(
            "meshes of %.0f MB are not put into the recording, at most %.0f MB are: it is shown "
            "where %s is", size / 1e6, _MOST_BYTES / 1e6, scene.file,
        )  # fmt: skip
        return found
    inside = [file for file in (*own, *meshes) if file.is_relative_to(folder)]
    return found | {f"{_TREE}{file.relative_to(folder).as_posix()}": file for file in inside}


def table_names(recording: PacketFile) -> list[str]:
    """Returns the names of a recording's files without its tree of them."""
    return [each for each in recording.attachments if not each.startswith(_TREE)]


def write_scene(recording: PacketFile, name: str, folder: Path) -> Path | None:
    """Writes the files of a recording's scene to a folder; returns the scene's file there.

    Args:
        recording: from anywhere: paths that lead out of the folder are left out.
        name: of the scene; None is returned where the recording does not have it.
        folder: an empty one.
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
            continue  # shipped, with meshes that are not in the recording
        if target.is_absolute() or ".." in target.parts:
            continue
        file = folder / target
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(recording.read_attachment(each))
    return scene
