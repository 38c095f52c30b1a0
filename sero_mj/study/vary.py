"""`Vary`: which values a key of a scenario takes in a sweep."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

Array = NDArray[np.float64]

MAX_VARIANTS = 200_000  # their values and results are kept in memory, not their logs
_SCALES = ("log", "int")
_WHOLE = ("run.seed",)  # keys that take whole numbers only
_EXAMPLE = "expected KEY=LOW:HIGH, log:LOW:HIGH, int:LOW:HIGH or a list A,B,C"


@dataclass(frozen=True)
class Vary:
    """A key and its values: a range, or a list.

    Attributes:
        key: as `read_scenario(overrides=...)` takes it: `controllers.lwr.stiffness`.
        text: as it was given: `100:2000`.
        low: where the range begins.
        high: where it ends.
        scale: `linear`, `log` (evenly over the orders of magnitude) or `int` (whole numbers, both
            ends included).
        values: the list; empty where it is a range.
    """

    key: str
    text: str
    low: float = 0.0
    high: float = 0.0
    scale: str = "linear"
    values: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, option: str) -> Vary:
        """Reads `KEY=VALUES`.

        Raises:
            UsageError: it is neither a range nor a list.
        """
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
            message = f"found {low:g} to {high:g}; expected two numbers, the lower one first"
            raise UsageError(f"--vary {option}: {message}")
        if scale == "log" and low <= 0:
            raise UsageError(f"--vary {option}: found log from {low:g}; expected more than 0")
        if scale == "int" and (low % 1 or high % 1):
            raise UsageError(f"--vary {option}: found {text}; expected whole numbers")
        return cls(key, text, low, high, scale)

    @property
    def is_range(self) -> bool:
        """Whether it is a range."""
        return not self.values

    def at(self, shares: Array) -> list[Any]:
        """The values so far along the range or the list.

        Args:
            shares: (m,), from 0 to below 1.
        """
        if not self.is_range:
            return [self.values[int(share * len(self.values))] for share in shares]
        if self.scale == "int":
            count = self.high - self.low + 1
            return [int(self.low + math.floor(share * count)) for share in shares]
        return [self._between(float(share)) for share in shares]

    def grid(self, count: int) -> list[Any]:
        """So many values from end to end; of a list all of them."""
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
    """Samples in which every key takes values from all parts of its range alike.

    The range of a key is cut into as many parts as there are samples; each part has one sample,
    somewhere in it, and the orders of the keys are shuffled against each other.

    Args:
        varied: the keys and their ranges.
        samples: how many.
        seed: of all that is random.

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
    """Every value of every key with every value of all others; `count` in each range.

    Raises:
        UsageError: that are more than `MAX_VARIANTS`.
    """
    columns = [vary.grid(count) for vary in varied]
    many = math.prod(map(len, columns))
    if many > MAX_VARIANTS:
        sizes = " x ".join(str(len(column)) for column in columns)
        message = f"found {sizes} = {many} variants; expected up to {MAX_VARIANTS}"
        raise UsageError(f"--grid: {message}: fewer --samples, or no --grid")
    return _named(varied, itertools.product(*columns))


def _named(varied: Sequence[Vary], rows: Any) -> list[dict[str, Any]]:
    keys = [vary.key for vary in varied]
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _list(text: str) -> list[Any]:
    """Values with commas between them: TOML, or words."""
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
