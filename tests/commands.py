"""Runs `sero-mj` in processes of their own, which need not import everything anew."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

_IMPORTED = (
    "sero_mj.cli", "sero_mj.load", "sero_mj.study.explain", "sero_mj.study.figure",
    "sero_mj.study.sweep", "sero_mj.viewer.headless.render", "sero_mj.simulate.simulation",
    "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_pdf",
)  # fmt: skip


@cache
def _server() -> Any:
    """Processes that are copies of one in which neither a display nor a backend was set."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, *_IMPORTED])
    return context


def run_command(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    """Runs `sero-mj ARGUMENTS` in a folder; returns its exit status and all that it printed.

    Args:
        arguments: of the command.
        folder: where it runs; what it prints is kept there as well, in `printed.txt`.
        environment: its whole environment.
    """
    said = folder / "printed.txt"
    before = dict(os.environ)
    os.environ.clear()
    # For modules that are imported beforehand.
    os.environ |= {**environment, "PYTHONPATH": str(Path(__file__).parent)}
    try:
        process = _server().Process(
            target=_command, args=([*arguments], str(folder), dict(environment), str(said))
        )
        process.start()
    finally:
        os.environ.clear()
        os.environ |= before
    process.join()
    status = process.exitcode
    process.close()
    return int(status), said.read_text("utf-8", "replace")


def _command(arguments: list[str], folder: str, environment: dict[str, str], said: str) -> None:
    from sero_mj.cli import main

    with open(said, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    for key in os.environ.keys() - environment.keys() - {"MUJOCO_GL", "PYOPENGL_PLATFORM"}:
        del os.environ[key]
    os.environ |= environment
    sys.argv = ["sero-mj", *arguments]
    try:
        main(arguments)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        atexit._run_exitfuncs()
