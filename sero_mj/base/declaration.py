"""Base class of everything that files declare.

A declaration is a pydantic model that rejects unknown keys. It converts all errors of its fields to
`Problem`s, which state the value that was found and the value that was expected.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    get_args,
    get_origin,
)

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from .errors import DeclarationError, Problem, mismatch, problems_of
from .frames import Array, frame_from

LARGEST = 1e9  # larger than any length, angle, torque or mass of a robot in SI units

if TYPE_CHECKING:

    class _Model:
        """`BaseModel` for type checkers, with arbitrary keyword arguments.

        Without this class, type checkers would reject lists as values of array fields, and would
        require fields whose default is a positional argument.
        """

        model_config: ClassVar[ConfigDict]
        model_fields: ClassVar[dict[str, FieldInfo]]
        model_fields_set: set[str]
        __pydantic_fields_set__: set[str]

        def __init__(self, /, **fields: Any) -> None: ...
        def model_copy(
            self, *, update: Mapping[str, Any] | None = None, deep: bool = False
        ) -> Self: ...

        def model_dump(self, **options: Any) -> dict[str, Any]: ...

else:
    _Model = BaseModel
T = TypeVar("T")


class Declaration(_Model):
    """Base class of everything that can be declared in a file or created in Python.

    Attributes:
        renamed: mapping from earlier field names, which files may still use, to current names.
        checked_alone: fields whose validity depends on no other field. Setting one of them
            validates only this field.

    Raises:
        DeclarationError: a field is invalid. The error contains one `Problem` per invalid field.
    """

    renamed: ClassVar[Mapping[str, str]] = {}
    checked_alone: ClassVar[Collection[str]] = ()
    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        arbitrary_types_allowed=True,
        validate_default=True,
        populate_by_name=True,
        allow_inf_nan=False,
        defer_build=True,  # a run uses few of the classes: this saves 0.1 s at start-up
    )

    def __init__(self, /, **fields: Any) -> None:
        for old in self.renamed.keys() & fields.keys():
            fields.setdefault(self.renamed[old], fields.pop(old))
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise _declaration_error(error, type(self)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        """Sets and validates a field. If the value is invalid, the declaration does not change."""
        if name.startswith("_"):
            super().__setattr__(name, value)
            return
        kind: Any = type(self)
        if name in self.checked_alone:
            try:
                checked = _validator_of(kind, name).validate_python(value)
            except ValidationError as error:
                problems = _declaration_error(error, kind).problems
                raise DeclarationError([each.inside(name) for each in problems]) from None
            self.__dict__[name] = checked
        else:
            current = {key: self.__dict__[key] for key in kind.model_fields}
            # A field in degrees is None after its conversion to radians.
            fields = {k: v for k, v in current.items() if v is not None or not k.endswith("_deg")}
            if name.endswith("_deg"):
                fields.pop(name.removesuffix("_deg"), None)
            whole = kind(**{**fields, name: value})
            self.__dict__.clear()  # also removes cached properties
            self.__dict__.update(whole.__dict__)
        self.__pydantic_fields_set__.add(name)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Returns a copy with some fields replaced, without validating them."""
        copied: Self = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]  # a cached property
        return copied


@cache
def _validator_of(kind: type[Declaration], name: str) -> TypeAdapter[Any]:
    field = kind.model_fields[name]
    annotated: Any = Annotated[field.annotation, field]
    return TypeAdapter(annotated, config=kind.model_config)


def _declaration_error(error: ValidationError, kind: type[Declaration]) -> DeclarationError:
    details = error.errors(include_url=False)
    return DeclarationError([each for detail in details for each in _problems(detail, kind)])


