"""Compiles what `run.jit` asks for, before anything is timed, and says what it does."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..simulate.simulation import Simulation


def compile_steps(simulation: Simulation, *, quiet: bool) -> None:
    """Compiles or loads the steps of a simulation, where they are machine code.

    Args:
        simulation: before its first step.
        quiet: whether nothing is said; else that it takes a while, or why steps are in Python.
    """
    if simulation.in_python and not quiet:
        why = ", ".join(simulation.in_python)
        print(f"sero-mj: run.jit: steps are made in Python, since {why}", file=sys.stderr)
    steps = simulation.compiled
    if steps is None:
        return
    from ..control.jit import when_compiling

    kept = "for this run only: no folder can be written to"
    if steps.folder is not None:
        kept = f"once for this machine ({steps.folder})"
    text = f"sero-mj: compiling controllers and physics, which takes half a minute, {kept}"
    with when_compiling(lambda: None if quiet else print(text, file=sys.stderr)):
        steps.load()
