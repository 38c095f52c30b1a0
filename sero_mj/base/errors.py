"""All exceptions of sero-mj. Each one is a `SeroError`.

An exception stores the invalid values as attributes and generates its text from them, so that the
same error has the same message everywhere.
"""

from __future__ import annotations

import difflib
import logging
import re
import reprlib
import sys
import traceback
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, replace
from datetime import date, time
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

_MAX_SHOWN = 60  # characters shown before and after an error in a long text
_MAX_TEXT = 200  # characters shown of a text that is invalid as a whole
_MAX_ENTRIES = 6  # entries shown of a table or list
_VERB = re.compile(
    r"(is|are|was|has|does|can|cannot|requires|needs|lacks|belongs|begins|contains|already)\b"
)


def nearest(name: str, available: Iterable[str]) -> str | None:
    """Returns the most similar available name, or None if no name is similar."""
    by_lower = {candidate.lower(): candidate for candidate in available}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[close[0]] if close else None


def reason_of(error: Exception) -> str:
    """Returns the message of an error. For an OSError, omits the error number and the file name."""
    if isinstance(error, KeyError):
        return f"has no {error}"
    return getattr(error, "strerror", None) or str(error)


def did_you_mean(name: str, available: Iterable[str]) -> str:
    """Returns a suggestion such as `; did you mean 'x'?`, or a list of the available names."""
    names = list(available)
    near = nearest(name, names)
    if near is not None:
        return f"; did you mean '{near}'?"
    if not names:
        return "; none is available"
    shown = ", ".join(sorted(names)[:40])
    return f"; available: {shown}"


def first_of(names: Sequence[str], count: int = 8) -> str:
    """Returns the first `count` names separated by commas, and the number of remaining names."""
    more = f" and {len(names) - count} more" if len(names) > count else ""
    return ", ".join(names[:count]) + more


@contextmanager
def without_warnings() -> Iterator[None]:
    """Context manager that suppresses warnings, for data that is read a second time."""
    log = logging.getLogger("sero_mj")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def located(place: str, message: str) -> str:
    """Returns the message after its place, as in `a.toml: found 2` or `a.toml is empty`."""
    is_sentence = _VERB.match(message) and not re.search(r":\d+$", place)
    return f"{place}{'' if is_sentence else ':'} {message}" if place else message


def printable(text: str) -> str:
    r"""Returns a text whose invisible characters are escaped, for example `\x1b`.

    This applies to control characters except newline and tab, to characters without a width, and to
    characters that change the writing direction.
    """
    if text.replace("\n", "").replace("\t", "").isprintable():
        return text
    return "".join(
        each if each in "\n\t" or each.isprintable() or unicodedata.category(each) == "Zs"
        else each.encode("unicode_escape").decode("ascii")
        for each in text
    )  # fmt: skip


def in_one_line(text: str) -> str:
    r"""Returns a printable text in which line breaks are escaped as `\n`."""
    return printable(text).replace("\n", r"\n").replace("\t", r"\t")


def shown(value: object, depth: int = 3) -> str:
    """Formats a value for messages, in TOML notation, and shortens long values.

    Arrays are formatted as lists, None as `nothing`, and objects of other types as the name of
    their class. Tables and lists are formatted up to `depth` nested levels.
    """
    value = value.tolist() if hasattr(value, "tolist") else value
    match value:
        case None:
            text = "nothing"
        case bool():
            text = str(value).lower()
        case float():
            text = f"{value:g}"
        case int():
            text = reprlib.repr(value)
        case str():
            text = repr(value)[:_MAX_TEXT]
        case Path():
            text = f"'{value}'"
        case date() | time():
            text = value.isoformat()
        case bytes() | bytearray() | memoryview():
            text = f"{len(value)} bytes"
        case Mapping():
            entries = (f"{key} = {shown(each, depth - 1)}" for key, each in value.items())
            text = f"{{{_shortened(entries, len(value), depth)}}}"
        case list() | tuple() | set() | frozenset():
            entries = (shown(each, depth - 1) for each in value)
            text = f"[{_shortened(entries, len(value), depth)}]"
        case type():
            text = f"the class {value.__name__}"
        case _:
            text = f"an object of {type(value).__name__}"
    return text


def _shortened(entries: Iterable[str], count: int, depth: int) -> str:
    maximum = _MAX_ENTRIES if depth > 0 else 0
    return ", ".join([*islice(entries, maximum), *["..."] * (count > maximum)])


class SeroError(Exception):
    """Base class of all exceptions of sero-mj, which can be pickled and have a printable text."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(printable(each) if isinstance(each, str) else each for each in args))

    def __reduce__(self) -> tuple[Callable[..., SeroError], tuple[object, ...]]:
        """Pickles text and attributes instead of arguments, which differ between subclasses."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(
    kind: type[SeroError], args: tuple[object, ...], attributes: dict[str, object]
) -> SeroError:
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(attributes)
    return error


