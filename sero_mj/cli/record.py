"""`sero-mj record`: keeps what the sources of a scene receive in an MCAP file."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    check_ending,
    not_negative,
    positive,
    read_scene,
    until_ended,
)

if TYPE_CHECKING:
    from ..record.recorder import Recorder

_EPILOG = """\
examples:
  sero-mj record lwr_udp run.mcap                    until Ctrl-C
  sero-mj record lwr_udp run.mcap --duration 10
  sero-mj render lwr_udp --replay run.mcap -o run.mp4
  sero-mj export-csv run.mcap run.csv

The file holds every packet as it came, malformed ones too, with the time at which the kernel got
it, and decoded values as JSON, which Foxglove and PlotJuggler plot; what is routed to a joint has
its name and unit, lwr.A1.torque [Nm]. What was written up to half a second before a crash can be
read. When the disk is full the recording ends with an error and what was written is kept.
"""

_EVERY = 0.25  # s


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "record", run, "record what the sources of a scene receive, as MCAP", _EPILOG
    )
    parser.add_argument("scene", metavar="SCENE", help="scene: a file, or a shipped name")
    parser.add_argument("output", type=Path, metavar="OUT.mcap", help="where to")
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="seconds to record (default: until Ctrl-C)"
    )
    parser.add_argument(
        "--signals-rate", type=not_negative, default=1000.0, metavar="HZ",
        help="decoded values per second and source; all packets are kept (default 1000)",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="write over a file that exists")
    parser.add_argument("--quiet", action="store_true", help="no progress line")


def run(options: argparse.Namespace) -> int:
    """Records; returns 0, or 1 when nothing came."""
    from ..drive.record_sources import record_sources
    from ..drive.wiring import wire

    check_ending(str(options.output), options.output, (".mcap",))
    scene = read_scene(options.scene)
    wiring = wire(scene).check(scene)
    if not any(source.is_live for source in wiring.sources.values()):
        raise UsageError(f"scene '{scene.name}' has no source to record")
    with ExitStack() as stack:
        for source in wiring.sources.values():
            if source.is_live:
                source.open()
                stack.callback(source.close)
        recorder = stack.enter_context(
            record_sources(
                wiring.sources,
                options.output,
                scene=scene,
                overwrite=options.overwrite,
                signals_rate=options.signals_rate,
            )
        )
        with until_ended():
            _watch(recorder, options.duration, quiet=options.quiet)
    found = recorder.statistics
    lost = sum(found.not_recorded.values())
    print(
        f"{options.output}: {found.packets} packets in {found.seconds:.1f} s, "
        f"{found.file_size / 1e6:.1f} MB" + (f", {lost} packets were not recorded" if lost else "")
    )
    if not found.packets:
        print("sero-mj: nothing came; sero-mj status says what arrives", file=sys.stderr)
    return 0 if found.packets else 1


def _watch(recorder: Recorder, duration: float | None, *, quiet: bool) -> None:
    from rich.console import Console
    from rich.live import Live

    end = time.monotonic() + (float("inf") if duration is None else duration)
    console = Console(stderr=True)
    with Live(console=console, transient=True, auto_refresh=False) as screen:
        while (left := end - time.monotonic()) > 0 and recorder.error is None:
            time.sleep(min(left, _EVERY))
            if not quiet and console.is_terminal:
                screen.update(_line(recorder.statistics), refresh=True)


def _line(found: Any) -> str:
    lost = sum(found.not_recorded.values())
    warning = f"  {lost} not recorded: the disk is too slow" if lost else ""
    size = f"{found.file_size / 1e6:.1f} MB"
    return (
        f"recording {found.seconds:6.1f} s  {found.packets} packets  {size}{warning}  Ctrl-C ends"
    )
