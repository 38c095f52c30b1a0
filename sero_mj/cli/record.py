"""`sero-mj record`: records the packets of a scene's sources in MCAP files."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import model_validator

from ..base.errors import RouteError, UsageError
from ..base.options import Duration, NotNegative, Option, Options, Time, positional
from .arguments import check_ending, command, read_scene, replay_instead, until_ended
from .shared_options import Recording, SceneArgument
from .terminal import make_console

if TYPE_CHECKING:
    from ..data.record.recorder import Recorder
    from ..data.record.triggered_recorder import RecordedEvent, TriggeredRecorder

_HELP = """\
examples:
  sero-mj record lwr_udp run.mcap                       until Ctrl+C
  sero-mj record lwr_udp run.mcap --duration 10
  sero-mj record lwr_udp night --trigger "abs(lwr.torques) > 100" --before 5 --after 5

The file contains every received packet unchanged, including malformed ones, with the kernel's time
stamp. Decoded values are stored as ROS 2 messages for Foxglove, PlotJuggler and ros2 bag, with
names such as lwr_a1_torque for values that are routed to joints. After a crash, all data except the
last half second can be read. If the disk is full, the recording ends with an error and stays valid.

--trigger records each event in a separate file, from --before seconds before the event until
--after seconds after its last packet. OUT is a folder, or OUT.mcap for OUT_001.mcap, OUT_002.mcap
and so on. The condition compares (< <= > >= == !=, and, or, not) inputs of robots, for example
lwr.joint_angles[3], lwr.torque_error (commanded minus measured), and events, for example
udp.values0. It can use + - * / and abs, min, max, norm, any, all. A condition on several joints
holds if it holds for at least one of them.
"""

_INTERVAL = 0.25  # time between updates of the progress line, s
GROUP, ORDER = "receive", 22


class TriggerOptions(Options):
    """Options for recording events.

    Attributes:
        trigger: record only the packets that satisfy this condition, and those around them.
        before: seconds to record before an event.
        after: seconds to record after the last packet of an event.
        replay: search for events in a recording instead of live sources.
    """

    title: ClassVar[str] = "recording events"
    trigger: Annotated[str | None, Option("CONDITION")] = None
    before: Time = 5.0
    after: Time = 5.0
    replay: Recording | None = None

    @model_validator(mode="after")
    def _check_trigger(self) -> Self:
        if self.trigger is None:
            self.refuse(("before", "after", "replay"), " needs --trigger CONDITION")
        return self


class RecordOptions(SceneArgument, TriggerOptions):
    """Record the packets of a scene's sources as MCAP.

    Attributes:
        scene: file or included name of a scene.
        output: output file; with --trigger, also a folder (default: the current folder).
        out: output file or folder (may also be given as OUT.mcap).
        duration: recording time in seconds (default: until Ctrl+C).
        signals_rate: rate in Hz of decoded values of each source for other programs; packets
            are always recorded at the full rate.
        overwrite: replace an existing file.
        quiet: print no progress line.
    """

    output: Annotated[Path | None, positional("OUT.mcap")] = None
    out: Annotated[Path | None, Option("OUT", ("-o", "--out"))] = None
    duration: Annotated[Duration | None, Option("S", ("--seconds", "--duration"))] = None
    signals_rate: Annotated[NotNegative, Option("HZ")] = 20.0
    overwrite: bool = False
    quiet: bool = False

    @property
    def to(self) -> Path | None:
        """The output file or folder."""
        return self.output or self.out

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.out is not None and self.output is not None:
            raise ValueError(f"OUT {self.output} cannot be combined with --out {self.out}")
        if self.trigger is None:
            if self.to is None:
                raise ValueError("no output file; expected OUT.mcap")
            check_ending(str(self.to), self.to, (".mcap",))
        if self.replay is not None and self.duration is not None:
            raise ValueError(
                "--duration cannot be combined with --replay, which is read to the end"
            )
        return self


def run(options: RecordOptions) -> int:
    """Records the packets of a scene's sources; returns 0, or 1 if no packet arrived."""
    from ..data.drive.record_sources import record_sources
    from ..data.drive.wiring import wire

    if options.trigger is not None:
        return _record_events(options, options.trigger)
    assert options.to is not None
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
                options.to,
                scene=scene,
                overwrite=options.overwrite,
                signals_rate=options.signals_rate,
            )
        )
        with until_ended():
            _watch(recorder, _line, options.duration, quiet=options.quiet)
    found = recorder.statistics
    lost = sum(found.not_recorded.values())
    print(
        f"{options.to}: {found.packets} packets in {found.seconds:.1f} s, {_size(found)}"
        + (f", {lost} packets were not recorded" if lost else "")
    )
    return _status(found)


add_to = command("record", run, RecordOptions, _HELP)


def _status(found: Any) -> int:
    if not found.packets:
        print(
            "sero-mj: no packet arrived. `sero-mj status` shows rejected packets, and "
            "`sero-mj structure --sniff PORT` shows all packets at a port.",
            file=sys.stderr,
        )
    return 0 if found.packets else 1


