"""Runs the variants of a scenario that a `Design` selects."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Generator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from ... import __version__
from ...simulate.log_output import files_of
from ...simulate.scenario import Scenario
from ...simulate.scenario_file import read_scenario
from ...study.engine import Engine, Processes, Result, Work
from .variant import outcome_columns, runs_alone
from .variants import Variants

# Maximum batch: variants, and variants times steps times joints (250 MB of logs).
_BATCH, _BATCH_STEPS = 64, 2_500_000


class Design(Protocol):
    """The set of variants of a sweep, such as `samples.Samples` and `mutations.Mutations`."""

    @property
    def columns(self) -> list[str]:
        """Columns that identify the variants in the table of results."""

    @property
    def variants(self) -> list[dict[str, Any]]:
        """Overriding values of all variants by dotted key."""

    def cells(self, number: int) -> dict[str, Any]:
        """Returns the values of a variant in `columns` of the table of results."""

    def choices(self) -> list[dict[str, Any]]:
        """Returns the overriding values that may be names of files to send to workers."""

    def settings(self) -> dict[str, Any]:
        """Returns all settings that the variants depend on."""

    def check(self, read: Callable[[Mapping[str, Any]], object], fixed: Mapping[str, Any]) -> None:
        """Raises SeroError if variants are invalid.

        `read` reads the scenario with the values of a variant. `fixed` contains values for all
        variants.
        """


@dataclass(frozen=True)
class Sweep:
    """The variants of a scenario that a design selects.

    Args:
        file: scenario file.
        design: set of variants.
        fixed: values for all variants by dotted key.

    Raises:
        UsageError: the design sets a fixed key.
        DeclarationError: the scenario is invalid, or none of its variants is valid.
    """

    file: Path
    design: Design
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assert self.base.run.steps > 0  # the scenario is valid
        self.design.check(self._read, self.fixed)

    @cached_property
    def base(self) -> Scenario:
        """Scenario with the fixed values, but without the values of a variant."""
        return self._read({})

    def _read(self, values: Mapping[str, Any]) -> Scenario:
        return read_scenario(self.file, {**self.fixed, **values})

    @property
    def variants(self) -> list[dict[str, Any]]:
        return self.design.variants

    @cached_property
    def columns(self) -> list[str]:
        """Columns of the results: number, identification of the variant, and outcomes."""
        return ["variant", *self.design.columns, *outcome_columns(self.base)]

    @property
    def settings(self) -> dict[str, Any]:
        """All settings that the results depend on, as JSON types."""
        files = {
            file.name if file == self.file else f"{file.parent.name}/{file.name}": hashlib.sha256(
                file.read_bytes()
            ).hexdigest()[:16]
            for file in files_of(self.base)
        }
        settings = {
            "scenario": self.base.name,
            **self.design.settings(),
            "set": self.fixed,
            "files": files,
            "sero-mj": __version__,
            "mujoco": mujoco.__version__,
        }
        return {key: _plain(value) for key, value in settings.items()}

    def shard(self, number: int = 1, of: int = 1) -> range:
        """Returns the numbers of the variants in shard `number` (from 1) of `of` shards."""
        return range(number - 1, len(self.variants), of)

    def run(
        self, engine: Engine | None = None, numbers: Collection[int] | None = None
    ) -> Generator[Result]:
        """Runs variants; yields their numbers and results in the order of completion.

        Args:
            engine: engine, for example `Processes(4)`; None for this process.
            numbers: numbers of the variants; None for all variants.
        """
        wanted = range(len(self.variants)) if numbers is None else numbers
        todo = [(number, self.variants[number]) for number in wanted]
        run, joints = self.base.run, sum(robot.n for robot in self.base.scene.robots.values())
        batch = int(np.clip(_BATCH_STEPS // ((run.steps + 1) * joints), 1, _BATCH))
        if runs_alone(self.base):
            batch = 1
        job = Variants(self.file, self.fixed, self.design.choices())
        yield from (engine or Processes()).run(Work(job, todo, batch))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value if isinstance(value, bool | int | float | str) else str(value)
