"""`sero-mj send`: plays a motion as a robot would."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import UsageError
from . import _send_fri, _send_play
from ._arguments import Commands, add_command, not_negative, port, positive, read_scene
from ._sink import make_sink

if TYPE_CHECKING:
    from ..assemble.scene import Scene

_EPILOG = """\
examples:
  sero-mj send lwr_udp                        what the scene lwr_udp expects, at 1 kHz
  sero-mj send lwr_udp --rate 200 --duration 10
  sero-mj send lwr_fri --cycle 2 --loss 0.01  as the controller of a real LWR
  sero-mj send lwr --structure 7F7F --port 32000
  sero-mj send my_scene.toml --host 192.168.0.7
  sero-mj send lwr_shm --rate 10000           to the shared memory that the scene reads
  sero-mj send lwr_udp --play REC.mcap --loop what was recorded, as it came
  sero-mj send lwr_udp --play TABLE.csv --rate 500

Joints swing within their limits; torques are what the motion takes, by inverse dynamics. With a
robot's name the packet is its joint angles and its torques. Above 1 kHz values
go along straight lines between packets of 1 kHz. Ctrl-C stops.

A recording is sent bit for bit, at the times at which it came, where the scene's structure is the
recorded one; else its events are packed anew, by their names. The columns of a table are called
like the numbers of the packet (`values0[0]`, as export-csv has them), or are all of them in order.
"""


FASTEST = 1e5  # packets/s; a Python loop does not send faster


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "send",
        run,
        "play a motion to UDP or shared memory as a robot would",
        _EPILOG,
    )
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    parser.add_argument("--source", metavar="NAME", help="which source of the scene to feed")
    parser.add_argument("--structure", metavar="S", help="packet layout instead of the scene's")
    parser.add_argument(
        "--rate", type=positive, metavar="HZ", help="packets/s (default 1000; FRI: 200)"
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="seconds to send (default: until Ctrl-C)"
    )
    parser.add_argument("--host", help="where to (default 127.0.0.1)")
    parser.add_argument("--port", type=port, help="UDP port (default: the scene's, or 32000)")
    parser.add_argument(
        "--shm", metavar="NAME", help="write to this shared memory (default: the scene's)"
    )
    parser.add_argument(
        "--amplitude", type=not_negative, metavar="A", help="0 still to 1 (default)"
    )
    _send_play.add_options(parser)
    _send_fri.add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Sends; returns 0."""
    from ..receive.structure import Structure

    if (options.rate or 0.0) > FASTEST:
        raise UsageError(f"--rate {options.rate:g}: expected at most {FASTEST:g} packets/s")
    if options.shm is not None and (options.host is not None or options.port is not None):
        raise UsageError("--shm and --host or --port: packets go to one of the two; choose")
    if options.structure is not None:
        Structure(options.structure)  # its own error is clearer than what would follow from it
    scene = read_scene(options.scene)
    if not scene.sources and len(scene.robots) == 1:
        _declare_source(scene, options)
    if options.play is not None:
        return _send_play.send_file(options, scene, make_sink)
    _send_play.refuse_options(options)
    controller = _send_fri.source_of(scene, options.source)
    if controller is not None:
        return _send_fri.send(options, scene, controller)
    _send_fri.refuse_options(options)
    return _send_motion(options, scene)


def _send_motion(options: argparse.Namespace, scene: Scene) -> int:
    from ..send.play import MotionPackets
    from ..send.sender import PacketBuffer, paced, send

    rate = 1000.0 if options.rate is None else options.rate
    amplitude = 1.0 if options.amplitude is None else options.amplitude
    packets = MotionPackets(scene, options.source, options.structure, amplitude)
    structure, source = packets.structure, packets.source
    has = structure.events
    ahead = PacketBuffer(
        packets.at,
        structure,
        rate=rate,
        sequence=source.sequence if source.sequence in has else "",
        time=source.time if source.time in has else "",
        time_scale=source.time_scale,
    )
    with make_sink(options, source, structure) as sink:
        print(
            f"sending {structure.text} ({structure.size} bytes) to {sink.place} "
            f"at {rate:g} Hz; Ctrl-C stops",
            flush=True,
        )
        report = send(paced(ahead.at, rate, options.duration), sink, idle=ahead.idle)
    print(report)
    return 0


def _declare_source(scene: Scene, options: argparse.Namespace) -> None:
    """Declares what a robot without a scene is fed by: its joint angles and its torques."""
    robot = next(iter(scene.robots.values()))
    structure = options.structure or f"{robot.n}F{robot.n}F"
    where = {"kind": "udp", "port": 32000}
    if options.shm is not None:
        where = {"kind": "shm", "block": options.shm}
    scene.sources["robot"] = {**where, "structure": structure}
    scene.routes[f"{robot.name}.joint_angles"] = "robot.values0"
    if len(structure.upper().split("F")) > 2:
        scene.routes[f"{robot.name}.torques"] = "robot.values1"
