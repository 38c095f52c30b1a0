"""Output of commands to a terminal, in which nothing from a file can control the terminal.

Everything is escaped in one place: what is printed, in the streams; what rich lays out and colors,
in its console, before it adds its own sequences for colors.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ..base.errors import printable

if TYPE_CHECKING:
    from rich.console import Console


class EscapedStream:
    """A text stream that writes control and invisible characters as escapes to `plain`."""

    def __init__(self, stream: Any) -> None:
        self.plain = stream

    def write(self, text: str) -> int:
        """Writes a text; returns its length."""
        self.plain.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Writes texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain, name)


def escape_output() -> None:
    """Lets standard output, standard error and tracebacks escape their text from here on."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and not isinstance(stream, EscapedStream):
            setattr(sys, name, EscapedStream(stream))
    sys.excepthook = _print_traceback


def plain(stream: Any) -> Any:
    """Returns the stream below an `EscapedStream`, or the stream itself."""
    return stream.plain if isinstance(stream, EscapedStream) else stream


def make_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """Returns a console of rich for standard output or standard error.

    It does not interpret its texts: neither as markup nor as emoji codes.
    """
    from rich.console import Console
    from rich.segment import Segment
    from rich.text import Text

    class EscapedConsole(Console):
        """Escapes all texts that it renders, but not its own sequences for colors."""

        def render_str(self, text: str, **how: Any) -> Text:
            # Before anything is laid out.
            return super().render_str(printable(text), **how)

        def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                text, style, control = segment
                yield segment if control else Segment(printable(text), style)

    return EscapedConsole(
        file=plain(sys.stderr if stderr else sys.stdout),
        width=width,
        markup=False,
        emoji=False,
        highlight=False,
    )


def _print_traceback(
    kind: type[BaseException], error: BaseException, frames: TracebackType | None
) -> None:
    # Without colors, which would be escaped.
    sys.stderr.write("".join(traceback.format_exception(kind, error, frames)))
