"""`Sweep`: many variants of a scenario."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Generator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco

from .. import __version__
from ..errors import DeclarationError, UsageError
from ..simulate.log_output import files_of
from ..simulate.scenario import Scenario
from ..simulate.scenario_file import read_scenario
from .variant import VariantRunner, outcome_columns
from .vary import Vary, full_grid, latin_hypercube
from .workers import Result, run_in_processes

_TRIED = 20  # variants that are read beforehand: if none can be, a key is wrong


@dataclass(frozen=True)
class Sweep:
    """Variants of a scenario to be run.

    Args:
        file: the scenario's.
        varied: the keys, and the values that they take.
        samples: how many variants; of a grid, how many values of every range.
        is_grid: whether all values are combined with all others; else a Latin hypercube.
        seed: of the samples; the noise is that of the scenario in every variant.
        fixed: dotted keys that are set in all of them.

    Raises:
        UsageError: a key is varied twice.
        DeclarationError: the scenario cannot be read, or no variant of it.
    """

    file: Path
    varied: tuple[Vary, ...]
    samples: int
    is_grid: bool = False
    seed: int = 0
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        keys = [vary.key for vary in self.varied]
        for key in keys:
            if keys.count(key) > 1:
                raise UsageError(f"--vary {key}: is given twice; expected one range for each key")
            if key in self.fixed:
                raise UsageError(f"--vary {key}: is also set; expected one of --vary and --set")
        self._check_variants()

    @cached_property
    def base(self) -> Scenario:
        """The scenario as it is without the varied values."""
        return read_scenario(self.file, self.fixed)

    @cached_property
    def variants(self) -> list[dict[str, Any]]:
        """The values of every variant, by key."""
        if self.is_grid:
            return full_grid(self.varied, self.samples)
        return latin_hypercube(self.varied, self.samples, self.seed)

    @cached_property
    def columns(self) -> list[str]:
        """What is known of each: its number, its values, and what came of it."""
        return ["variant", *(vary.key for vary in self.varied), *outcome_columns(self.base)]

    def _check_variants(self) -> None:
        assert self.base.run.steps > 0  # it can be read by itself
        first: DeclarationError | None = None
        for values in self.variants[:_TRIED]:
            try:
                read_scenario(self.file, {**self.fixed, **values})
            except DeclarationError as error:
                first = first or error
            else:
                return
        if first is not None:
            raise first

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that its results depend on, as JSON types."""
        files = {
            file.name if file == self.file else f"{file.parent.name}/{file.name}": hashlib.sha256(
                file.read_bytes()
            ).hexdigest()[:16]
            for file in files_of(self.base)
        }
        return {
            "scenario": self.base.name,
            "vary": {vary.key: vary.text for vary in self.varied},
            "samples": self.samples,
            "grid": self.is_grid,
            "seed": self.seed,
            "set": {key: _plain(value) for key, value in self.fixed.items()},
            "files": files,
            "sero-mj": __version__,
            "mujoco": mujoco.__version__,
        }

    def run(self, jobs: int = 1, done: Collection[int] = ()) -> Generator[Result]:
        """Runs all variants but those that are done; yields number and result as they are ready.

        Args:
            jobs: how many at once; 1 runs them in this process.
            done: numbers of variants to leave out.
        """
        todo = ((k, values) for k, values in enumerate(self.variants) if k not in done)
        if jobs > 1:
            yield from run_in_processes(todo, jobs, self.file, self.fixed)
            return
        runner = VariantRunner(self.file, self.fixed)
        for number, values in todo:
            yield number, runner.run(values)


def _plain(value: Any) -> Any:
    """The same as JSON gives it back."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value if isinstance(value, bool | int | float | str) else str(value)
