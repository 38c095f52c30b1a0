"""What `sero-mj send` does for a source of kind `fri`: it sends as the controller of an LWR."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...base.errors import UsageError
from ...data.send.sender import UdpSink
from .controller import FriController, NetworkFaults
from .receiver import FriLayout, FriReceiver

if TYPE_CHECKING:
    from ...cli.send import SendOptions
    from ...robots.declared.scene import Scene

_CYCLE = 0.005  # s; as in many a laboratory, and no burden for one core


def send(options: SendOptions, scene: Scene, source: FriReceiver) -> int:
    """Sends as the controller of the robot that the source moves; returns 0."""
    layout = source.layout  # with the receiver's sign of torques
    if not isinstance(layout, FriLayout):
        reason = f"is {source.about}; played is FRI 1.0 of an LWR, or a recording by --play"
        raise UsageError(f"source '{source.name}' {reason}")
    options.refuse(("shm",), ": FRI is a protocol of UDP; leave it out")
    options.refuse(("structure",), ": FRI fixes it; leave it out")
    if options.cycle is not None and options.rate is not None:
        raise UsageError("--cycle and --rate say the same; give one")
    cycle = _CYCLE if options.rate is None else 1.0 / options.rate
    controller = FriController(
        scene.robots[_robot_of(scene, source.name)],
        cycle=cycle if options.cycle is None else options.cycle / 1e3,
        quality=options.quality or (None if source.answer else "ok"),
        amplitude=options.amplitude,
        faults=NetworkFaults(loss=options.loss, seed=options.seed),
        layout=layout,
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


def _robot_of(scene: Scene, source: str) -> str:
    fed = {
        target.partition(".")[::2]: origin
        for target, origin in scene.routes.items()
        if f"{source}." in str(origin)
    }
    names = [name for name, _ in sorted(fed, key=lambda key: not key[1].endswith("joint_angles"))]
    found = [name for name in names if name in scene.robots]
    if not found:
        raise UsageError(f"no route leads from '{source}' to a robot: there is nothing to send")
    return found[0]
