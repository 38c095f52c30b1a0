"""`sero-mj structure`: explains a packet layout, or shows the packets at a port."""

from __future__ import annotations

import sys
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, model_validator

from ..base.declaration import expecting
from ..base.errors import StructureError, UsageError
from ..base.options import Count, Duration, Option, Port, Positive, positional
from ..base.plugins import SNIFFERS, load_all
from .arguments import command, print_json, read_scene
from .shared_options import Flag, JsonOptions
from .terminal import make_console

if TYPE_CHECKING:
    from rich.console import Console

    from ..data.receive.language import Item
    from ..data.receive.structure import Structure

_HELP = """\
examples:
  sero-mj structure 7F7F                    offsets, types, events, size
  sero-mj structure --scene lwr_contact     the packets that a scene expects
  sero-mj structure 7F1M --sniff 32000      the packets at a port, and their values

Only one program can listen to a port, so close the viewer before using --sniff. Ctrl+C ends it with
a summary.
"""
GROUP, ORDER = "receive", 26


class StructureOptions(JsonOptions):
    """Explain a packet layout, or show the packets at a port.

    Attributes:
        structure: layout of a packet, e.g. 7F1M.
        scene: explain the packet layouts of a scene's sources.
        float32: read the items F, V, M and T as float32.
        row_major: read matrices row by row.
        alignment: alignment of every item in bytes.
        scale: factor by which floating-point numbers are multiplied.
        sniff: show the packets that arrive at a UDP port.
        host: address to listen on; 0.0.0.0 for all interfaces (default: 127.0.0.1).
        interface: network interface on which to join a multicast group.
        duration: duration of --sniff in seconds (default: until Ctrl+C).
        count: number of packets after which --sniff ends.
        language: print the reference of the layout language.
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
            self.refuse(("host", "interface", "duration", "count"), " needs --sniff PORT")
        elif self.scene:
            raise ValueError("--scene cannot be combined with --sniff. Pass a STRUCTURE instead.")
        if self.structure is not None:
            self.refuse(("scene", "language"), " cannot be combined with STRUCTURE")
        return self


def run(options: StructureOptions) -> int:
    """Prints a packet layout, the packets at a port, or the layout reference; returns 0."""
    if options.scene:
        return _print_scene(options.scene, options)
    layout = None if options.structure is None else _read(options.structure, options)
    if options.sniff:
        for sniff in load_all(SNIFFERS).values():
            return int(sniff(options.sniff, options, layout))
        raise UsageError("--sniff: the extension that shows the packets at a port is not installed")
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
        print(f"{scene.name} has no source that receives packets")
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
            table.add_row(str(end), str(item.offset - end), "padding", style="dim")
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
        print(line.rstrip(), file=console.file)  # the console has already escaped the text


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
