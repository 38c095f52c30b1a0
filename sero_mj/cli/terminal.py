"""Escapes the output of commands, so that text from files cannot control the terminal.

Streams escape printed text. The rich console escapes text before colors are added.
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
    """A wrapper of a text stream that escapes control and invisible characters.

    Attributes:
        plain: wrapped stream.
    """

    def __init__(self, stream: Any) -> None:
        self.plain = stream

    def write(self, text: str) -> int:
        self.plain.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain, name)


def escape_output() -> None:
    """Escapes all further text on standard output and standard error, including tracebacks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and not isinstance(stream, EscapedStream):
            setattr(sys, name, EscapedStream(stream))
    sys.excepthook = _print_traceback


def plain(stream: Any) -> Any:
    """Returns the stream that an `EscapedStream` wraps, or any other stream unchanged."""
    return stream.plain if isinstance(stream, EscapedStream) else stream


def make_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """Returns a rich console that interprets neither markup nor emoji codes."""
    from rich.console import Console
    from rich.segment import Segment
    from rich.text import Text

    class EscapedConsole(Console):
        def render_str(self, text: str, **how: Any) -> Text:
            # The text is escaped before the layout, because escapes change its length.
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
    # Colors are omitted, because their control sequences would be escaped.
    sys.stderr.write("".join(traceback.format_exception(kind, error, frames)))
