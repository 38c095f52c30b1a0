"""`sero-mj send SCENE --play FILE`: a recording or a table instead of a motion."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ..paths import list_scenarios
from ._arguments import positive
from ._sink import goes_to_shm

if TYPE_CHECKING:
    from ..assemble.scene import Scene
    from ..receive.source import Source
    from ..receive.structure import Structure
    from ..send.playback import Playback

_OPTIONS = ("speed", "loop", "recorded")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds what is for files."""
    group = parser.add_argument_group("for a recording or a table")
    group.add_argument(
        "--play",
        type=Path,
        metavar="FILE",
        help="REC.mcap, TABLE.csv or a scenario, instead of a motion",
    )
    group.add_argument("--speed", type=positive, metavar="X", help="2 is twice as fast")
    group.add_argument("--loop", action="store_true", default=None, help="again and again")
    group.add_argument(
        "--recorded",
        metavar="NAME",
        help="which source of the recording (default: the one of the same name, or the only one)",
    )


def refuse_options(options: argparse.Namespace) -> None:
    """Refuses these options for a motion.

    Raises:
        UsageError: one of them is given.
    """
    for name in _OPTIONS:
        if getattr(options, name) is not None:
            raise UsageError(f"--{name} is for --play FILE")


def send_file(
    options: argparse.Namespace, scene: Scene, sink: Callable[..., AbstractContextManager[Any]]
) -> int:
    """Sends what is in the file; returns 0.

    Args:
        options: of the command.
        scene: whose source is fed.
        sink: makes what takes the packets, from options, source and structure.

    Raises:
        UsageError: the options do not suit the file.
    """
    from ..drive.wiring import wire
    from ..send.play import choose_source, structure_for
    from ..send.playback import timed
    from ..send.sender import send

    if options.play.suffix.lower() == ".toml" or str(options.play) in list_scenarios():
        return _send_simulation(options)
    if options.amplitude is not None:
        raise UsageError("--amplitude is for a motion; it does nothing with --play")
    wiring = wire(scene).check(scene)
    source = choose_source(wiring, options.source)
    structure = structure_for(source, options.structure)
    playback = _open(options, source, structure, goes_to_shm(options, source))
    printed = _print_notes(playback.notes)
    with sink(options, source, structure) as to:
        print(
            f"sending {playback.about}: {playback.count} packets, {playback.duration:.2f} s, "
            f"to {to.place}; Ctrl-C stops",
            flush=True,
        )
        packets = timed(
            playback,
            speed=options.speed or 1.0,
            loop=bool(options.loop),
            duration=options.duration,
        )
        report = send(packets, to)
    print(report)
    _print_notes(playback.notes[printed:])
    if playback.skipped:
        print(f"{playback.skipped} could not be sent in '{structure.text}'")
    return 0


def _print_notes(notes: list[str]) -> int:
    for note in notes:
        print(f"note: {note}", flush=True)
    return len(notes)


def _send_simulation(options: argparse.Namespace) -> int:
    """Simulates a scenario and sends it while it runs; returns 0."""
    from ..simulate.scenario_file import read_scenario
    from ..simulate.simulation import Simulation
    from ._simulate_send import Sender

    for name in ("amplitude", "rate", "speed", "loop", "recorded"):
        if getattr(options, name) is not None:
            raise UsageError(f"--{name}: a scenario is sent as it is simulated, in real time")
    over = {} if options.duration is None else {"run.duration": options.duration}
    options.send = options.scene
    with Sender(Simulation(read_scenario(options.play, over)), options) as sender:
        for _ in sender.run():
            pass
    return 0


def _open(
    options: argparse.Namespace, source: Source, structure: Structure, to_shm: bool
) -> Playback:
    from ..record.recording import Recording
    from ..send.playback import RecordedPackets, TablePackets

    file: Path = options.play
    if file.suffix.lower() == ".csv":
        if options.recorded is not None:
            raise UsageError(f"--recorded is for recordings; {file} is a table")
        return TablePackets(file, structure, options.rate)
    if options.rate is not None:
        raise UsageError("--rate: a recording has its own times; --speed changes them")
    name = options.recorded or ""
    if not name:
        with Recording(file) as recording:
            name = source.name if source.name in recording.sources else ""
    return RecordedPackets(file, name, structure, only_whole=to_shm)
