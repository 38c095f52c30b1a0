"""Ranges and lists of values for the variants of a sweep, and samples of them."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...base.errors import DeclarationError, Problem, UsageError
from ...base.frames import Array

MAX_VARIANTS = 200_000  # limited by memory, which stores all values and results
_TRIED = 20  # number of variants that are checked in advance
_SCALES = ("log", "int")
_WHOLE = ("run.seed",)  # keys that accept only integers
_EXAMPLE = "expected KEY=LOW:HIGH, log:LOW:HIGH, int:LOW:HIGH or a list A,B,C"


@dataclass(frozen=True)
class Vary:
    """A key of a scenario, with the range or list of its values in a sweep.

    Attributes:
        key: dotted key as in `read_scenario(overrides=...)`: `controllers.lwr.stiffness`.
        text: values as written in the option, for example `100:2000`.
        low: lower end of the range.
        high: upper end of the range.
        scale: `linear`, `log`, or `int` (integers, including both ends).
        values: listed values; empty for a range.
    """

    key: str
    text: str
    low: float = 0.0
    high: float = 0.0
    scale: str = "linear"
    values: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, option: str) -> Vary:
        """Parses `KEY=VALUES`; raises UsageError if VALUES is neither a range nor a list."""
        key, equals, text = (part.strip() for part in option.partition("="))
        if not equals or not text or "." not in key:
            example = "e.g. controllers.lwr.stiffness=100:2000"
            raise UsageError(f"--vary {option}: {_EXAMPLE}, {example}")
        scale, _, rest = text.partition(":")
        if scale in _SCALES:
            return cls._range(option, key, text, rest, scale)
        if ":" in text and not text.startswith(("[", "'", '"', "{")):
            whole = "int" if key in _WHOLE else "linear"
            return cls._range(option, key, text, text, whole)
        return cls(key, text, values=tuple(_list(text)))

    @classmethod
    def _range(cls, option: str, key: str, text: str, ends: str, scale: str) -> Vary:
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise UsageError(f"--vary {option}: found '{ends}'; {_EXAMPLE}") from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            message = f"found {low:g} to {high:g}; expected two numbers in ascending order"
            raise UsageError(f"--vary {option}: {message}")
        if scale == "log" and low <= 0:
            raise UsageError(f"--vary {option}: found log from {low:g}; expected LOW above 0")
        if scale == "int" and (low % 1 or high % 1):
            raise UsageError(f"--vary {option}: found {text}; expected whole numbers")
        return cls(key, text, low, high, scale)

    @property
    def is_range(self) -> bool:
        return not self.values

    @property
    def count(self) -> float:
        """Number of values; infinite for a range of real numbers."""
        if self.scale == "int":
            return self.high - self.low + 1
        return math.inf if self.is_range else len(self.values)

    def at(self, shares: Array) -> list[Any]:
        """Returns the values at relative positions, shape (m,), in [0, 1)."""
        if not self.is_range:
            return [self.values[int(share * len(self.values))] for share in shares]
        if self.scale == "int":
            count = self.high - self.low + 1
            return [int(self.low + math.floor(share * count)) for share in shares]
        return [self._between(float(share)) for share in shares]

    def grid(self, count: int) -> list[Any]:
        """Returns `count` equidistant values of a range, or all values of a list."""
        if not self.is_range:
            return list(self.values)
        shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
        if self.scale == "int":
            whole = [round(self.low + float(share) * (self.high - self.low)) for share in shares]
            return list(dict.fromkeys(whole))
        return [self._between(float(share)) for share in shares]

    def _between(self, share: float) -> float:
        if self.scale == "log":
            low, high = math.log(self.low), math.log(self.high)
            return min(max(math.exp(low + share * (high - low)), self.low), self.high)
        return self.low + share * (self.high - self.low)


def latin_hypercube(varied: Sequence[Vary], samples: int, seed: int) -> list[dict[str, Any]]:
    """Returns samples that cover the range of each key evenly.

    The range of each key is divided into as many intervals as there are samples. Each interval
    contains one sample at a random position; the orders of the keys are shuffled independently.

    Source: McKay, Beckman, Conover 1979, A Comparison of Three Methods for Selecting Values of
    Input Variables in the Analysis of Output from a Computer Code, Technometrics 21.
    """
    rng = np.random.default_rng(seed)
    columns = []
    for vary in varied:
        shares = (rng.permutation(samples) + rng.random(samples)) / samples
        columns.append(vary.at(np.minimum(shares, np.nextafter(1.0, 0.0))))
    return _named(varied, zip(*columns, strict=True))


def full_grid(varied: Sequence[Vary], count: int) -> list[dict[str, Any]]:
    """Returns all combinations of values, with `count` values per range.

    Raises:
        UsageError: there are more than `MAX_VARIANTS` combinations.
    """
    columns = [vary.grid(count) for vary in varied]
    many = math.prod(map(len, columns))
    if many > MAX_VARIANTS:
        sizes = " x ".join(str(len(column)) for column in columns)
        expected = f"at most {MAX_VARIANTS}; reduce --samples, or omit --grid"
        problem = Problem(
            "--grid", f"found {sizes} =", found=many, of="variants", expected=expected
        )
        raise UsageError(problem)
    return _named(varied, itertools.product(*columns))


def _named(varied: Sequence[Vary], rows: Any) -> list[dict[str, Any]]:
    keys = [vary.key for vary in varied]
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _list(text: str) -> list[Any]:
    try:
        found = tomllib.loads(f"value = [{text}]")["value"]
        return list(found) if found else [text]
    except tomllib.TOMLDecodeError:
        return [_number_or_word(part.strip()) for part in text.split(",")]


def _number_or_word(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


@dataclass(frozen=True)
class Samples:
    """A `Design` of a sweep: variants with values from ranges and lists.

    Args:
        varied: keys with their ranges and lists.
        count: maximum number of variants; for a grid, number of values per range.
        is_grid: whether to use all combinations instead of a Latin hypercube without repetitions.
            If there are at most `count` combinations, all of them are used in both cases.
        seed: seed of the samples. The sensor noise has the seed of the scenario in all variants.

    Raises:
        UsageError: a key is varied twice.
    """

    varied: tuple[Vary, ...]
    count: int
    is_grid: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        keys = self.columns
        for key in keys:
            if keys.count(key) > 1:
                expected = "one range for each key"
                raise UsageError(Problem(f"--vary {key}", "is given twice", expected=expected))

    @property
    def columns(self) -> list[str]:
        return [vary.key for vary in self.varied]

    @cached_property
    def variants(self) -> list[dict[str, Any]]:
        if self.is_grid:
            return full_grid(self.varied, self.count)
        counts = [vary.count for vary in self.varied]
        if math.prod(counts) <= self.count:
            return full_grid(self.varied, self.count)
        drawn = latin_hypercube(self.varied, self.count, self.seed)
        return list({repr(values): values for values in drawn}.values())

    def cells(self, number: int) -> dict[str, Any]:
        return self.variants[number]

    def choices(self) -> list[dict[str, Any]]:
        """Returns the listed values that are not numbers, because they may be file names."""
        return [
            {vary.key: value}
            for vary in self.varied
            for value in vary.values
            if not isinstance(value, bool | int | float)
        ]

    def settings(self) -> dict[str, Any]:
        varied = {vary.key: vary.text for vary in self.varied}
        return {"vary": varied, "samples": self.count, "grid": self.is_grid, "seed": self.seed}

    def check(self, read: Callable[[Mapping[str, Any]], object], fixed: Mapping[str, Any]) -> None:
        """Raises SeroError if a varied key is fixed, or none of the first variants is valid."""
        for key in self.columns:
            if key in fixed:
                expected = "one of --vary and --set"
                raise UsageError(Problem(f"--vary {key}", "is also set", expected=expected))
        first: DeclarationError | None = None
        for values in self.variants[:_TRIED]:
            try:
                read(values)
            except DeclarationError as error:
                first = first or error
            else:
                return
        if first is not None:
            raise first
