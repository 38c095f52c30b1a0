"""What a structure string means, as a table for people and as JSON."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from ..receive.language import Item
    from ..receive.structure import Structure


def make_console() -> Console:
    """Prints to a terminal in its width, and to files and pipes without a limit."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 250, highlight=False, markup=False)


def print_layout(layout: Structure, title: str = "") -> None:
    """Prints a table of what stands where."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("offset", justify="right")
    table.add_column("bytes", justify="right")
    heads = ["type", "event", "shape"]
    if any(item.constant is not None for item in layout.fields):
        heads.append("must be")
    for head in heads:
        table.add_column(head)
    end = 0
    for item in layout.fields:
        if item.offset > end:
            table.add_row(str(end), str(item.offset - end), "hole", style="dim")
        style = "dim" if item.kind == "x" else "" if item.name else "yellow"
        place = (str(item.offset), str(item.end - item.offset))
        cells = (type_in_words(item), item.name, _shape(item, layout), must_be(item))
        table.add_row(*place, *cells[: len(heads)], style=style)
        end = item.end
    notes = [f"{layout.size} bytes"]
    if layout.alignment > 1:
        notes.append(f"alignment {layout.alignment}")
    if layout.scale != 1.0:
        notes.append(f"floating-point numbers times {layout.scale:g}")
    console = make_console()
    with console.capture() as captured:
        console.print(f"{title}{layout.text}: {', '.join(notes)}", style="bold")
        console.print(table)
    for line in captured.get().splitlines():
        print(line.rstrip())


def type_in_words(item: Item) -> str:
    """For example `7 float64, little-endian`."""
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


def must_be(item: Item) -> str:
    """The constant that is demanded, as ids are written as well."""
    if item.constant is None:
        return ""
    if item.is_size:
        return f"{item.constant}, the size"
    if isinstance(item.constant, int) and item.constant > 9:
        return f"{item.constant} = 0x{item.constant:x}"
    return f"{item.constant:g}"


def as_json(layout: Structure) -> dict[str, Any]:
    """The layout as plain lists and numbers."""
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
            }
            for item in layout.fields
        ],
    }
