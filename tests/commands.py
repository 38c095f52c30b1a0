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
# Variables that are not set in the server process, so that no imported module chooses a backend.
UNSET = ("DISPLAY", "MUJOCO_GL")


@cache
def _server() -> Any:
    """Returns a context whose processes are copies of a process without display and backend."""
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    context.set_forkserver_preload([__name__, *_IMPORTED])
    return context


def run_command(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    """Runs `sero-mj ARGUMENTS` in a folder; returns the exit status and all output.

    The output is also stored in `printed.txt` in the folder. `environment` contains all environment
    variables of the process.
    """
    return _run(_command, [*arguments], folder, environment)


def run_program(program: str, folder: Path, environment: Mapping[str, str]) -> tuple[int, str]:
    """Runs Python code in a folder, like `run_command`. The code can import modules there."""
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
    """Starts Python code in a folder, like `run_program`; returns its `multiprocessing.Process`.

    Args:
        program: Python code.
        folder: working directory.
        environment: all environment variables of the process.
        streams: file descriptors for standard input (0), output (1) and error (2).
        opens_windows: whether the process imports MuJoCo again, which then selects the OpenGL of
            windows.
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
    passed = {number: Connection(os.dup(stream)) for number, stream in streams.items()}
    before = dict(os.environ)
    os.environ.clear()
    os.environ |= {key: value for key, value in environment.items() if key not in UNSET}
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # for the preloaded modules
    try:
        process = context.Process(
            target=_begin, args=(act, what, str(folder), dict(environment), passed)
        )
        process.start()
    finally:
        os.environ.clear()
        os.environ |= before
        for stream in passed.values():
            stream.close()
    return process


def _begin(
    act: Callable[[Any], None],
    what: Any,
    folder: str,
    environment: dict[str, str],
    passed: dict[int, Connection],
) -> None:
    for number, stream in passed.items():
        os.dup2(stream.fileno(), number)
        stream.close()
    if 0 in passed:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
    os.chdir(folder)
    for key in os.environ.keys() - environment.keys() - {"MUJOCO_GL", "PYOPENGL_PLATFORM"}:
        del os.environ[key]
    os.environ |= environment
    sys.path[:0] = [folder]  # tests write modules there
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
