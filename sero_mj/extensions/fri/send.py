"""Implements `sero-mj send` for sources of kind `fri` by emulating the controller of an LWR."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...base.errors import UsageError
from ...data.send.sender import UdpSink
from .controller import FriController, NetworkFaults
from .receiver import FriLayout, FriReceiver

if TYPE_CHECKING:
    from ...cli.send import SendOptions
    from ...robots.declared.scene import Scene

_CYCLE = 0.005  # s; common in laboratories, and a light load for one core


def send(options: SendOptions, scene: Scene, source: FriReceiver) -> int:
    """Emulates the controller of the robot that the source moves, and returns the exit status."""
    layout = source.layout  # with the receiver's torque sign
    if not isinstance(layout, FriLayout):
        reason = f"is {source.about}; expected FRI 1.0 of an LWR. Use --play to send a recording"
        raise UsageError(f"source '{source.name}' {reason}")
    options.refuse(("shm",), ": FRI is a protocol over UDP; remove it")
    options.refuse(("structure",), ": FRI determines it; remove it")
    if options.cycle is not None and options.rate is not None:
        raise UsageError("--cycle and --rate both set the cycle; use one of them")
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
        raise UsageError(f"source '{source.name}' of the scene has no port; add --port")
    with UdpSink(options.host or "127.0.0.1", to_port) as sink:
        print(
            f"sending FRI 1.0 measurements (916 bytes) to {sink.place} "
            f"every {controller.cycle * 1e3:g} ms; Ctrl+C stops",
            flush=True,
        )
        report = controller.run(sink, options.duration)
    print(
        f"sent {report.packets} packets in {report.seconds:.2f} s ({report.rate:.1f} Hz), "
        f"dropped {controller.faults.lost} on purpose, received {controller.answers} answers, "
        f"delay {report.jitter_p50 * 1e6:.0f} us (median), {report.jitter_p99 * 1e6:.0f} us (p99)"
        + (f", {report.refused} rejected by the system" if report.refused else "")
    )
    return 0


def _robot_of(scene: Scene, source: str) -> str:
    routed = {
        target.partition(".")[::2]: origin
        for target, origin in scene.routes.items()
        if f"{source}." in str(origin)
    }
    names = [
        name for name, _ in sorted(routed, key=lambda key: not key[1].endswith("joint_angles"))
    ]
    found = [name for name in names if name in scene.robots]
    if not found:
        raise UsageError(f"no route leads from '{source}' to a robot, so there is nothing to send")
    return found[0]
