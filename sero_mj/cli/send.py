"""`sero-mj send`: sends a motion, recording, table or scenario as a robot would."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from ..base.declaration import expecting
from ..base.errors import SimulationError, UsageError
from ..base.options import Duration, NotNegative, Option, Options, Port, Positive, Seed
from ..base.paths import list_scenarios
from ..base.plugins import SENDERS, load_plugin, plugins
from .arguments import command, print_programs, read_scene
from .shared_options import Columns, SceneArgument

if TYPE_CHECKING:
    from ..data.receive.source import Source
    from ..data.receive.structure import Structure
    from ..data.send.playback import Playback
    from ..data.send.sender import ShmWriter, UdpSink
    from ..robots.declared.scene import Scene
    from ..simulate.simulation import Simulation

_INTERVAL = 0.05  # time between updates of a simulation that sends no packets, s


class SinkOptions(Options):
    """Options for the layout and destination of packets.

    Attributes:
        source: source of the scene that receives the packets, if there are several sources.
        structure: packet layout (default: layout of the source).
        host: destination address (default: 127.0.0.1).
        port: destination UDP port (default: port of the source).
        shm: name of the shared memory to write to (default: shared memory of the source).
    """

    title: ClassVar[str] = "destination of packets"
    source: Annotated[str | None, Option("NAME")] = None
    structure: Annotated[str | None, Option("S")] = None
    host: str | None = None
    port: Port | None = None
    shm: Annotated[str | None, Option("NAME")] = None


def goes_to_shm(options: SinkOptions, source: Source) -> bool:
    """Whether packets go to shared memory, because of `--shm` or the kind of the source."""
    return options.shm is not None or (source.memory is not None and options.port is None)


def make_sink(options: SinkOptions, source: Source, structure: Structure) -> UdpSink | ShmWriter:
    """Returns a sink for the destination in the options, or else for the source's address."""
    from ..data.send.sender import ShmWriter, UdpSink

    if goes_to_shm(options, source):
        if source.memory is None:
            return ShmWriter(options.shm or "", structure)
        if options.host is not None:
            raise UsageError(f"source '{source.name}' is {source.about}; --host needs --port")
        block, lock, offset = source.memory
        if lock not in structure.events:
            lock = ""
        return ShmWriter(options.shm or block, structure, lock, offset)
    port = options.port or (0 if source.place is None else source.place[1])
    if not port and not source.is_live:
        reason = "is a recording, which cannot receive packets. Add --port and --host."
        raise UsageError(f"source '{source.name}' of the scene {reason}")
    if source.place is None and not port:
        how = "which does not receive UDP packets. Use --port to send its packets to a UDP port."
        raise UsageError(f"source '{source.name}' is {source.about}, {how}")
    if not port:
        reason = "listens on a port that the system chooses (port = 0). Use --port to set the port."
        raise UsageError(f"source '{source.name}' of the scene {reason}")
    message_of = source.message_of if options.structure is None else None
    return UdpSink(options.host or "127.0.0.1", port, message_of)


def in_real_time(simulation: Simulation) -> Iterator[tuple[int, int]]:
    """Runs a simulation in real time; yields ranges (first, stop) of new rows in its log."""
    from ..simulate.real_time import RealTimeWatch

    timestep, watch = simulation.scenario.run.timestep, RealTimeWatch(simulation.scenario.name)
    begin, delay = time.perf_counter(), 0.0
    while not simulation.is_done:
        time.sleep(_INTERVAL)
        first = simulation.step + 1 if simulation.step else 0
        due = int((time.perf_counter() - begin) / timestep)
        try:
            simulation.advance(min(max(due, simulation.step + 1), simulation.steps))
        finally:
            if simulation.step >= first:
                yield first, simulation.step + 1
        delay = time.perf_counter() - begin - simulation.time
        watch.update(simulation.time, delay)
    watch.finish(simulation.time, delay)


class Sender:
    """A sender that runs a simulation in real time and sends it to a source of a scene."""

    def __init__(self, simulation: Simulation, name: str, options: SinkOptions) -> None:
        from ..data.send.play import MotionPackets
        from ..simulate.log_output import LogSignals

        scene = read_scene(name)
        players = {name: LogSignals(simulation, name) for name in simulation.scenario.scene.robots}
        self._packets = MotionPackets(scene, options.source, options.structure, players=players)
        self._sink: Any = make_sink(options, self._packets.source, self._packets.structure)
        self._simulation = simulation
        self.report: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._sink.close()

    def run(self) -> Iterator[tuple[int, int]]:
        """Sends one packet per step; yields the range (first, stop) of new rows in the log."""
        from ..data.send.sender import send

        simulation = self._simulation
        stopped: list[SimulationError] = []

        def packets() -> Iterator[tuple[float, bytes]]:
            times = simulation.rows[:, 0]
            for k in range(simulation.steps + 1):
                try:
                    simulation.advance(k)
                except SimulationError as error:
                    stopped.append(error)
                    return
                yield float(times[k]), self._packets.at(float(times[k]))

        print(
            f"sending {self._packets.structure.text} ({self._packets.structure.size} bytes) to "
            f"{self._sink.place} in real time; Ctrl+C stops",
            flush=True,
        )
        self.report = send(packets(), self._sink)
        print(self.report)
        yield 0, simulation.step + 1
        if stopped:
            raise stopped[0]


