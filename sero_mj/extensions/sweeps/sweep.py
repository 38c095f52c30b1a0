"""`Sweep`: many variants of a scenario, which a `Design` chooses."""

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
from ...study.engine import Engine, Result, Work
from ...study.workers import Processes
from .variant import outcome_columns, runs_alone
from .variants import Variants

# Variants that are run together, and steps and joints of theirs: 250 MB of logs.
_BATCH, _BATCH_STEPS = 64, 2_500_000


class Design(Protocol):
    """Which variants there are: `samples.Samples` of ranges, or `mutations.Mutations`."""

    @property
    def columns(self) -> list[str]:
        """Those of the table that tell variants apart."""

    @property
    def variants(self) -> list[dict[str, Any]]:
        """What each sets, by dotted key."""

    def cells(self, number: int) -> dict[str, Any]:
        """What a variant has in these columns."""

    def choices(self) -> list[dict[str, Any]]:
        """What some variant sets that may name a file."""

    def settings(self) -> dict[str, Any]:
        """Everything that the variants depend on."""

    def check(self, read: Callable[[Mapping[str, Any]], object], fixed: Mapping[str, Any]) -> None:
        """Raises SeroError where variants cannot be.

        Args:
            fixed: dotted keys that are set in all variants.
        """


@dataclass(frozen=True)
class Sweep:
    """Variants of a scenario to be run.

    Args:
        file: the scenario's.
        fixed: dotted keys that are set in all of them.

    Raises:
        UsageError: the design sets a key that is fixed.
        DeclarationError: the scenario cannot be read, or no variant of it.
    """

    file: Path
    design: Design
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assert self.base.run.steps > 0  # it can be read by itself
        self.design.check(self._read, self.fixed)

    @cached_property
    def base(self) -> Scenario:
        """The scenario as it is without what variants set."""
        return self._read({})

    def _read(self, values: Mapping[str, Any]) -> Scenario:
        return read_scenario(self.file, {**self.fixed, **values})

    @property
    def variants(self) -> list[dict[str, Any]]:
        """What each variant sets, by dotted key."""
        return self.design.variants

    @cached_property
    def columns(self) -> list[str]:
        """The columns of results: number, what tells variants apart, outcomes."""
        return ["variant", *self.design.columns, *outcome_columns(self.base)]

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that its results depend on, as JSON types."""
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
        """The numbers of the variants of one of several shards, counted from 1."""
        return range(number - 1, len(self.variants), of)

    def run(
        self, engine: Engine | None = None, numbers: Collection[int] | None = None
    ) -> Generator[Result]:
        """Runs variants; yields number and result as they are ready.

        Args:
            engine: where; None is in this process, `Processes(4)` in four of their own.
            numbers: of the variants; None for all.
        """
        wanted = range(len(self.variants)) if numbers is None else numbers
        todo = [(number, self.variants[number]) for number in wanted]
        run, joints = self.base.run, sum(robot.n for robot in self.base.scene.robots.values())
        most = int(np.clip(_BATCH_STEPS // ((run.steps + 1) * joints), 1, _BATCH))
        if runs_alone(self.base):
            most = 1  # so that each result comes as soon as it is ready
        job = Variants(self.file, self.fixed, self.design.choices())
        yield from (engine or Processes()).run(Work(job, todo, most))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value if isinstance(value, bool | int | float | str) else str(value)
