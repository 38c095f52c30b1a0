"""`Variants`: what the tasks of a sweep do.

This file imports little: every new process reads it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...study.engine import KILLED, Runner


@dataclass(frozen=True)
class Variants:
    """A `Job`: a scenario is run with other values in every task.

    Attributes:
        file: the scenario's.
        fixed: dotted keys that are set in all of them.
        choices: keys and values of tasks that may name files of their own.
    """

    file: Path
    fixed: Mapping[str, Any]
    choices: Sequence[Mapping[str, Any]] = ()

    def runner(self) -> Runner:
        """Simulates variants together where they differ in numbers only."""
        from .variant import VariantRunner

        return VariantRunner(self.file, self.fixed)

    def check(self) -> None:
        """Reads the scenario."""
        from ...simulate.scenario_file import read_scenario

        read_scenario(self.file, self.fixed)

    def files(self) -> list[Path]:
        """What is opened where the scenario, with any of the choices, is read and simulated."""
        from .scenario_inputs import files_read

        return files_read(self.file, self.fixed, self.choices)

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """None besides those of the choices."""
        return []

    def below(self, root: Path) -> Variants:
        """With the names of files in what is set as well."""
        from ...study.shipped_files import below

        return replace(self, file=Path(f"{root}{self.file}"), fixed=below(root, self.fixed))

    def killed(self) -> dict[str, Any]:
        """Nothing held, at no time."""
        return {"held": False, "error": KILLED, "ended": 0.0}
