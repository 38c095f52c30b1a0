"""The receiver of `sero-mj send` and `simulate --send`, and a simulation as packets."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from ..base.errors import SimulationError, UsageError
from ..base.options import Option, Options, Port
from .arguments import read_scene

if TYPE_CHECKING:
    from ..data.receive.source import Source
    from ..data.receive.structure import Structure
    from ..data.send.sender import ShmWriter, UdpSink
    from ..simulate.simulation import Simulation

_EVERY = 0.05  # s between two looks at the clock, where nobody waits for packets


class SinkOptions(Options):
    """The structure of packets and their receiver.

    Attributes:
        source: which source of that scene to feed.
        structure: packet layout instead of that scene's.
        host: where to (default 127.0.0.1).
        port: UDP port (default: that scene's).
        shm: write to this shared memory (default: that scene's).
    """

    title: ClassVar[str] = "where packets go"
    source: Annotated[str | None, Option("NAME")] = None
    structure: Annotated[str | None, Option("S")] = None
    host: str | None = None
    port: Port | None = None
    shm: Annotated[str | None, Option("NAME")] = None


def goes_to_shm(options: SinkOptions, source: Source) -> bool:
    """Whether packets go to shared memory: with `--shm`, or if the source reads it."""
    return options.shm is not None or (source.memory is not None and options.port is None)


def make_sink(options: SinkOptions, source: Source, structure: Structure) -> UdpSink | ShmWriter:
    """Returns the receiver of packets: as in the options, else the address of the source."""
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
        reason = "is a recording, to which nothing can be sent; give --port, and --host"
        raise UsageError(f"source '{source.name}' of the scene {reason}")
    if not port:
        raise UsageError(f"source '{source.name}' of the scene has no port; give --port")
    message_of = source.message_of if options.structure is None else None
    return UdpSink(options.host or "127.0.0.1", port, message_of)


def in_real_time(simulation: Simulation) -> Iterator[tuple[int, int]]:
    """Runs a simulation in real time; yields each range of new rows of its log."""
    from ..simulate.real_time import RealTimeWatch

    timestep, watch = simulation.scenario.run.timestep, RealTimeWatch(simulation.scenario.name)
    begin, late = time.perf_counter(), 0.0
    while not simulation.is_done:
        time.sleep(_EVERY)
        first = simulation.step + 1 if simulation.step else 0
        due = int((time.perf_counter() - begin) / timestep)
        try:
            simulation.advance(min(max(due, simulation.step + 1), simulation.steps))
        finally:
            if simulation.step >= first:
                yield first, simulation.step + 1
        late = time.perf_counter() - begin - simulation.time
        watch.update(simulation.time, late)
    watch.finish(simulation.time, late)


class Sender:
    """Sends a simulation while it runs.

    Args:
        simulation: advanced by `run`.
        name: of the scene whose source receives the packets.
        options: structure and receiver that differ from the scene's.
    """

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
        """Sends a packet for every step; yields each range of new rows of the log."""
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
            f"{self._sink.place} in real time; Ctrl-C stops",
            flush=True,
        )
        self.report = send(packets(), self._sink)
        print(self.report)
        yield 0, simulation.step + 1
        if stopped:
            raise stopped[0]
