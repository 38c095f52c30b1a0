"""Converts declarations to options of the command line, and a command line to a declaration."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping
from dataclasses import replace
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from ..base.declaration import field_descriptions
from ..base.errors import DeclarationError
from ..base.options import Options

T = TypeVar("T", bound=Options)


def add_options(parser: argparse.ArgumentParser, kind: type[Options]) -> None:
    """Adds the options of a declaration to a parser, starting with options of the class itself.

    The parsed namespace contains strings, or lists of strings, of the options that are on the
    command line. `read_options` checks the values and sets the defaults.
    """
    about = field_descriptions(kind)
    # A field that a subclass declares again stays in the group of the first class.
    owners = {name: owner for owner in kind.__mro__ for name in inspect.get_annotations(owner)}
    for name in kind.model_fields:
        if kind.option(name).is_positional:
            _add(parser, kind, name, about.get(name, ""))
            del owners[name]
    for owner in kind.__mro__:
        title = owner.__dict__.get("title", "")
        to = parser.add_argument_group(title) if title else parser
        for name in kind.model_fields:
            if owners.get(name) is owner:
                _add(to, kind, name, about.get(name, ""))


def usage_of(kind: type[Options]) -> str:
    """Returns the positional arguments and required options of a declaration for a usage line."""
    words = []
    for name, field in kind.model_fields.items():
        option, word = kind.option(name), kind.spelled(name)
        if not option.is_positional:
            word = f"{option.flags[0] if option.flags else word} {option.metavar}"
        if get_origin(_bare(field.annotation)) is list:
            word += " ..."
        if field.is_required():
            words.append(word)
        elif option.is_positional:
            words.append(f"[{word}]")
    return " ".join(words)


def _add(to: Any, kind: type[Options], name: str, about: str) -> None:
    field, option = kind.model_fields[name], kind.option(name)
    bare = _bare(field.annotation)
    is_repeated = get_origin(bare) in (list, dict)
    how: dict[str, Any] = {"default": argparse.SUPPRESS, "help": _help(about, field.default)}
    if bare is bool:
        how |= {"action": "store_true"}
    elif get_origin(bare) is Literal:
        how |= {"metavar": f"{{{','.join(map(str, get_args(bare)))}}}"}
    elif option.metavar or not option.is_positional:
        how |= {"metavar": option.metavar or name.upper()}
    if option.bare is not None:
        how |= {"nargs": "?", "const": option.bare}
    if option.is_positional:
        optional = "*" if is_repeated else "?"
        required = "+" if is_repeated else None
        to.add_argument(name, nargs=required if field.is_required() else optional, **how)
        return
    if is_repeated:
        how |= {"action": "append"}
    flags = option.flags or [kind.spelled(name)]
    to.add_argument(*flags, dest=name, required=field.is_required(), **how)


def _bare(kind: Any) -> Any:
    if get_origin(kind) is Annotated:
        return _bare(get_args(kind)[0])
    kinds = [each for each in get_args(kind) if each is not NoneType]
    return _bare(kinds[0]) if len(kinds) < len(get_args(kind)) else kind


def _help(about: str, default: Any) -> str:
    text = about.removesuffix(".").replace("%", "%%")
    if "default" in text or default is None or isinstance(default, bool) or not str(default):
        return text
    if isinstance(default, float | str | int):
        return f"{text} (default: {default:{'g' if isinstance(default, float) else ''}})"
    if isinstance(default, tuple):
        return f"{text} (default: {'x'.join(map(str, default))})"
    return text


def read_options(kind: type[T], parsed: Mapping[str, Any]) -> T:
    """Converts a parsed command line to a declaration; raises DeclarationError if it is invalid."""
    try:
        return kind(**{name: parsed[name] for name in kind.model_fields if name in parsed})
    except DeclarationError as error:
        problems = [
            replace(problem, key=_spelled(kind, problem.key.partition(".")[0]))
            for problem in error.problems
        ]
        raise DeclarationError(problems) from None


def _spelled(kind: type[Options], name: str) -> str:
    return kind.spelled(name) if name in kind.model_fields else name