def field_descriptions(declaration: type[Declaration]) -> dict[str, str]:
    """Returns the field descriptions in the docstrings of a declaration class and its bases."""
    found: dict[str, str] = {}
    for kind in reversed(declaration.__mro__):
        text = inspect.cleandoc(kind.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
        found |= dict(re.findall(r"^    (\w+): ((?:.|\n {8})*)", text, re.MULTILINE))
    return {name: re.sub(r"\s+", " ", about) for name, about in found.items()}


def expecting(what: str) -> WrapValidator:
    """Returns a validator whose error message describes the expected value as `what`."""

    def validate(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise mismatch(value, what) from None

    return WrapValidator(validate)


def numbers(value: Any) -> Array:
    """Converts a value to a float64 array of finite numbers.

    Raises ValueError if a value is NaN, infinite, too large, or not a number.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError("expected rows of equal length") from None
    if array.dtype.kind not in "iuf" and array.size:
        raise mismatch(value, "numbers")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise mismatch(value, "finite numbers without NaN or inf")
    if (np.abs(array) > LARGEST).any():
        raise mismatch(value, f"numbers up to {LARGEST:g}")
    return array


def of_shape(*shape: int | None) -> BeforeValidator:
    """Returns a validator for arrays of a shape, in which None stands for any length.

    A flat list, such as `dhParams` in the paper, is split into rows if possible.
    """
    names = iter("nm") if len(shape) > 1 and None in shape[1:] else iter("nn")
    wanted = " x ".join(next(names) if length is None else str(length) for length in shape)

    def validate(value: Any) -> Any:
        if value is None:
            return None
        array = numbers(value)
        if len(shape) == 2 and array.ndim == 1 and shape[1] and array.size % shape[1] == 0:
            array = array.reshape(-1, shape[1])
        fits = array.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            found = " x ".join(map(str, array.shape)) or "one number"
            raise ValueError(f"found {found}; expected {wanted} numbers")
        return array

    return BeforeValidator(validate)


def _in_range(rgba: Array) -> Array:
    if (rgba < 0).any() or (rgba > 1).any():
        raise mismatch(rgba, "four numbers from 0 to 1")
    return rgba


def is_name(text: str) -> str:
    """Returns the text if it is a valid name of a robot, source or object.

    Raises ValueError if it contains invalid characters.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_-]*", text):
        raise mismatch(text, "a name of letters, digits, _ and - that begins with a letter or _")
    return text


def _frame(value: Any) -> Any:
    return frame_from(value, numbers)


Vector = Annotated[Array, of_shape(None)]
Point = Annotated[Array, of_shape(3)]
Rgba = Annotated[Array, of_shape(4), AfterValidator(_in_range)]
Name = Annotated[str, AfterValidator(is_name)]
# 4 x 4 numbers, or a table of xyz and an orientation.
Frame = Annotated[Array, BeforeValidator(_frame, json_schema_input_type=list[Any] | dict[str, Any])]


def _problems(detail: ErrorDetails, kind: type[Declaration]) -> list[Problem]:
    key = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "value_error":
        cause = detail["ctx"]["error"]  # empty if it is reported under another key
        return problems_of(cause, key) if str(cause) else []
    problem = _PROBLEMS.get(detail["type"], _plain)(detail, kind)
    return [replace(problem, key=key)]


def _plain(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    expected = detail["msg"].replace("Input should be ", "").removeprefix("a valid ")
    if "dictionary" in expected:
        expected = "a table"
    if expected == "boolean":
        expected = "true or false"
    if expected == "integer" and isinstance(detail["input"], float):
        expected = "an integer without a decimal point"
    return Problem(found=detail["input"], expected=expected)


def _unknown_key(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    names = {field.alias or name for name, field in kind.model_fields.items()}
    return Problem(reason="unknown key", available=names)


def _missing(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    field = kind.model_fields.get(str(detail["loc"][-1]))
    literal = field is not None and get_origin(field.annotation) is Literal
    choices = [repr(choice) for choice in get_args(field.annotation)] if field and literal else []
    return Problem(reason="is required", expected=" or ".join(choices) or None)


def _literal(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    found, expected = detail["input"], detail["ctx"]["expected"]
    choices = [choice.strip("' ") for choice in expected.replace(" or ", ",").split(",")]
    near = choices if isinstance(found, str) else None
    return Problem(found=found, expected=expected, available=near)


def _too_short(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    minimum = detail["ctx"]["min_length"]
    entries = "1 entry" if minimum == 1 else f"{minimum} entries"
    return Problem(found=detail["input"], expected=f"{entries} or more")


def _too_long(detail: ErrorDetails, kind: type[Declaration]) -> Problem:
    found, maximum = detail["ctx"]["actual_length"], detail["ctx"]["max_length"]
    return Problem(found=found, of="entries", expected=f"at most {maximum}")


_PROBLEMS: dict[str, Callable[[ErrorDetails, type[Declaration]], Problem]] = {
    "extra_forbidden": _unknown_key,
    "missing": _missing,
    "literal_error": _literal,
    "too_short": _too_short,
    "too_long": _too_long,
}


def by_kind(table: Any, kinds: Mapping[str, type[T]], base: type[T]) -> T:
    """Creates the declaration of the class in `kinds` that the `kind` of a table selects.

    If the table is an instance of `base`, it is returned unchanged. Raises DeclarationError if the
    kind is unknown, or if fields are invalid.
    """
    return table if isinstance(table, base) else kinds[kind_of(table, kinds)](**table)


def file_fields(kind: type[Declaration]) -> list[str]:
    """Returns the names of the fields of type `Path`, which contain file names."""
    return [
        name
        for name, field in kind.model_fields.items()
        if Path in (field.annotation, *get_args(field.annotation))
    ]


def kind_of(table: Any, kinds: Collection[str]) -> str:
    """Returns the `kind` of a table.

    Raises DeclarationError if the argument is not a table, or its kind is missing or unknown.
    """
    if not isinstance(table, Mapping):
        raise mismatch(table, "a table with `kind`")
    kind = table.get("kind")
    if isinstance(kind, str) and kind in kinds:
        return kind
    if kind is None:
        *others, last = map(repr, kinds)
        raise Problem("kind", "is required", expected=f"{', '.join(others)} or {last}").error()
    raise Problem("kind", "no kind", found=kind, available=kinds).error()


def changed_fields(declaration: Declaration, *excluded: str) -> dict[str, Any]:
    """Returns the fields without default values, except for `excluded`, as types of TOML."""
    changed = {}
    for key, field in type(declaration).model_fields.items():
        value = getattr(declaration, key)
        default = field.get_default(call_default_factory=True)
        if key not in excluded and plain(value) != plain(default):
            changed[key] = plain(value)
    return changed


def plain(value: Any) -> Any:
    """Converts arrays to lists, and declarations to the tables of their changed fields."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return changed_fields(value) if hasattr(type(value), "model_fields") else value
