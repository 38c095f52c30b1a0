"""Runs `sero-mj` and programs in separate processes without importing everything again."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

_IMPORTED = (
    "sero_mj.cli", "sero_mj.load", "sero_mj.extensions.explain.explain", "sero_mj.study.figure",
    "sero_mj.extensions.sweeps.sweep", "sero_mj.viewer.image.render",
    "sero_mj.simulate.simulation",
    "sero_mj.viewer.program.viewer", "sero_mj.viewer.web.host", "sero_mj.viewer.window.host",
    "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_pdf",
)  # fmt: skip
# A server has neither, and no module imported there has chosen a backend.
UNSET = ("DISPLAY", "MUJOCO_GL")


@cache
def _server() -> Any:
    """Returns a context whose processes are copies of one without display and backend."""
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    context.set_forkserver_preload([__name__, *_IMPORTED])
    return context


def run_command(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    """Runs `sero-mj ARGUMENTS` in a folder and returns its exit status and all output.

    The output is also stored in `printed.txt` in the folder. `environment` is the whole
    environment.
    """
    return _run(_command, [*arguments], folder, environment)


def run_program(program: str, folder: Path, environment: Mapping[str, str]) -> tuple[int, str]:
    """Runs a program in a folder, on its module search path; see `run_command`.

    `environment` is the whole environment.
    """
    return _run(_program, program, folder, environment)


def _run(
    act: Callable[[Any], None], what: Any, folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    said = folder / "printed.txt"
    with said.open("wb") as file:
        streams = {1: file.fileno(), 2: file.fileno()}
        process = _start(act, what, folder, environment, streams, _server())
    process.join()
    status = process.exitcode
    process.close()
    return int(status), said.read_text("utf-8", "replace")


def start_program(
    program: str,
    folder: Path,
    environment: Mapping[str, str],
    streams: Mapping[int, int],
    *,
    opens_windows: bool = False,
) -> Any:
    """Starts a program in a folder, see `run_program`.

    Args:
        program: Python.
        folder: where it runs.
        environment: its whole environment.
        streams: what is its standard input (0), output (1) and error (2), by file descriptors.
        opens_windows: imports everything anew; MuJoCo chooses their OpenGL when it is imported.

    Returns:
        its `multiprocessing.Process`.
    """
    context = multiprocessing.get_context("spawn") if opens_windows else _server()
    return _start(_program, program, folder, environment, streams, context)


def _start(
    act: Callable[[Any], None],
    what: Any,
    folder: Path,
    environment: Mapping[str, str],
    streams: Mapping[int, int],
    context: Any,
) -> Any:
    given = {number: Connection(os.dup(stream)) for number, stream in streams.items()}
    before = dict(os.environ)
    os.environ.clear()
    os.environ |= {key: value for key, value in environment.items() if key not in UNSET}
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # for the modules imported beforehand
    try:
        process = context.Process(
            target=_begin, args=(act, what, str(folder), dict(environment), given)
        )
        process.start()
    finally:
        os.environ.clear()
        os.environ |= before
        for stream in given.values():
            stream.close()
    return process


def _begin(
    act: Callable[[Any], None],
    what: Any,
    folder: str,
    environment: dict[str, str],
    given: dict[int, Connection],
) -> None:
    for number, stream in given.items():
        os.dup2(stream.fileno(), number)
        stream.close()
    if 0 in given:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
    os.chdir(folder)
    for key in os.environ.keys() - environment.keys() - {"MUJOCO_GL", "PYOPENGL_PLATFORM"}:
        del os.environ[key]
    os.environ |= environment
    sys.path[:0] = [folder]  # possibly with packages
    try:
        act(what)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        atexit._run_exitfuncs()


def _command(arguments: list[str]) -> None:
    from sero_mj.cli import main

    sys.argv = ["sero-mj", *arguments]
    main(arguments)


def _program(program: str) -> None:
    exec(compile(program, "<program>", "exec"), {"__name__": "__main__"})
