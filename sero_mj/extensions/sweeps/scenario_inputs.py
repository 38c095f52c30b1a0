"""Finds the files that a scenario reads, and packs them for machines without a shared disk.

Another process reads the scenario and creates its simulation, while all opened files are recorded.
The files are packed with their folders and unpacked below another root, so that relative names stay
valid. Absolute names in texts are rewritten. Installed files (Python, packages, included robots)
are not packed, because they must be the same on the other machine.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ...base import paths
from ...base.errors import Problem, SeroError, UsageError
from ...study.engine import below

_TEXTS = (".toml", ".xml", ".urdf", ".mjcf", ".xacro", ".sdf", ".x3d", ".dae", ".obj", ".mtl")
_QUOTED = re.compile(r"""(["'])(/[^"'\n]+)\1""")
_REFERRED = re.compile(rb"""\b(?:file\w*|url)\s*=\s*["']([^"'\n]+)["']""")
_MAX_BYTES = 1_000_000_000
_OWN = Path(__file__).resolve().parents[2]
_NO_CODE = re.compile(r"(models|scenes|viewer/player/js)/")
_WRITES = os.O_WRONLY | os.O_RDWR
_SYSTEM = ("/proc", "/sys", "/dev", "/etc", "/run", "/bin", "/lib", "/lib64", "/usr")


def files_read(
    file: Path, fixed: Mapping[str, Any], choices: Iterable[Mapping[str, Any]] = ()
) -> list[Path]:
    """Returns the absolute paths of all files that variants of a scenario read.

    Files that controller programs open themselves are not included, but the programs are.

    Args:
        file: scenario file.
        fixed: values for all variants by dotted key.
        choices: values of some variants by dotted key, which may be file names.
    """
    request = json.dumps([str(file), dict(fixed), [dict(each) for each in choices]], default=str)
    environment = {**os.environ, "MUJOCO_GL": "disable"}
    done = subprocess.run(
        [sys.executable, "-m", __name__],
        input=request, capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise UsageError(Problem("", f"its input files cannot be found: {last}", str(file)))
    found = [Path(line) for line in json.loads(done.stdout.splitlines()[-1])]
    return list(dict.fromkeys([file.absolute(), *found]))


def pack(files: Sequence[Path]) -> bytes:
    """Returns an archive of files with their folders; raises UsageError if they exceed 1 GB."""
    size = sum(file.stat().st_size for file in files)
    if size > _MAX_BYTES:
        largest = max(files, key=lambda file: file.stat().st_size)
        message = f"files for a worker have {size / 1e6:.0f} MB; the largest is {largest}"
        expected = f"at most {_MAX_BYTES / 1e6:.0f} MB"
        raise UsageError(Problem("--scheduler", message, expected=expected))
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w:gz", compresslevel=1, dereference=True) as tar:
        for file in files:
            tar.add(file, str(file.absolute()).lstrip("/"), recursive=False)
    return archive.getvalue()


def unpack(archive: bytes, root: Path) -> list[Path]:
    """Extracts an archive below a root and rewrites absolute names in texts; returns the files."""
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(root, filter="data")
        files = [root / name for name in tar.getnames()]
    for file in files:
        if file.suffix.lower() not in _TEXTS:
            continue
        text = file.read_bytes().decode("utf-8", "surrogateescape")
        moved = _QUOTED.sub(lambda match: f"{match[1]}{below(root, match[2])}{match[1]}", text)
        if moved != text:
            file.write_bytes(moved.encode("utf-8", "surrogateescape"))
    return files


def digest_of_models(files: Iterable[Path]) -> dict[str, str]:
    """Returns the SHA-256 of the files that are in the folder of models, by relative name."""
    shipped = paths.models_dir().resolve()
    found = {}
    for file in files:
        if file.resolve().is_relative_to(shipped):
            name = file.resolve().relative_to(shipped).as_posix()
            found[name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


@cache
def digest_of_code() -> str:
    """Returns the SHA-256 of the Python files of sero-mj."""
    digest = hashlib.sha256()
    names = (file.relative_to(_OWN).as_posix() for file in _OWN.rglob("*.py"))
    # A wheel contains the scenes, but not the sources of the page.
    for name in sorted(name for name in names if not _NO_CODE.match(name)):
        digest.update(name.encode())
        digest.update((_OWN / name).read_bytes())
    return digest.hexdigest()


def is_installed(file: Path) -> bool:
    """Whether a file is part of the system, Python, a package, or the robots of sero-mj."""
    scenes = paths.scenes_dir().resolve()
    if file.is_relative_to(scenes):
        return False  # scenarios are read by their paths
    return any(file.is_relative_to(folder) for folder in _installed())


@cache
def _installed() -> tuple[Path, ...]:
    folders = [*_SYSTEM, sys.prefix, *sysconfig.get_paths().values(), str(_OWN)]
    return tuple(Path(each).resolve() for each in [*folders, str(paths.models_dir())])


def _note_files(file: str, fixed: dict[str, Any], choices: list[dict[str, Any]]) -> set[Path]:
    """Reads variants of a scenario, and creates their simulations without running them.

    Returns all opened files that are not installed, and those of included robots.
    """
    noted: set[str] = set()

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | bytes):
            if not arguments[2] & _WRITES:
                noted.add(os.path.abspath(os.fsdecode(arguments[0])))
        elif event == "ctypes.dlopen" and isinstance(arguments[0], str):
            noted.add(os.path.abspath(arguments[0]))
        elif event == "subprocess.Popen":
            program, words, folder, _ = arguments
            for word in (program, *words):
                noted.add(os.path.abspath(os.path.join(folder or "", os.fsdecode(word))))

    from ...simulate.log_output import files_of
    from ...simulate.scenario_file import read_scenario
    from ...simulate.simulation import Simulation

    sys.addaudithook(note)
    known: set[Path] = set()
    for choice in ({}, *choices):
        try:
            scenario = read_scenario(file, {**fixed, **choice})
            known |= {*files_of(scenario), *(mesh for _, mesh in scenario.scene.meshes())}
            Simulation(scenario)
        except SeroError:
            continue  # becomes the error of the variant
    # MuJoCo opens files that XML files include.
    todo = [*known, *map(Path, sorted(noted))]
    found: set[Path] = set()
    while todo:
        path = Path(os.path.abspath(todo.pop()))
        if path in found or not path.is_file():
            continue
        found.add(path)
        if path.suffix.lower() in (".xml", ".mjcf", ".urdf"):
            names = _REFERRED.findall(path.read_bytes())
            todo += [path.parent / os.fsdecode(name) for name in names]
    models = paths.models_dir().resolve()
    return {
        each
        for each in found
        if each.resolve().is_relative_to(models)
        or not (is_installed(each) or is_installed(each.resolve()))
    }


if __name__ == "__main__":
    print(json.dumps([str(each) for each in sorted(_note_files(*json.load(sys.stdin)))]))