def _record_events(options: RecordOptions, condition: str) -> int:
    from ..data.drive.record_sources import record_events
    from ..data.drive.trigger import Trigger
    from ..data.drive.wiring import wire
    from ..data.record.file_source import FileSource
    from ..data.record.recording_format import RecordingClock

    scene = read_scene(options.scene, replay=options.replay)
    begin = time.time() - time.monotonic()  # Unix time at which the arrival clock is zero, s
    more: dict[str, Any] = {}
    if options.replay is not None:
        replay_instead(scene, options.replay, 0.0)
    wiring = wire(scene).check(scene)
    replays = [source for source in wiring.sources.values() if isinstance(source, FileSource)]
    if options.replay is not None and replays:
        with replays[0].open_recording() as recording:
            begin = recording.start.timestamp()
        more = {
            "now": None,
            "clock_at": lambda s: RecordingClock(round((begin + s) * 1e9), round(s * 1e9)),
        }
    sources = {
        name: source
        for name, source in wiring.sources.items()
        if source.is_live is (options.replay is None)
    }
    if not sources:
        raise UsageError(f"scene '{scene.name}' has no source to record")
    try:
        trigger = Trigger(condition, scene, wiring)
    except RouteError as error:
        raise UsageError(f"--trigger {error}") from None
    path_of = _names_of_events(options.to or Path(), scene.name, begin)
    console = make_console(stderr=True)
    with ExitStack() as stack:
        recorder = stack.enter_context(
            record_events(
                sources,
                trigger,
                path_of,
                scene,
                before=options.before,
                after=options.after,
                overwrite=options.overwrite,
                signals_rate=options.signals_rate,
                **more,
            )
        )
        recorder.on_event = partial(_print_event, begin)
        for source in sources.values():
            source.open()
            stack.callback(source.close)
        with until_ended():
            if options.replay is None:
                _watch(recorder, _line_of_events, options.duration, quiet=options.quiet)
            else:
                _play_through(recorder, sources, console, quiet=options.quiet)
    found = recorder.statistics
    recorded = sum(event.packets for event in recorder.events)
    many = f"{found.events} events" if found.events != 1 else "1 event"
    missed = sum(found.unchecked.values())
    print(
        f"{many} in {found.packets} packets"
        + (f"; {recorded} packets recorded" if found.events else "")
        + (f"; {missed} packets arrived too fast to be checked" if missed else "")
        + (f"; {found.evicted} packets before events exceeded memory" if found.evicted else "")
    )
    return _status(found)


def _names_of_events(output: Path, scene: str, begin: float) -> Callable[[int, float], Path]:
    if output.suffix.lower() == ".mcap":
        return lambda number, _: output.with_name(f"{output.stem}_{number:03}{output.suffix}")
    if output.suffix:
        raise UsageError(f"{output}: expected a folder, or a name that ends in .mcap")
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot create folder {output}: {error.strerror}") from None

    def path_of(number: int, arrival: float) -> Path:
        at = datetime.fromtimestamp(begin + arrival)
        return output / f"{scene}_{at:%Y-%m-%d_%H-%M-%S}.{at.microsecond // 1000:03}.mcap"

    return path_of


def _print_event(begin: float, event: RecordedEvent) -> None:
    if math.isnan(event.ended):
        at = datetime.fromtimestamp(begin + event.time)
        print(f"{at:%H:%M:%S}.{at.microsecond // 1000:03}  {event.what}", flush=True)
        return
    again = f", triggered {event.again} more times" if event.again else ""
    print(
        f"  {event.path}: {event.packets} packets in {event.ended - event.began:.1f} s, "
        f"starting {event.time - event.began:.1f} s before the event{again}",
        flush=True,
    )


def _play_through(
    recorder: TriggeredRecorder, sources: Mapping[str, Any], console: Any, *, quiet: bool
) -> None:
    end = max(source.end or 0.0 for source in sources.values())
    now, step = 0.0, 0.5
    while now < end + step and recorder.error is None:
        now += step
        for source in sources.values():
            source.advance_to(now)
        recorder.wait_until_handled()
        if not quiet and console.is_terminal:
            console.file.write(f"{min(now, end):.1f} of {end:.1f} s\r")
            console.file.flush()


def _watch(
    recorder: Recorder | TriggeredRecorder,
    line: Callable[[Any], str],
    duration: float | None,
    *,
    quiet: bool,
) -> None:
    from rich.live import Live

    end = time.monotonic() + (float("inf") if duration is None else duration)
    console = make_console(stderr=True)
    with Live(console=console, transient=True, auto_refresh=False) as screen:
        while (left := end - time.monotonic()) > 0 and recorder.error is None:
            time.sleep(min(left, _INTERVAL))
            if not quiet and console.is_terminal:
                screen.update(line(recorder.statistics), refresh=True)


def _line(found: Any) -> str:
    lost = sum(found.not_recorded.values())
    warning = f"  {lost} not recorded: the disk is too slow" if lost else ""
    return (
        f"recording {found.seconds:6.1f} s  {found.packets} packets  {_size(found)}{warning}  "
        "Ctrl+C ends"
    )


def _size(found: Any) -> str:
    size = found.file_size
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"


def _line_of_events(found: Any) -> str:
    now = "recording an event" if found.is_recording else "waiting for an event"
    many = f"{found.events} event{'s' * (found.events != 1)}"
    return f"{now} {found.seconds:6.1f} s  {found.packets} packets  {many}  Ctrl+C ends"