_HELP = """\
examples:
  sero-mj send lwr_udp --rate 200 --duration 10         a motion in the layout of the scene
  sero-mj send lwr_udp --play run.mcap --loop           a recording
  sero-mj send ur5e --play TABLE.csv --columns "joint_angles=A* [deg]" --columns "time=Zeit [s]"

The joints oscillate within their limits, with torques from inverse dynamics. If SCENE is a robot,
packets have its joint angles and torques, and go to port 32000. Above 1 kHz, values between packets
of 1 kHz are interpolated linearly. Ctrl+C stops.

If the scene has the recorded structure, a recording is sent bit for bit with the original timing.
Otherwise its events are packed again by name. The columns of a table can be the numbers of the
packet by name (`values0[0]`, as written by `sero-mj export`) or in order, or signals of the joints,
which are recognized by name or declared by --columns and packed by the routes of the scene.
"""

MAX_RATE = 1e5  # packets/s; a Python loop cannot send faster
GROUP, ORDER = "receive", 24


class PlayOptions(Options):
    """Options for sending a recording, table or scenario.

    Attributes:
        play: recording (.mcap), table (.csv) or scenario to send instead of a motion.
        speed: playback speed relative to real time, for example 2.
        loop: repeat the playback until Ctrl+C.
        recorded: source of the recording to send (default: the source of the same name, or the only
            source).
        columns: columns of a table, e.g. "joint_angles=q_*" or time=stamp; repeatable.
    """

    title: ClassVar[str] = "playing a recording or a table"
    play: Annotated[Path | None, Option("FILE")] = None
    speed: Annotated[Positive, Option("X")] = 1.0
    loop: bool = False
    recorded: Annotated[str | None, Option("NAME")] = None
    columns: Columns = []


class ControllerOptions(Options):
    """Options for sending with the protocol of a robot controller.

    Attributes:
        cycle: time between packets in ms, from 1 to 100 (default: 5).
        loss: share of lost packets, 0 to 1.
        quality: reported connection quality: unacceptable, bad, ok, perfect or invalid (default:
            computed from the replies, or ok if the scene sends no replies).
        seed: seed of the random choice of lost packets.
    """

    title: ClassVar[str] = "sending like the controller of a robot"
    cycle: Annotated[Positive | None, Option("MS")] = None
    loss: Annotated[float, Field(ge=0, le=1), expecting("a share from 0 to 1"), Option("P")] = 0.0
    quality: Annotated[str | None, Option("NAME")] = None
    seed: Seed = 0


class SendOptions(SceneArgument, PlayOptions, ControllerOptions, SinkOptions):
    """Send a motion over UDP or shared memory as a robot would.

    Attributes:
        rate: packets per second (default: 1000; FRI: 200).
        duration: sending time in seconds (default: until Ctrl+C).
        amplitude: amplitude of the motion, from 0 (no motion) to 1.
    """

    rate: Annotated[Positive | None, Option("HZ")] = None
    duration: Duration | None = None
    amplitude: Annotated[NotNegative, Option("A")] = 1.0

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if (self.rate or 0.0) > MAX_RATE:
            raise ValueError(f"--rate {self.rate:g}: expected at most {MAX_RATE:g} packets/s")
        if self.shm is not None and (others := self.set_among("host", "port")):
            raise ValueError(f"--shm cannot be combined with {others[0]}")
        return self


def run(options: SendOptions) -> int:
    """Sends packets until the motion ends or Ctrl+C; returns 0."""
    from ..data.drive.wiring import wire
    from ..data.receive.structure import Structure
    from ..data.send.play import choose_source

    if options.structure is not None:
        Structure(options.structure)  # reports errors before the scene is read
    scene = read_scene(options.scene)
    if not scene.sources and len(scene.robots) == 1:
        _declare_source(scene, options)
    file = options.play
    if file is not None and (file.suffix.lower() == ".toml" or str(file) in list_scenarios()):
        return _send_simulation(options, file)
    source = choose_source(wire(scene).check(scene), options.source)
    if file is not None:
        return _send_file(options, scene, source, file)
    options.refuse(("speed", "loop", "recorded", "columns"), " needs --play FILE")
    if source.kind in plugins(SENDERS):
        return int(load_plugin(SENDERS, source.kind)(options, scene, source))
    kinds = " or ".join(f'"{name}"' for name in plugins(SENDERS))
    why = f" needs a source of kind = {kinds} in the scene"
    options.refuse(("cycle", "loss", "quality", "seed"), why)
    return _send_motion(options, scene)


