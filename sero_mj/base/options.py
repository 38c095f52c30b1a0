"""Base class of the options of commands, which can also be set in Python.

The field `some_name` becomes the option `--some-name`, and its description under "Attributes:" in
the docstring becomes the help text. `cli.options` creates the parser.
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
    """Command-line form of a field of `Options`, if it differs from the default form.

    Attributes:
        metavar: placeholder of the value in help texts (default: field name in capital letters).
        flags: all names of the option, the long name last (default: `--` and the field name).
        bare: value of the option if it has no argument; None if it requires an argument.
        is_positional: whether the field is a positional argument.
    """

    metavar: str = ""
    flags: tuple[str, ...] = ()
    bare: str | None = None
    is_positional: bool = False


def positional(metavar: str) -> Option:
    """Returns the command-line form of a positional argument."""
    return Option(metavar, is_positional=True)


class Options(Declaration):
    """Base class of options that are set on the command line or in Python.

    Fields also accept their values as text.

    Attributes:
        title: title of the help section for these options; empty if there is no section.
    """

    title: ClassVar[str] = ""
    model_config = ConfigDict(strict=False)

    @classmethod
    def taken_from(cls, others: Options) -> Self:
        """Creates options of this class, with the values of the fields that `others` also has."""
        shared = cls.model_fields.keys() & vars(others).keys()
        return cls(**{name: getattr(others, name) for name in shared})

    @classmethod
    def option(cls, name: str) -> Option:
        """Returns the command-line form of a field."""
        found = cls.model_fields[name]
        marks = (*_metadata(found.annotation), *found.metadata)
        return ([each for each in marks if isinstance(each, Option)] or [Option()])[-1]

    @classmethod
    def spelled(cls, name: str) -> str:
        """Returns the long name of an option, or the placeholder of a positional argument."""
        option = cls.option(name)
        if option.is_positional:
            return option.metavar or name
        return option.flags[-1] if option.flags else f"--{name.replace('_', '-')}"

    def set_among(self, *names: str) -> list[str]:
        """Returns the command-line names of the listed options that were set."""
        return [self.spelled(name) for name in names if name in self.model_fields_set]

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Raises UsageError if one of the named options was set; `why` completes its message."""
        for spelled in self.set_among(*names):
            raise UsageError(f"{spelled}{why}")

    def apply(self) -> None:
        """Called before the command runs."""


def _metadata(kind: Any) -> Iterator[Any]:
    yield from getattr(kind, "__metadata__", ())
    for each in get_args(kind):
        yield from _metadata(each)


def ending(*endings: str, expected: str = "") -> AfterValidator:
    """Returns a validator for file name extensions, which `expected` describes in errors."""

    def validate(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            wanted = expected or ", ".join(endings)
            raise ValueError(f"found '{path}'; expected a name that ends in {wanted}")
        return path

    return AfterValidator(validate)


def split_at(separator: str) -> BeforeValidator:
    """Returns a validator that splits a text at a separator into several values."""

    def validate(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        return [part.strip() for part in value.strip("[] ").lower().split(separator)]

    return BeforeValidator(validate)


def whole(minimum: int, maximum: int, words: str = "") -> WrapValidator:
    """Returns a validator for integers in a range, which `words` describes in errors."""
    words = words or f"a whole number from {minimum} to {maximum}"

    def validate(value: Any, handler: ValidatorFunctionWrapHandler) -> int:
        try:
            number = int(handler(value))
        except ValidationError:
            number = minimum - 1
        if not minimum <= number <= maximum:
            raise ValueError(f"found {shown(value)}; expected {words}")
        return number

    return WrapValidator(validate)


Positive = Annotated[float, Field(gt=0), expecting("a number above 0")]
NotNegative = Annotated[float, Field(ge=0), expecting("a number of 0 or more")]
Duration = Annotated[Positive, Option("S")]
Time = Annotated[NotNegative, Option("S")]
Count = Annotated[int, whole(1, 10**15 - 1, "a whole number above 0"), Option("N")]
Seed = Annotated[int, whole(0, 2**32 - 1, "a whole number of 0 or more"), Option("N")]
Port = Annotated[int, whole(1, 65535, "a port from 1 to 65535")]
_Length = Annotated[int, Field(gt=0)]
Size = Annotated[
    tuple[_Length, _Length], split_at("x"), expecting("WIDTHxHEIGHT, e.g. 1280x800"), Option("WxH")
]
_JOINT_VALUES = expecting("numbers separated by commas, e.g. 0,0.5,-1.2")
JointValues = Annotated[tuple[float, ...], split_at(","), _JOINT_VALUES, Option("Q")]
