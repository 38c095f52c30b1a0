"""Declarations that a command line fills in as well as Python.

A field of `Options` is an option `--its-name`; the docstring's "Attributes:" is its help.
`cli.options` builds the parser.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from .declaration import Declaration, expecting
from .errors import UsageError, shown


@dataclass(frozen=True)
class Option:
    """How a field is spelled in a command line, where its name and type do not say it.

    Attributes:
        metavar: what stands for its value in help; empty for its name in capitals.
        flags: all of its spellings, the long one last; none for `--` and the field's name.
        bare: its value where it is given without one; None where it needs one.
        is_positional: whether it is known by its place and has no spelling.
    """

    metavar: str = ""
    flags: tuple[str, ...] = ()
    bare: str | None = None
    is_positional: bool = False


def positional(metavar: str) -> Option:
    """How a field is spelled that is known by its place in the command line."""
    return Option(metavar, is_positional=True)


class Options(Declaration):
    """Base of what can be chosen in a command line, or in Python; fields take text as well.

    Attributes:
        title: of a section of help with the options of this class; empty for none of its own.
    """

    title: ClassVar[str] = ""
    model_config = ConfigDict(strict=False)

    @classmethod
    def taken_from(cls, others: Options) -> Self:
        """Returns what others have of these options."""
        shared = cls.model_fields.keys() & vars(others).keys()
        return cls(**{name: getattr(others, name) for name in shared})

    @classmethod
    def option(cls, name: str) -> Option:
        """Returns how a field is spelled, as far as it is declared."""
        found = cls.model_fields[name]
        marks = (*_metadata(found.annotation), *found.metadata)
        return ([each for each in marks if isinstance(each, Option)] or [Option()])[-1]

    @classmethod
    def spelled(cls, name: str) -> str:
        """Returns the long spelling of an option, or what stands for a positional one in help."""
        option = cls.option(name)
        if option.is_positional:
            return option.metavar or name
        return option.flags[-1] if option.flags else f"--{name.replace('_', '-')}"

    def given(self, *names: str) -> list[str]:
        """Returns how those of these options are spelled that are given."""
        return [self.spelled(name) for name in names if name in self.model_fields_set]

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Raises UsageError where one of these options is given: its name, and why not."""
        for spelled in self.given(*names):
            raise UsageError(f"{spelled}{why}")

    def apply(self) -> None:
        """Does what has to be done before the command runs whose options these are."""


def _metadata(kind: Any) -> Iterator[Any]:
    yield from getattr(kind, "__metadata__", ())
    for each in get_args(kind):
        yield from _metadata(each)


def ending(*endings: str, expected: str = "") -> AfterValidator:
    """Returns a validator for names of files that end in one of these; `expected` lists them."""

    def validate(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            wanted = expected or ", ".join(endings)
            raise ValueError(f"found '{path}'; expected a name that ends in {wanted}")
        return path

    return AfterValidator(validate)


def parted(separator: str) -> BeforeValidator:
    """Returns a validator for several values that text may have in one."""

    def validate(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        return [part.strip() for part in value.strip("[] ").lower().split(separator)]

    return BeforeValidator(validate)


def whole(least: int, most: int, words: str = "") -> WrapValidator:
    """Returns a validator for whole numbers in a range; `words` says which."""
    words = words or f"a whole number from {least} to {most}"

    def validate(value: Any, handler: ValidatorFunctionWrapHandler) -> int:
        try:
            number = int(handler(value))
        except ValidationError:
            number = least - 1
        if not least <= number <= most:
            raise ValueError(f"found {shown(value)}; expected {words}")
        return number

    return WrapValidator(validate)


Positive = Annotated[float, Field(gt=0), expecting("a number above 0")]
NotNegative = Annotated[float, Field(ge=0), expecting("0 or a number above")]
Duration = Annotated[Positive, Option("S")]
Time = Annotated[NotNegative, Option("S")]
Count = Annotated[int, whole(1, 10**15 - 1, "a whole number above 0"), Option("N")]
Seed = Annotated[int, whole(0, 2**32 - 1, "a whole number from 0"), Option("N")]
Port = Annotated[int, whole(1, 65535, "a port from 1 to 65535")]
_Length = Annotated[int, Field(gt=0)]
Size = Annotated[
    tuple[_Length, _Length], parted("x"), expecting("WIDTHxHEIGHT, e.g. 1280x800"), Option("WxH")
]
JointValues = Annotated[
    tuple[float, ...], parted(","), expecting("numbers with commas, e.g. 0,0.5,-1.2"), Option("Q")
]