add_to = command("send", run, SendOptions, _HELP)


def _send_motion(options: SendOptions, scene: Scene) -> int:
    from ..data.send.play import MotionPackets
    from ..data.send.sender import PacketBuffer, paced, send

    rate = 1000.0 if options.rate is None else options.rate
    packets = MotionPackets(scene, options.source, options.structure, options.amplitude)
    structure, source = packets.structure, packets.source
    events = structure.events
    buffer = PacketBuffer(
        packets.at,
        structure,
        rate=rate,
        sequence=source.sequence if source.sequence in events else "",
        time=source.time if source.time in events else "",
        time_scale=source.time_scale,
    )
    with make_sink(options, source, structure) as sink:
        print(
            f"sending {structure.text} ({structure.size} bytes) to {sink.place} "
            f"at {rate:g} Hz; Ctrl+C stops",
            flush=True,
        )
        report = send(paced(buffer.at, rate, options.duration), sink, idle=buffer.idle)
    print(report)
    return 0


def _declare_source(scene: Scene, options: SendOptions) -> None:
    robot = next(iter(scene.robots.values()))
    structure = options.structure or f"{robot.n}F{robot.n}F"
    where = {"kind": "udp", "port": 32000}
    if options.shm is not None:
        where = {"kind": "shm", "block": options.shm}
    scene.sources["robot"] = {**where, "structure": structure}
    scene.routes[f"{robot.name}.joint_angles"] = "robot.values0"
    if len(structure.upper().split("F")) > 2:
        scene.routes[f"{robot.name}.torques"] = "robot.values1"


def _send_file(options: SendOptions, scene: Scene, source: Source, file: Path) -> int:
    from ..data.send.play import structure_for
    from ..data.send.playback import timed
    from ..data.send.sender import send

    options.refuse(("amplitude",), " cannot be combined with --play")
    structure = structure_for(source, options.structure)
    playback = _open_file(options, scene, source, structure, file)
    printed = _print_notes(playback.notes)
    with make_sink(options, source, structure) as to:
        print(
            f"sending {playback.about}: {playback.count} packets, {playback.duration:.2f} s, "
            f"to {to.place}; Ctrl+C stops",
            flush=True,
        )
        packets = timed(playback, speed=options.speed, loop=options.loop, duration=options.duration)
        report = send(packets, to)
    print(report)
    _print_notes(playback.notes[printed:])
    if playback.skipped:
        print(f"{playback.skipped} packets could not be converted to '{structure.text}'")
    return 0


def _print_notes(notes: list[str]) -> int:
    for note in notes:
        print(f"note: {note}", flush=True)
    return len(notes)


def _open_file(
    options: SendOptions, scene: Scene, source: Source, structure: Structure, file: Path
) -> Playback:
    from ..data.record.csv_files import is_table, parse_columns
    from ..data.record.formats import open_recording
    from ..data.send.playback import RecordedPackets
    from ..simulate.runs.tables import find_tables

    if is_table(file):
        if options.recorded is not None:
            raise UsageError(f"--recorded needs a recording; {file} is a table")
        return find_tables(file).open_playback(
            file,
            scene,
            source,
            structure,
            parse_columns(options.columns),
            rate=options.rate,
            declared=options.structure,
        )
    options.refuse(("columns",), f" needs a table; {file} is a recording")
    options.refuse(("rate",), " cannot be combined with a recording. Use --speed instead.")
    name = options.recorded or ""
    if not name:
        with open_recording(file) as recording:
            name = source.name if source.name in recording.sources else ""
    return RecordedPackets(file, name, structure, only_whole=goes_to_shm(options, source))


def _send_simulation(options: SendOptions, scenario: Path) -> int:
    from ..simulate.scenario_file import read_scenario
    from ..simulate.simulation import Simulation

    why = " cannot be combined with a scenario, which is sent in real time"
    options.refuse(("amplitude", "rate", "speed", "loop", "recorded", "columns"), why)
    overrides = {} if options.duration is None else {"run.duration": options.duration}
    declared = read_scenario(scenario, overrides)
    print_programs(declared)
    with Sender(Simulation(declared), options.scene, options) as sender:
        for _ in sender.run():
            pass
    return 0
