"""`sero-mj structure`: what a structure string means, and what comes in on a port."""

from __future__ import annotations

import argparse
import json
import sys
from importlib import resources
from typing import TYPE_CHECKING

from ..errors import StructureError, UsageError
from ._arguments import Commands, add_command, port, positive, read_scene
from ._layout_table import as_json, make_console, print_layout

if TYPE_CHECKING:
    from ..receive.structure import Structure

_EPILOG = """\
examples:
  sero-mj structure 7F7F                        offsets, types, events, size
  sero-mj structure "1H=size 7f 1Tf" --alignment 4
  sero-mj structure --scene lwr_contact         what the sources of a scene expect
  sero-mj structure --sniff 32000               what arrives, and what would fit it
  sero-mj structure 7F1M --sniff 32000          the same, with the numbers in it
  sero-mj structure                             the page about the language

A port can be listened to by one program only: close the viewer while you sniff. Ctrl-C ends it
with a summary.
"""


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "structure", run, "explain a packet layout, or show what a port gets", _EPILOG
    )
    parser.add_argument(
        "structure", nargs="?", metavar="STRUCTURE", help="layout of a packet, e.g. 7F1M"
    )
    parser.add_argument("--scene", metavar="SCENE", help="layouts of this scene's sources instead")
    parser.add_argument("--float32", action="store_true", help="F, V, M and T are float32")
    parser.add_argument("--row-major", action="store_true", help="matrices come row by row")
    parser.add_argument(
        "--alignment", type=int, choices=(1, 2, 4, 8), default=1, help="of every item (default 1)"
    )
    parser.add_argument(
        "--scale", type=positive, default=1.0, metavar="X", help="factor on floating-point numbers"
    )
    parser.add_argument("--sniff", type=port, metavar="PORT", help="show what arrives there")
    parser.add_argument(
        "--host", help="address to listen on (default 127.0.0.1); 0.0.0.0 for all interfaces"
    )
    parser.add_argument(
        "--interface", metavar="NAME", help="network interface on which a multicast group is joined"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="sniff for so long")
    parser.add_argument("--count", type=_count, metavar="N", help="sniff so many packets")
    parser.add_argument("--language", action="store_true", help="print the page about the language")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _count(text: str) -> int:
    if text.isdecimal() and 1 <= len(text) <= 15 and int(text):
        return int(text)
    raise argparse.ArgumentTypeError(f"found '{text}'; expected a whole number above 0")


def run(options: argparse.Namespace) -> int:
    """Prints; returns 0."""
    _check_options(options)
    if options.scene:
        return _print_scene(options)
    layout = None if options.structure is None else _read(options)
    if options.sniff:
        from ._sniff import sniff

        return sniff(options, layout)
    if layout is None:
        _print_page()
    elif options.json:
        print(json.dumps(as_json(layout), indent=2))
    else:
        print_layout(layout)
    return 0


def _check_options(options: argparse.Namespace) -> None:
    if not options.sniff:
        for name in ("host", "interface", "duration", "count"):
            if getattr(options, name) is not None:
                raise UsageError(f"--{name} is for --sniff PORT")
    elif options.scene:
        raise UsageError("--scene: a scene's layout cannot be sniffed with; give its structure")
    if options.scene and options.structure is not None:
        raise UsageError(f"--scene {options.scene}: expected no structure beside it")
    if options.language and options.structure is not None:
        raise UsageError("--language: expected no structure beside it")


def _read(options: argparse.Namespace) -> Structure:
    """The structure that is given; where it is wrong, a line points at the character."""
    from ..receive.structure import Structure

    try:
        return Structure(
            options.structure,
            is_double=not options.float32,
            column_major=not options.row_major,
            alignment=options.alignment,
            scale=options.scale,
        )
    except StructureError as error:
        if error.structure.isprintable() and len(error.structure) < 100:
            print(f"  {error.structure}\n  {' ' * error.position}^", file=sys.stderr)
        raise


def _print_scene(options: argparse.Namespace) -> int:
    from ..drive.wiring import wire

    scene = read_scene(options.scene)
    layouts = {name: source.layout for name, source in wire(scene).sources.items()}
    if options.json:
        print(json.dumps({name: as_json(layout) for name, layout in layouts.items()}, indent=2))
        return 0
    for name, layout in layouts.items():
        print_layout(layout, f"source {name}: ")
    if not layouts:
        print(f"{scene.name} has no sources that receive packets")
    return 0


def _print_page() -> None:
    page = resources.files("sero_mj.receive").joinpath("STRUCTURE.md").read_text("utf-8")
    if not sys.stdout.isatty():
        print(page, end="")
        return
    from rich.markdown import Markdown

    make_console().print(Markdown(page))