@dataclass(frozen=True, eq=False)
class Problem:
    """An error in a declaration. Problems with the same message and value are equal.

    The message is built from the attributes. For example, `found=2`, `of="numbers"` and
    `expected=3` result in `found 2 numbers; expected 3`.

    Attributes:
        key: dotted key, for example `robots.lwr.dh_params`; empty for the whole file.
        reason: description of the error, which precedes the invalid value (default: `found`).
        file: name of the file; None for declarations in Python.
        line: line number in the file, or None if unknown.
        found: invalid value, or None if the message contains no value.
        of: text after the invalid value, for example its unit.
        expected: description of a valid value, or the valid value itself.
        available: valid names to suggest instead of `found`, or of the key if `found` is None.
    """

    key: str = ""
    reason: str = ""
    file: str | None = None
    line: int | None = None
    _: KW_ONLY
    found: object = None
    of: str = ""
    expected: object = None
    available: Collection[str] | None = None

    @property
    def message(self) -> str:
        """Description of the error with the invalid and the expected value, but no location."""
        message = self.reason or "found"
        if self.found is not None or not self.reason:
            message += f" {shown(self.found)}"
        message += f" {self.of}" if self.of else ""
        message += f"; expected {self.expected}" if self.expected is not None else ""
        if self.available is None or (self.expected is not None and self.near is None):
            return message
        return message + did_you_mean(self._name, self.available)

    @property
    def near(self) -> str | None:
        return nearest(self._name, self.available or ())

    @property
    def _name(self) -> str:
        return self.key.rpartition(".")[2] if self.found is None else str(self.found)

    def __str__(self) -> str:
        place = self.file or ""
        if place and self.line is not None:
            place += f":{self.line}"
        message = located(self.key, self.message)
        return printable(f"{place}: {message}" if place and self.key else located(place, message))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Problem) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    @property
    def _identity(self) -> tuple[str, str, str]:
        return str(self), shown(self.found), str(self.expected)  # `found` may be an array

    def inside(self, prefix: str) -> Problem:
        key = f"{prefix}.{self.key}" if self.key and prefix else prefix or self.key
        return replace(self, key=key)

    def error(self) -> DeclarationError:
        """Returns a `DeclarationError` with only this problem."""
        return DeclarationError([self])


