"""Robots as the files in a recording declare them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .. import paths
from ..assemble.robot import SerialRobot, build_robot
from ..errors import DeclarationError, RecordingError, UnknownName
from ..record.recording import Recording
from ..toml_file import parse_toml

_ROBOT_FILE = "robot.toml"


def recorded_robots(recording: Recording) -> dict[str, SerialRobot]:
    """Robots by their names in the recorded scene, else by those of their folders.

    A robot that is installed here as it was recorded has its meshes; of another one the links grow
    from its table.

    Raises:
        RecordingError: a file in it is damaged, or declares a robot wrongly.
    """
    files = read_tables(recording)
    models = {name.split("/")[-2]: name for name in files if name.endswith(f"/{_ROBOT_FILE}")}
    robots: dict[str, SerialRobot] = {}
    for tables in files.values():
        declared = tables.get("robots")
        for name, table in declared.items() if isinstance(declared, dict) else ():
            robots.setdefault(name, _robot(recording, name, dict(table), models))
    if not robots:
        for name in models:
            robots[name] = _robot(recording, name, {"model": name}, models)
    return robots


def read_tables(recording: Recording) -> dict[str, dict[str, Any]]:
    """Every TOML file in a recording, by its name there.

    Raises:
        RecordingError: one is damaged or is no TOML.
    """
    found = {}
    for name in recording.attachments:
        if name.endswith(".toml"):
            try:
                found[name] = parse_toml(recording.read_attachment(name).decode("utf-8-sig"))
            except ValueError as error:
                reason = f"file '{name}' in it is no TOML: {error}"
                raise RecordingError(recording.path, reason) from error
    return found


def _robot(
    recording: Recording, name: str, table: dict[str, Any], models: Mapping[str, str]
) -> SerialRobot:
    model = table.pop("model", None)
    table.pop("children", None)  # what is fixed to the flange may be in files that are not there
    fields = {**table, "name": name}
    if model is None:
        return _built(recording, name, _without_meshes(fields), None)
    folder = Path(str(model)).parent.name if str(model).endswith(".toml") else Path(str(model)).name
    attached = models.get(folder)
    if attached is None:
        return _built(recording, name, fields, str(model))
    data = recording.read_attachment(attached)
    installed = _installed(folder)
    if installed is not None and installed.read_bytes() == data:
        return _built(recording, name, fields, str(installed))
    with TemporaryDirectory() as directory:
        path = Path(directory) / folder / _ROBOT_FILE
        path.parent.mkdir()
        path.write_bytes(data)
        return _built(recording, name, _without_meshes(fields), str(path))


def _built(
    recording: Recording, name: str, fields: dict[str, Any], model: str | None
) -> SerialRobot:
    try:
        return build_robot(fields, None if model is None else paths.find_model(model))
    except UnknownName as error:
        reason = f"its robot '{name}' is not in it, nor installed: {error}; give a scene"
        raise RecordingError(recording.path, reason) from error
    except DeclarationError as error:
        reason = f"its robot '{name}' is declared wrongly: {error}"
        raise RecordingError(recording.path, reason) from error


def _without_meshes(fields: dict[str, Any]) -> dict[str, Any]:
    return {**fields, "filenames": [], "directory": ""}


def _installed(model: str) -> Path | None:
    try:
        return paths.find_model(model)
    except (UnknownName, DeclarationError):
        return None
