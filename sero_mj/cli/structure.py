"""`sero-mj structure`: what a structure string means, and what comes in on a port."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, model_validator

from ..base.declaration import expecting
from ..base.errors import StructureError
from ..base.options import Count, Duration, Option, Port, Positive, positional
from .arguments import command, print_json, read_scene
from .shared_options import Flag, JsonOptions
from .terminal import make_console

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from ..data.receive.language import Item
    from ..data.receive.sniffer import Guess, Sniffer, Stream
    from ..data.receive.structure import Structure

_REFRESH = 0.25  # s between two pictures of a terminal
_TELL_EVERY = 2.0  # s between two lines about a stream where there is no terminal
_FIRST_NUMBERS = 4  # of an event
_HELP = """\
examples:
  sero-mj structure 7F7F                    offsets, types, events, size
  sero-mj structure --scene lwr_contact     the packets that a scene expects
  sero-mj structure 7F1M --sniff 32000      the packets that arrive, and their values

A port can be listened to by one program only: close the viewer while you sniff. Ctrl-C ends it
with a summary.
"""
GROUP, ORDER = "receive", 26


class StructureOptions(JsonOptions):
    """Explain a packet layout, or show what a port gets.

    Attributes:
        structure: layout of a packet, e.g. 7F1M.
        scene: layouts of this scene's sources instead.
        float32: F, V, M and T are float32.
        row_major: matrices come row by row.
        alignment: of every item, bytes.
        scale: factor on floating-point numbers.
        sniff: show what arrives there.
        host: address to listen on (default 127.0.0.1); 0.0.0.0 for all interfaces.
        interface: network interface on which a multicast group is joined.
        duration: sniff for so long, s.
        count: sniff so many packets.
        language: print the page about the language.
    """

    structure: Annotated[str | None, positional("STRUCTURE")] = None
    scene: str | None = None
    float32: bool = False
    row_major: bool = False
    alignment: Annotated[Literal[1, 2, 4, 8], BeforeValidator(int), expecting("1, 2, 4 or 8")] = 1
    scale: Annotated[Positive, Option("X")] = 1.0
    sniff: Annotated[Port | None, Option("PORT")] = None
    host: str | None = None
    interface: Flag = None
    duration: Duration | None = None
    count: Count | None = None
    language: bool = False

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if self.sniff is None:
            self.refuse(("host", "interface", "duration", "count"), " is for --sniff PORT")
        elif self.scene:
            raise ValueError("--scene: a scene's layout cannot be sniffed with; give its structure")
        if self.structure is not None and self.scene:
            raise ValueError(f"--scene {self.scene}: expected no structure beside it")
        if self.structure is not None and self.language:
            raise ValueError("--language: expected no structure beside it")
        return self


def run(options: StructureOptions) -> int:
    """Prints; returns 0."""
    if options.scene:
        return _print_scene(options.scene, options)
    layout = None if options.structure is None else _read(options.structure, options)
    if options.sniff:
        return _sniff(options.sniff, options, layout)
    if layout is None:
        _print_page()
    elif options.as_json:
        print_json(_layout_as_json(layout))
    else:
        _print_layout(layout)
    return 0


add_to = command("structure", run, StructureOptions, _HELP)


def _read(text: str, options: StructureOptions) -> Structure:
    from ..data.receive.structure import Structure

    try:
        return Structure(
            text,
            is_double=not options.float32,
            column_major=not options.row_major,
            alignment=options.alignment,
            scale=options.scale,
        )
    except StructureError as error:
        if error.structure.isprintable() and len(error.structure) < 100:
            print(f"  {error.structure}\n  {' ' * error.position}^", file=sys.stderr)
        raise


def _print_scene(scene_name: str, options: StructureOptions) -> int:
    from ..data.drive.wiring import wire

    scene = read_scene(scene_name)
    layouts = {name: source.layout for name, source in wire(scene).sources.items()}
    if options.as_json:
        print_json({name: _layout_as_json(layout) for name, layout in layouts.items()})
        return 0
    for name, layout in layouts.items():
        _print_layout(layout, f"source {name}: ")
    if not layouts:
        print(f"{scene.name} has no sources that receive packets")
    return 0


def _print_page() -> None:
    page = resources.files("sero_mj.data.receive").joinpath("STRUCTURE.md").read_text("utf-8")
    if not sys.stdout.isatty():
        print(page, end="")
        return
    from rich.markdown import Markdown

    _make_console().print(Markdown(page))


def _make_console() -> Console:
    return make_console(width=None if sys.stdout.isatty() else 250)


def _print_layout(layout: Structure, title: str = "") -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("offset", justify="right")
    table.add_column("bytes", justify="right")
    heads = ["type", "event", "shape"]
    if any(item.constant is not None or item.checksum for item in layout.fields):
        heads.append("must be")
    for head in heads:
        table.add_column(head)
    end = 0
    for item in layout.fields:
        if item.offset > end:
            table.add_row(str(end), str(item.offset - end), "hole", style="dim")
        style = "dim" if item.kind == "x" else "" if item.name else "yellow"
        place = (str(item.offset), str(item.end - item.offset))
        cells = (_type_in_words(item), item.name, _shape(item, layout), _must_be(item))
        table.add_row(*place, *cells[: len(heads)], style=style)
        end = item.end
    notes = [f"{layout.size} bytes"]
    if layout.alignment > 1:
        notes.append(f"alignment {layout.alignment}")
    if layout.scale != 1.0:
        notes.append(f"floating-point numbers times {layout.scale:g}")
    console = _make_console()
    with console.capture() as captured:
        console.print(f"{title}{layout.text}: {', '.join(notes)}", style="bold")
        console.print(table)
    for line in captured.get().splitlines():
        print(line.rstrip(), file=console.file)  # escaped, and with colors


def _type_in_words(item: Item) -> str:
    if item.kind == "x":
        return "skipped"
    kind = {"f": "float", "i": "int", "u": "uint"}[item.type[-2]]
    name = "bool" if item.is_bool else f"{kind}{8 * item.item_bytes}"
    order = {"<": ", little-endian", ">": ", big-endian"}.get(item.type[0], "")
    return f"{item.numbers} {name}{order}"


def _shape(item: Item, layout: Structure) -> str:
    if not item.name:
        return ""
    shape = " x ".join(map(str, item.shape))
    if len(item.shape) < 3:
        return shape
    order = "column by column" if layout.column_major else "row by row"
    return f"{shape}, {order}{', 3 rows sent' if item.kind == 'T' else ''}"


def _must_be(item: Item) -> str:
    """The constant that is demanded, as ids are written as well, or the checksum."""
    if item.checksum:
        return f"{item.checksum} of bytes {item.covers[0]} to {item.covers[1] - 1}"
    if item.constant is None:
        return ""
    if item.is_size:
        return f"{item.constant}, the size"
    if isinstance(item.constant, int) and item.constant > 9:
        return f"{item.constant} = 0x{item.constant:x}"
    return f"{item.constant:g}"


def _layout_as_json(layout: Structure) -> dict[str, Any]:
    return {
        "structure": layout.text,
        "size": layout.size,
        "alignment": layout.alignment,
        "column_major": layout.column_major,
        "scale": layout.scale,
        "fields": [
            {
                "offset": item.offset,
                "bytes": item.end - item.offset,
                "type": "skipped" if item.kind == "x" else "?" if item.is_bool else item.type,
                "numbers": item.numbers,
                "event": item.name or None,
                "shape": list(item.shape) if item.name else None,
                "constant": item.constant,
                "checksum": item.checksum or None,
                "covers": list(item.covers) if item.checksum else None,
            }
            for item in layout.fields
        ],
    }


def _sniff(port: int, options: StructureOptions, layout: Structure | None) -> int:
    from ..data.receive.sniffer import Sniffer

    host, interface = options.host or "127.0.0.1", options.interface or ""
    with Sniffer(host, port, interface) as sniffer:
        place = f"UDP {host}:{sniffer.port}"
        begin = time.monotonic()
        with (
            contextlib.suppress(KeyboardInterrupt),
            _shown(options, sniffer, layout, place) as show,
        ):
            _listen(sniffer, options, show)
        seconds = time.monotonic() - begin
        if options.as_json:
            print_json(_sniffed_as_json(sniffer, layout, seconds))
        else:
            _make_console().print(_picture(sniffer, layout, _summary(place, sniffer, seconds)))
    return 0


def _listen(sniffer: Sniffer, options: StructureOptions, show: Callable[[], None]) -> None:
    end = np.inf if options.duration is None else time.monotonic() + options.duration
    most = options.count or 10**15
    shown = -np.inf
    while (now := time.monotonic()) < end and sniffer.received < most:
        sniffer.receive(min(_REFRESH, end - now), most - sniffer.received)
        if time.monotonic() - shown >= _REFRESH:
            shown = time.monotonic()
            show()
    show()


@contextlib.contextmanager
def _shown(
    options: StructureOptions, sniffer: Sniffer, layout: Structure | None, place: str
) -> Iterator[Callable[[], None]]:
    if options.as_json:
        yield lambda: None
    elif not sys.stdout.isatty():
        print(f"listening on {place}; Ctrl-C ends", flush=True)
        yield _teller(sniffer, layout)
    else:
        from rich.live import Live

        title = f"listening on {place}; Ctrl-C ends"
        with Live(console=_make_console(), auto_refresh=False, transient=True) as live:
            yield lambda: live.update(_picture(sniffer, layout, title), refresh=True)


def _teller(sniffer: Sniffer, layout: Structure | None) -> Callable[[], None]:
    told: dict[tuple[bytes, int], tuple[float, int]] = {}

    def tell() -> None:
        now = time.monotonic()
        for key, stream in sniffer.streams.items():
            when, count = told.get(key, (-np.inf, 0))
            if stream.count > count and now - when >= _TELL_EVERY:
                told[key] = now, stream.count
                words = _values(stream, layout)
                print(f"{_head(stream)}{f': {words}' if words else ''}", flush=True)

    return tell


def _summary(place: str, sniffer: Sniffer, seconds: float) -> str:
    count = len(sniffer.streams)
    if not count:
        return f"nothing came to {place} within {seconds:.1f} s"
    return (
        f"{sniffer.received} packets in {seconds:.1f} s on {place}, of {count} "
        f"sender{'s and sizes' if count > 1 else ''}"
        + (f"; {sniffer.untold} packets of further ones" if sniffer.untold else "")
    )


def _head(stream: Stream) -> str:
    host, port = stream.sender
    rate = f", {stream.timing.rate:.5g}/s" if stream.timing.rate else ""
    return f"{host}:{port} sends {stream.size} bytes, {stream.count} times{rate}"


def _picture(sniffer: Sniffer, layout: Structure | None, title: str) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    lines = [Text(title, style="bold")]
    for stream in sniffer.streams.values():
        lines.append(Text(_head(stream)))
        if words := stream.description:
            lines.append(Text(f"    {words}", style="yellow"))
        if words := _values(stream, layout):
            lines.append(Text(f"    {words}", style="green" if _fits(stream, layout) else "red"))
        if not _fits(stream, layout):
            lines += [Text(f"    {line}") for line in _guess_lines(stream)]
    return Group(*lines)


def _fits(stream: Stream, layout: Structure | None) -> bool:
    return (
        layout is not None
        and stream.size == layout.size
        and not layout.find_wrong_constants(stream.rows[-1:])[0]
        and not layout.find_wrong_checksums(stream.rows[-1:])[0]
    )


def _values(stream: Stream, layout: Structure | None) -> str:
    if layout is None:
        return ""
    if stream.size != layout.size:
        hint = layout.for_size(stream.size)
        return f"{stream.size} bytes; '{layout.text}' has {layout.size}{hint and f'; {hint}'}"
    row = stream.rows[-1:]
    if wrong := layout.describe_wrong_constant(row) or layout.describe_wrong_checksum(row):
        return wrong
    return _numbers(layout.decode(stream.last[-1]))


def _numbers(values: Mapping[str, Any]) -> str:
    return "  ".join(f"{event} {_first(array)}" for event, array in values.items())


def _first(array: Any) -> str:
    numbers = [f"{number:.4g}" for number in array.ravel()[:_FIRST_NUMBERS]]
    return " ".join(numbers) + (" ..." if array.size > _FIRST_NUMBERS else "")


def _guess_lines(stream: Stream) -> list[str]:
    if not stream.is_binary:
        return []  # its description says what it is
    guesses = stream.guesses()
    if not guesses:
        return ["would fit nothing that is made of numbers, counters, flags and padding"]
    width = min(max(len(guess.structure) for guess in guesses), 40)
    lines = []
    for i, guess in enumerate(guesses):
        begin = "would fit " if i == 0 else ""
        lines.append(f"{begin:10}{guess.structure:{width}}  {_about(guess)}")
        lines.append(f"{'':12}{_numbers(_values_by(guess, stream))}")
    return lines


def _values_by(guess: Guess, stream: Stream) -> dict[str, Any]:
    from ..data.receive.structure import Structure

    layout = Structure(guess.structure, is_double=guess.is_double, column_major=guess.column_major)
    return dict(layout.decode(stream.last[-1]))


def _about(guess: Guess) -> str:
    likely = f"{guess.plausible:.0%} plausible"
    options = "" if guess.is_double else ", double = false"
    options += "" if guess.column_major else ", column_major = false"
    return f"{guess.about}; {likely}{options}"


def _sniffed_as_json(sniffer: Sniffer, layout: Structure | None, seconds: float) -> dict[str, Any]:
    streams = []
    for stream in sniffer.streams.values():
        found: dict[str, Any] = {
            "sender": "{}:{}".format(*stream.sender),
            "size": stream.size,
            "packets": stream.count,
            "rate": stream.timing.rate,
            "jitter": stream.timing.jitter,
            "guesses": [
                asdict(guess)
                | {"values": {k: each.tolist() for k, each in _values_by(guess, stream).items()}}
                for guess in stream.guesses()
            ],
        }
        if layout is not None and _fits(stream, layout):
            values = layout.decode(stream.last[-1])
            found["values"] = {event: array.tolist() for event, array in values.items()}
        streams.append(found)
    return {"seconds": seconds, "packets": sniffer.received, "streams": streams}
