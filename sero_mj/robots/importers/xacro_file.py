"""Expands xacro files without executing arbitrary Python code in them.

The package `xacro` passes expressions (`${...}`, `$(eval ...)`) to Python's `eval`. Here, the
package `simpleeval` interprets them. It supports arithmetic, comparisons, conditions, lists,
dictionaries, comprehensions, and the functions of xacro. Lambdas, f-strings, and attributes other
than dictionary entries and safe methods are errors. This module requires both packages.
"""

from __future__ import annotations

import ast
import io
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import xacro
from simpleeval import BASIC_ALLOWED_ATTRS, EvalWithCompoundTypes, FeatureNotAvailable
from xacro import substitution_args

_MAX_RANGE = 100_000
_REFUSED = ("type", "vars", "isinstance", "issubclass", "repr", "hash")
_METHODS = {
    str: BASIC_ALLOWED_ATTRS[str] - {"format", "format_map"},
    dict: {"get", "items", "keys", "values", "copy"},
    list: {"index", "count", "copy"},
    tuple: {"index", "count"},
    float: {"is_integer"},
}
# This lock serializes calls, because xacro has global state and is patched globally.
_LOCK = threading.Lock()


def expand(path: Path, arguments: Mapping[str, str], find: Callable[[str], str]) -> str:
    """Expands a xacro file to XML text. Exceptions of xacro are not converted.

    `find` is a function that returns the folder of a ROS package, for `$(find NAME)`.
    """
    output = io.StringIO()
    with _LOCK, _without_python(find), redirect_stderr(output), redirect_stdout(output):
        return str(xacro.process_file(str(path), mappings=arguments).toxml())


@contextmanager
def _without_python(find: Callable[[str], str]) -> Iterator[None]:
    def evaluate(text: str, names: Mapping[str, Any], locals: object = None) -> Any:
        return _Interpreter(names).eval(text.strip())

    def substitute(text: str, context: dict[str, Any]) -> str:
        arguments = context.setdefault("arg", {})

        def argument(name: str) -> Any:
            value = substitution_args._eval_arg(name, args=arguments)
            return substitution_args.convert_value(value, "auto")

        own = {
            **substitution_args._eval_dict,
            "arg": argument,
            "dirname": lambda: substitution_args._eval_dirname(context["filename"]),
        }
        return str(evaluate(text, _Names(own, arguments, argument)))

    patched: list[tuple[Any, str, Any]] = [
        (xacro, "safe_eval", evaluate),
        (substitution_args, "_eval", substitute),
        (substitution_args, "_eval_find", find),
    ]
    before = [getattr(module, name, None) for module, name, _ in patched]
    for module, name, value in patched:
        setattr(module, name, value)
    try:
        yield
    finally:
        for (module, name, _), value in zip(patched, before, strict=True):
            setattr(module, name, value)


class _Names(Mapping[str, Any]):
    """The names available in an expression. Arguments are evaluated only when they are used."""

    def __init__(
        self,
        functions: Mapping[str, Any],
        arguments: Mapping[str, Any],
        argument: Callable[[str], Any],
    ) -> None:
        self._functions, self._arguments, self._argument = functions, arguments, argument

    def __contains__(self, name: object) -> bool:
        return name in self._functions or name in self._arguments

    def __getitem__(self, name: str) -> Any:
        return self._functions[name] if name in self._functions else self._argument(name)

    def __iter__(self) -> Iterator[str]:
        return iter([*self._functions, *self._arguments])

    def __len__(self) -> int:
        return len(self._functions) + len(self._arguments)


class _Interpreter(EvalWithCompoundTypes):  # type: ignore[misc]  # has no types
    def __init__(self, names: Mapping[str, Any]) -> None:
        super().__init__(names=names, functions={})
        self.functions = _Functions(names)
        del self.nodes[ast.JoinedStr], self.nodes[ast.FormattedValue]

    def _eval_name(self, node: ast.Name) -> Any:
        if node.id.startswith("_") or node.id not in self.names:
            raise NameError(f"name '{node.id}' is not defined")
        return self.names[node.id]

    def _eval_attribute(self, node: ast.Attribute) -> Any:
        value = self._eval(node.value)
        if isinstance(value, Mapping) and node.attr in value:
            if node.attr in _REFUSED:
                raise FeatureNotAvailable(f"{node.attr}() is not available")
            return range_up_to if node.attr == "range" else value[node.attr]
        for kind, methods in _METHODS.items():
            if isinstance(value, kind) and node.attr in methods:
                return getattr(value, node.attr)
        raise FeatureNotAvailable(f"{type(value).__name__} has no '{node.attr}' here")


class _Functions(dict[str, Any]):
    def __init__(self, names: Mapping[str, Any]) -> None:
        super().__init__()
        self._names = names

    def __missing__(self, name: str) -> Any:
        if name in _REFUSED or name.startswith("_") or name not in self._names:
            raise KeyError(name)
        return range_up_to if name == "range" else self._names[name]


def range_up_to(*limits: int) -> range:
    """Returns a `range`. Raises ValueError if its list could exhaust the memory."""
    found = range(*limits)
    if len(found) > _MAX_RANGE:
        raise ValueError(f"found a range of {len(found)} numbers; expected at most {_MAX_RANGE}")
    return found
