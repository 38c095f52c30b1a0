"""The part of `sero-mj send` that plays an LWR's controller."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ._arguments import not_negative, positive

if TYPE_CHECKING:
    from ..assemble.scene import Scene
    from ..receive.fri import FriReceiver

_OPTIONS = ("cycle", "loss", "quality", "seed")
_CYCLE = 0.005  # s; as in many a laboratory, and no burden for one core


def add_options(parser: Any) -> None:
    """Adds what only a source of `kind = "fri"` understands."""
    group = parser.add_argument_group('for a source of kind = "fri"')
    group.add_argument(
        "--cycle", type=positive, metavar="MS", help="1 to 100 ms between packets (default 5)"
    )
    group.add_argument("--loss", type=not_negative, metavar="P", help="share of lost packets")
    group.add_argument(
        "--quality",
        metavar="NAME",
        help="unacceptable, bad, ok, perfect or invalid, whatever is answered (default: by the "
        "answers, or ok where the scene gives none)",
    )
    group.add_argument("--seed", type=int, metavar="N", help="of what is lost (default 0)")


def refuse_options(options: argparse.Namespace) -> None:
    """Refuses these options for a source of another kind.

    Raises:
        UsageError: one of them is given.
    """
    for name in _OPTIONS:
        if getattr(options, name) is not None:
            raise UsageError(f'--{name} is for a scene whose source is of kind = "fri"')


def source_of(scene: Scene, name: str | None) -> FriReceiver | None:
    """The source of that name, or the scene's only one, if it is of this kind.

    Raises:
        DeclarationError: the scene's sources or routes are wrong.
    """
    from ..drive.wiring import wire
    from ..receive.fri import FriReceiver

    wiring = wire(scene).check(scene)
    if name is None and len(wiring.sources) == 1:
        name = next(iter(wiring.sources))
    source = wiring.sources.get(name or "")
    return source if isinstance(source, FriReceiver) else None


def send(options: argparse.Namespace, scene: Scene, source: FriReceiver) -> int:
    """Sends as the controller of the robot that the source moves; returns 0.

    Args:
        options: of the command.
        scene: with the robot.
        source: that receives the packets.

    Raises:
        UsageError: the options do not suit FRI, or the source moves no robot.
    """
    from ..send.fri_controller import FriController, NetworkFaults
    from ..send.sender import UdpSink

    if options.shm is not None:
        raise UsageError("--shm: FRI is a protocol of UDP; leave it out")
    if options.structure is not None:
        raise UsageError("--structure: FRI fixes it; leave it out")
    if options.cycle is not None and options.rate is not None:
        raise UsageError("--cycle and --rate say the same; give one")
    if (options.loss or 0.0) > 1.0:
        raise UsageError(f"--loss {options.loss:g}: expected a share from 0 to 1")
    if (options.seed or 0) < 0:
        raise UsageError(f"--seed {options.seed}: expected 0 or a number above")
    cycle = _CYCLE if options.rate is None else 1.0 / options.rate
    controller = FriController(
        scene.robots[_robot(scene, source.name)],
        cycle=cycle if options.cycle is None else options.cycle / 1e3,
        quality=options.quality or (None if source.answer else "ok"),
        amplitude=1.0 if options.amplitude is None else options.amplitude,
        faults=NetworkFaults(loss=options.loss or 0.0, seed=options.seed or 0),
    )
    to_port = options.port or source.udpport
    if not to_port:
        raise UsageError(f"source '{source.name}' of the scene has no port; give --port")
    with UdpSink(options.host or "127.0.0.1", to_port) as sink:
        print(
            f"sending FRI 1.0 measurements (916 bytes) to {sink.place} "
            f"every {controller.cycle * 1e3:g} ms; Ctrl-C stops",
            flush=True,
        )
        report = controller.run(sink, options.duration)
    print(
        f"made {report.packets} packets in {report.seconds:.2f} s ({report.rate:.1f} Hz), "
        f"lost {controller.faults.withheld} on purpose, got {controller.answers} answers, "
        f"late by {report.jitter_p50 * 1e6:.0f} us (median), {report.jitter_p99 * 1e6:.0f} us (p99)"
        + (f", {report.refused} refused by the system" if report.refused else "")
    )
    return 0


def _robot(scene: Scene, source: str) -> str:
    """The robot that a source moves, or has something to say of."""
    fed = {
        target.partition(".")[::2]: origin
        for target, origin in scene.routes.items()
        if f"{source}." in str(origin)
    }
    names = [name for name, _ in sorted(fed, key=lambda key: key[1] != "joint_angles")]
    found = [name for name in names if name in scene.robots]
    if not found:
        raise UsageError(f"no route leads from '{source}' to a robot: there is nothing to send")
    return found[0]
