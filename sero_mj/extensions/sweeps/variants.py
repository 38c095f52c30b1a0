"""The job of a sweep.

This file imports little, because every new process imports it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...study.engine import KILLED, Runner


@dataclass(frozen=True)
class Variants:
    """A `Job` in which every task runs a scenario with other values.

    Attributes:
        file: scenario file.
        fixed: values for all variants by dotted key.
        choices: values of some variants by dotted key, which may name additional files.
    """

    file: Path
    fixed: Mapping[str, Any]
    choices: Sequence[Mapping[str, Any]] = ()

    def runner(self) -> Runner:
        from .variant import VariantRunner

        return VariantRunner(self.file, self.fixed)

    def check(self) -> None:
        from ...simulate.scenario_file import read_scenario

        read_scenario(self.file, self.fixed)

    def files(self) -> list[Path]:
        from .scenario_inputs import files_read

        return files_read(self.file, self.fixed, self.choices)

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """Returns no files, because `files` already includes those that variants name."""
        return []

    def below(self, root: Path) -> Variants:
        from ...study.engine import below

        return replace(self, file=Path(f"{root}{self.file}"), fixed=below(root, self.fixed))

    def killed(self) -> dict[str, Any]:
        return {"held": False, "error": KILLED, "ended": 0.0}