class DeclarationError(SeroError, ValueError):
    """An invalid declaration. `problems` lists all errors, sorted by line within each file."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        files = list(dict.fromkeys(problem.file for problem in problems))
        # Problems without a line remain in the order of detection.
        self.problems = sorted(
            problems, key=lambda each: (files.index(each.file), each.line or sys.maxsize)
        )
        super().__init__("\n".join(str(problem) for problem in self.problems))


def mismatch(
    found: object, expected: object, reason: str = "", *, key: str = "", of: str = ""
) -> DeclarationError:
    """Returns a `DeclarationError` for one value, such as `found 2 numbers; expected 3`."""
    return DeclarationError([Problem(key, reason, found=found, of=of, expected=expected)])


def raise_any(problems: Sequence[Problem]) -> None:
    """Raises DeclarationError if there are any problems."""
    if problems:
        raise DeclarationError(problems)


def problems_of(error: Exception, key: str = "") -> list[Problem]:
    """Converts an error to problems whose keys begin with `key`."""
    if isinstance(error, DeclarationError):
        return [problem.inside(key) for problem in error.problems]
    if isinstance(error, UnknownName) and not error.hint:
        noun, owner = _split(error.kind)
        known = error.available
        return [Problem(key, f"no {noun}", found=error.name, of=owner.lstrip(), available=known)]
    return [Problem(key, str(error))]


@contextmanager
def collect(problems: list[Problem], key: str) -> Iterator[None]:
    """Context manager that adds the problems of a raised `DeclarationError` to a list."""
    try:
        yield
    except DeclarationError as error:
        problems += problems_of(error, key)


def _split(kind: str) -> tuple[str, str]:
    """Returns a noun and its complement, for example `input` and ` of lwr`."""
    noun, space, complement = re.split(r"( (?=(?:of|in) )|$)", kind, maxsplit=1)
    return noun, space + complement


class UnknownName(SeroError, KeyError):
    """A name that does not exist, for example the name of a camera."""

    def __init__(self, kind: str, name: str, available: Iterable[str], hint: str = "") -> None:
        self.kind = kind
        self.name = name
        self.available = sorted(set(available))
        self.near = nearest(name, self.available)
        self.hint = hint
        noun, owner = _split(kind)
        super().__init__(f"no {noun} '{name}'{owner}{hint or did_you_mean(name, self.available)}")

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError would print the repr


class StructureError(SeroError, ValueError):
    """An invalid packet structure string."""

    def __init__(self, structure: str, position: int, reason: str) -> None:
        self.structure = structure
        self.position = position
        self.reason = reason
        super().__init__(f"structure {_pointing(structure, position, 1)}, {reason}")


class RouteError(SeroError, ValueError):
    """An invalid expression in a route."""

    def __init__(self, text: str, position: int, reason: str, length: int = 1) -> None:
        self.text = text
        self.position = position
        self.reason = reason
        super().__init__(f"{_pointing(text, position, length)}, {reason}")


def _pointing(text: str, position: int, length: int) -> str:
    end = min(position + length, position + _MAX_SHOWN)
    found = f"'{text[position:end]}'" if position < len(text) else "the end"
    first, last = max(position - _MAX_SHOWN, 0), end + _MAX_SHOWN
    if last - first < len(text) - 2 * _MAX_SHOWN:
        text = f"{'...' * (first > 0)}{text[first:last]}{'...' * (last < len(text))}"
    return f"'{text}', character {position + 1}: found {found}"


class _ProblemError(SeroError):
    def __init__(self, problem: Problem | str, place: str = "") -> None:
        self.problem = problem if isinstance(problem, Problem) else Problem("", problem)
        super().__init__(located(place, str(self.problem)))


class SourceError(_ProblemError, OSError):
    """A source that cannot be opened."""

    def __init__(self, source: str, reason: Problem | str) -> None:
        super().__init__(reason, f"source '{source}'")
        self.source = source
        self.reason = str(self.problem)


class RecordingError(_ProblemError, OSError):
    """A recording that cannot be read or written.

    Attributes:
        needs_scene: whether the recording can be read if a scene is passed.
    """

    def __init__(self, path: object, reason: Problem | str, *, needs_scene: bool = False) -> None:
        super().__init__(reason, str(path))
        self.path = str(path)
        self.needs_scene = needs_scene
        self.reason = str(self.problem)


class CsvError(_ProblemError, ValueError):
    """A CSV file that cannot be read or written. Lines are counted from 1."""

    def __init__(
        self,
        path: object,
        reason: Problem | str,
        *,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        place = str(path) if line is None else f"{path}:{line}"
        super().__init__(reason, f"{place}: {column}" if column else place)
        self.path = str(path)
        self.reason = str(self.problem)
        self.line = line
        self.column = column


class SimulationError(_ProblemError, RuntimeError):
    """A simulation that cannot continue. Data recorded up to this point is preserved.

    Attributes:
        joint: name of the joint or other element that caused the error, for example `lwr/A3`.
    """

    def __init__(self, time: float, joint: str, reason: Problem | str) -> None:
        super().__init__(reason, f"{joint} at {time:.4f} s")
        self.time = time
        self.joint = joint
        self.reason = str(self.problem)


class NotTrusted(SeroError, PermissionError):
    """A request for actions in a file that is not trusted, see `base.trust`."""

    def __init__(self, file: Path, actions: list[str]) -> None:
        self.file, self.actions = file, actions
        super().__init__(
            f"{file} requests to {' and to '.join(actions)}, but this file is not trusted. "
            f"Run `sero-mj simulate {file}` to trust it"
        )


class RenderError(_ProblemError, RuntimeError):
    """An image that cannot be rendered or written, for example because OpenGL is unavailable."""


class ClusterError(_ProblemError, ConnectionError):
    """A cluster that is unreachable, or whose workers differ from this machine."""

    def __init__(self, address: str, reason: Problem | str) -> None:
        super().__init__(reason, address)
        self.address = address
        self.reason = str(self.problem)


def about_fault(error: Exception, kind: type) -> str:
    """Returns the type, text and location of an error raised by third-party code.

    The location is the innermost line of the traceback in the file of the class `kind`.
    """
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == file]
    place = f" ({file}:{lines[-1]})" if lines else ""
    return f"{type(error).__name__}: {error}{place}"


class PluginError(SeroError):
    """An entry point that cannot be loaded."""

    def __init__(self, group: str, point: EntryPoint, cause: Exception) -> None:
        self.group, self.point = group, point
        package = "?" if point.dist is None else f"{point.dist.name} {point.dist.version}"
        super().__init__(
            f"{group}: '{point.name}' of {package} ({point.value}) cannot be loaded: "
            f"{type(cause).__name__}: {cause}"
        )


class UsageError(_ProblemError, ValueError):
    """An invalid command line. The exit status is 2."""
