"""`sero-mj send`: plays a motion as a robot would."""

from __future__ import annotations

import argparse

from ..errors import UsageError
from . import send_fri
from .arguments import Commands, add_command, not_negative, port, positive, read_scene_or_model

_EPILOG = """\
examples:
  sero-mj send lwr_udp                        what the scene lwr_udp expects, at 1 kHz
  sero-mj send lwr_udp --rate 200 --duration 10
  sero-mj send lwr_fri --cycle 2 --loss 0.01  as the controller of a real LWR
  sero-mj send lwr --structure 7F7F --port 32000
  sero-mj send my_scene.toml --host 192.168.0.7

Joints swing within their limits; torques are what the motion takes, by inverse dynamics. With a
robot's name the packet is its joint angles and its torques. Ctrl-C stops.
"""


FASTEST = 1e5  # packets/s; a Python loop does not send faster


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "send", run, "play a motion to a UDP port as a robot would", _EPILOG
    )
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    parser.add_argument("--source", metavar="NAME", help="which UDP source of the scene to feed")
    parser.add_argument("--structure", metavar="S", help="packet layout instead of the scene's")
    parser.add_argument(
        "--rate", type=positive, metavar="HZ", help="packets/s (default 1000; FRI: 200)"
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="seconds to send (default: until Ctrl-C)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="where to (default 127.0.0.1)")
    parser.add_argument("--port", type=port, help="UDP port (default: the scene's, or 32000)")
    parser.add_argument(
        "--amplitude", type=not_negative, default=1.0, metavar="A", help="0 still to 1 (default)"
    )
    send_fri.add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Sends; returns 0."""
    from ..drive.play import MotionPackets
    from ..drive.send import send
    from ..receive.structure import Structure

    rate = 1000.0 if options.rate is None else options.rate
    if rate > FASTEST:
        raise UsageError(f"--rate {rate:g}: expected at most {FASTEST:g} packets/s")
    if options.structure is not None:
        Structure(options.structure)  # its own error is clearer than what would follow from it
    scene = read_scene_or_model(options.scene)
    if not scene.sources and len(scene.robots) == 1:
        robot = next(iter(scene.robots.values()))
        structure = options.structure or f"{robot.n}F{robot.n}F"
        scene.sources["udp"] = {"kind": "udp", "port": 32000, "structure": structure}
        scene.routes[f"{robot.name}.joint_angles"] = "udp.values0"
        if len(structure.upper().split("F")) > 2:
            scene.routes[f"{robot.name}.torques"] = "udp.values1"
    controller = send_fri.source_of(scene, options.source)
    if controller is not None:
        return send_fri.send(options, scene, controller)
    send_fri.refuse_options(options)
    packets = MotionPackets(scene, options.source, options.structure, options.amplitude)
    to_port = options.port or packets.source.udpport
    if not to_port:
        raise UsageError(f"source '{packets.source.name}' of the scene has no port; give --port")
    print(
        f"sending {packets.structure.text} ({packets.structure.size} bytes) to "
        f"{options.host}:{to_port} at {rate:g} Hz; Ctrl-C stops",
        flush=True,
    )
    report = send(packets.at, options.host, to_port, rate=rate, duration=options.duration)
    print(
        f"sent {report.packets} packets in {report.seconds:.2f} s ({report.rate:.1f} Hz), "
        f"late by {report.jitter_p50 * 1e6:.0f} us (median), {report.jitter_p99 * 1e6:.0f} us (p99)"
        + (f", {report.refused} refused by the system" if report.refused else "")
    )
    return 0
