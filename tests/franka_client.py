"""A commanding client of Franka's FCI, written with sockets from the headers of libfranka-common.

`python tests/franka_client.py PORT MODE VERSION FILE` writes its observations to FILE as JSON.
"""

from __future__ import annotations

import json
import math
import os
import select
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Any

from franka_server import STATES

OLD = [  # to version 5
    "Connect", "Move", "StopMove", "GetCartesianLimit", "SetCollisionBehavior",
    "SetJointImpedance", "SetCartesianImpedance", "SetGuidingMode", "SetEEToK", "SetNEToEE",
    "SetLoad", "SetFilters", "AutomaticErrorRecovery", "LoadModelLibrary",
]  # fmt: skip
TORQUES, POSITIONS, VELOCITIES = (2, 4), (0, 0), (0, 1)  # controller, generator
K = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0]
D = [50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0]


def names(version: int) -> list[str]:
    found = list(OLD)
    if version >= 6:
        found = [name for name in found if name not in ("GetCartesianLimit", "SetFilters")]
    if version >= 8:
        found.append("GetRobotModel")
    if version >= 10:
        found.remove("LoadModelLibrary")
    return found


class Client:
    def __init__(self, port: int, version: int = 10, host: str = "127.0.0.1") -> None:
        self.version, self.names = version, names(version)
        self.tcp = socket.create_connection((host, port), 5.0)
        self.tcp.settimeout(5.0)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("127.0.0.1", 0))
        self.udp.settimeout(5.0)
        self.number, self.answers = 0, dict[int, bytes]()
        self.robot: Any = None
        self.last: Any = None
        here = self.udp.getsockname()[1]
        self.greeting = self.answer(self.ask("Connect", struct.pack("<HH", version, here)))

    def ask(self, name: str, more: bytes = b"") -> int:
        self.number += 1
        command = self.names.index(name)
        self.tcp.sendall(struct.pack("<III", command, self.number, 12 + len(more)) + more)
        return self.number

    def exactly(self, size: int) -> bytes:
        found = b""
        while len(found) < size:
            more = self.tcp.recv(size - len(found))
            if not more:
                raise ConnectionError("closed")
            found += more
        return found

    def answer(self, number: int) -> bytes:
        while number not in self.answers:
            _, found, size = struct.unpack("<III", self.exactly(12))
            self.answers[found] = self.exactly(size - 12)
        return self.answers.pop(number)

    def do(self, name: str, more: bytes = b"") -> int:
        return self.answer(self.ask(name, more))[0]

    def read(self) -> Any:
        """Returns the newest unknown state."""
        before = getattr(self.last, "message_id", 0)
        is_new = False
        while not is_new or select.select([self.udp], [], [], 0)[0]:
            packet, self.robot = self.udp.recvfrom(4000)
            self.last = STATES[self.version].from_buffer_copy(packet)
            is_new = self.last.message_id > before
        return self.last

    def fresh(self) -> Any:
        """Returns a state sent after the last request."""
        self.read()
        return self.read()

    def move(self, modes: tuple[int, int], is_async: bool = False) -> tuple[int, int]:
        controller, generator = modes
        if self.version < 7 and generator == 4:
            generator = 1
        more = struct.pack("<II6d", controller, generator, *[0.1] * 6)
        if self.version >= 10:
            more += struct.pack("<?7d", is_async, *[0.0] * 7)
        number = self.ask("Move", more)
        return number, self.answer(number)[0]

    def command(self, message_id: int, q=None, dq=None, tau=None, last: bool = False) -> bytes:
        zeros = [0.0] * 7
        packed = struct.pack(
            "<Q7d7d24d??7d",
            *(message_id, *(q or zeros), *(dq or zeros), *[0.0] * 24, False),
            *(last and (tau is None or self.version < 7), *(tau or zeros)),
        )
        return packed + struct.pack("<?", last and tau is not None) * (self.version >= 7)

    def send(self, state: Any, **values: Any) -> None:
        self.udp.sendto(self.command(state.message_id, **values), self.robot)


def impedance(client: Client, cycles: int, amplitude: float = 0.2, hook=lambda k: True) -> int:
    """Follows a cosine by commanding torques; returns the status of the answer to Move."""
    number, status = client.move(TORQUES)
    assert status == 1, status
    state = client.read()
    while state.robot_mode != 2:
        state = client.read()
    start = list(state.q)
    for k in range(cycles):
        state = client.read()
        if state.robot_mode != 2:
            break
        away = amplitude * (1.0 - math.cos(math.pi * k / cycles)) / 2.0
        goal = [start[0] + away, *start[1:3], start[3] + away, *start[4:]]
        tau = [
            k_ * (g - q) - d * dq
            for k_, d, g, q, dq in zip(K, D, goal, state.q, state.dq, strict=True)
        ]
        # The rate is limited as in libfranka, so that the motion can begin while the robot moves.
        tau = [d + max(-0.99, min(0.99, t - d)) for t, d in zip(tau, state.tau_J_d, strict=True)]
        if hook(k):
            client.send(state, tau=tau, last=k == cycles - 1)
    return client.answer(number)[0]


def finish(client: Client, number: int) -> int:
    while client.read().robot_mode == 2:
        pass
    return client.answer(number)[0]


def bad_motion(client: Client, modes: tuple[int, int], value) -> tuple[int, Any]:
    """Commands `value` until the motion ends; returns its status and the next state."""
    number, status = client.move(modes)
    assert status == 1, status
    client.read()
    k = 0
    while (state := client.read()).robot_mode == 2:
        client.send(state, **value(state, k))
        k += 1
    return client.answer(number)[0], state


def flags(state: Any) -> list[int]:
    return [i for i, flag in enumerate(state.errors) if flag]


def violations(client: Client, found: dict[str, Any]) -> None:
    q0 = list(client.read().q_d)
    nothing = [0.0] * 7

    def first(value: float) -> list[float]:
        return [value, *nothing[1:]]

    cases = {
        "jump": (TORQUES, lambda s, k: {"tau": first(2.0 if k == 5 else 0.0)}),
        "range": (TORQUES, lambda s, k: {"tau": first(0.9 * k)}),
        "nan": (TORQUES, lambda s, k: {"tau": first(math.nan)}),
        "start": (POSITIONS, lambda s, k: {"q": [s.q_d[0] + 0.01, *s.q_d[1:]]}),
        "fast": (VELOCITIES, lambda s, k: {"dq": first(0.009 * k)}),
        "sudden": (VELOCITIES, lambda s, k: {"dq": first(0.1 if k else 0.0)}),
        "beyond": (VELOCITIES, lambda s, k: {"dq": [*nothing[:5], min(0.009 * k, 2.0), 0.0]}),
    }
    for name, (modes, value) in cases.items():
        status, state = bad_motion(client, modes, value)
        refused = client.move(TORQUES)[1]
        recovered = client.do("AutomaticErrorRecovery")
        after = client.fresh()
        found[name] = [status, flags(state), state.robot_mode, refused, recovered,
                       after.robot_mode, flags(after), sum(after.reflex_reason)]  # fmt: skip
        goal = time.monotonic() + 0.3  # it comes to rest while time continues
        while time.monotonic() < goal:
            client.read()
    found["q0"] = q0


def requests(client: Client, found: dict[str, Any]) -> None:
    client.read()
    pose = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.0, 0.0, 0.1, 1]
    sent = {
        "SetCollisionBehavior": [100.0] * 52,
        "SetJointImpedance": [1000.0] * 7,
        "SetCartesianImpedance": [1000.0] * 6,
        "SetEEToK": pose,
        "SetNEToEE": pose,
        "SetLoad": [0.5, 0.0, 0.0, 0.1, *[0.001, 0, 0, 0, 0.001, 0, 0, 0, 0.001]],
    }
    for name, values in sent.items():
        found[name] = client.do(name, struct.pack(f"<{len(values)}d", *values))
    found["SetGuidingMode"] = client.do("SetGuidingMode", bytes(7))
    found["StopMove"] = client.do("StopMove")
    found["wrong"] = [
        client.do("SetNEToEE", struct.pack("<16d", *[math.nan] * 16)),
        client.do("SetEEToK", struct.pack("<16d", *[2.0] * 16)),
        client.do("SetJointImpedance", struct.pack("<7d", *[-1.0] * 7)),
        client.do("SetLoad", struct.pack("<13d", *[1e300] * 13)),
    ]
    if client.version <= 5:
        found["SetFilters"] = client.do("SetFilters", struct.pack("<5d", *[100.0] * 5))
        limit = client.answer(client.ask("GetCartesianLimit", struct.pack("<i", 1)))
        found["GetCartesianLimit"] = [limit[0], len(limit)]
    if client.version <= 9:
        found["LoadModelLibrary"] = client.do("LoadModelLibrary", bytes(2))
    if client.version >= 8:
        urdf = client.answer(client.ask("GetRobotModel"))
        found["GetRobotModel"] = [urdf[0], urdf[1:].decode()]
    found["Cartesian"] = client.move((0, 2))[1]
    found["nothing"] = client.move((0, 4))[1] if client.version >= 7 else 5
    found["unknown"] = client.move((7, 0))[1]
    if client.version >= 10:
        found["async"] = client.move(POSITIONS, is_async=True)[1]
    state = client.fresh()
    found["O_T_EE"], found["q"] = list(state.O_T_EE), list(state.q)
    found["m_load"], found["EE_T_K"] = state.m_load, list(state.EE_T_K)


def greet(port: int) -> list[int]:
    """Sends invalid requests on separate connections; returns the answer to a wrong version."""
    for text in (b"\0\0", b"", b"\xff" * 40, struct.pack("<III", 1, 1, 12),
                 struct.pack("<IIIH", 0, 1, 15, 10)):  # fmt: skip
        with socket.create_connection(("127.0.0.1", port), 5.0) as probe:
            probe.sendall(text)
            if len(text) in (12, 14, 40):
                assert probe.recv(10) == b""
    other = Client(port, 9)
    other.tcp.close()
    return list(other.greeting)


def follow(client: Client, modes: tuple[int, int], value, found: dict[str, Any]) -> None:
    """Sends 500 commands, `value` of the first state and the share of time, and then finishes."""
    number, found["begun"] = client.move(modes)
    first = client.read()
    for k in range(500):
        state = client.read()
        client.send(state, **value(first, k / 499), last=k == 499)
    found["status"] = finish(client, number)


def positions(client: Client, found: dict[str, Any]) -> None:
    follow(client, POSITIONS, lambda s, share: {
        "q": [s.q_d[0] + 0.1 * (1.0 - math.cos(math.pi * share)) / 2.0, *s.q_d[1:]]
    }, found)  # fmt: skip


def velocities(client: Client, found: dict[str, Any]) -> None:
    follow(client, VELOCITIES, lambda s, share: {
        "dq": [0.2 * (1.0 - math.cos(2.0 * math.pi * share)) / 2.0, *[0.0] * 6]
    }, found)  # fmt: skip


def torques(client: Client, found: dict[str, Any]) -> None:
    found["status"] = impedance(client, 500)


def twice(client: Client, found: dict[str, Any]) -> None:
    found["status"] = [impedance(client, 200), impedance(client, 200, -0.2)]


def garbage(client: Client, found: dict[str, Any]) -> None:
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def noise(k: int) -> bool:
        client.udp.sendto(b"?" * 371, client.robot)
        client.udp.sendto(b"?", client.robot)
        stranger.sendto(client.command(client.last.message_id, tau=[50.0] * 7), client.robot)
        return True

    found["status"] = impedance(client, 200, hook=noise)
    with socket.create_connection(client.tcp.getpeername(), 5.0) as second:
        found["second"] = list(second.recv(10))


def stall(client: Client, found: dict[str, Any]) -> None:
    found["status"] = impedance(client, 300, hook=lambda k: k < 100)
    found["errors"] = flags(client.last)
    found["recovered"] = client.do("AutomaticErrorRecovery")
    client.fresh()
    found["again"] = impedance(client, 100)


def stop(client: Client, found: dict[str, Any]) -> None:
    def at_100(k: int) -> bool:
        if k == 100:
            found["stopped"] = client.do("StopMove")
        return True

    found["status"] = impedance(client, 300, hook=at_100)


def dies(client: Client, found: dict[str, Any]) -> None:
    impedance(client, 300, hook=lambda k: k < 100 or os._exit(0))


def fails(client: Client, found: dict[str, Any]) -> None:
    impedance(client, 300, hook=lambda k: k < 100 or os._exit(4))


def watches(client: Client, found: dict[str, Any]) -> None:
    file, end = Path(sys.argv[4]), time.monotonic() + 20.0
    while time.monotonic() < end:
        state = client.read()
        found["force"], found["q"] = list(state.O_F_ext_hat_K), list(state.q)
        found["tau_ext"] = list(state.tau_ext_hat_filtered)
        found["turned"] = list(state.K_F_ext_hat_K)
        file.with_suffix(".new").write_text(json.dumps(found))
        file.with_suffix(".new").replace(file)


MODES = {made.__name__: made for made in (
    torques, twice, positions, velocities, violations, requests, garbage, stall, stop, dies, fails,
    watches,
)}  # fmt: skip


if __name__ == "__main__":
    port, mode, version, file = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])
    seen: dict[str, Any] = {}
    if mode == "half":
        seen["other"], mode = greet(port), "torques"
    peer = Client(port, version)
    seen["greeting"] = list(peer.greeting)
    MODES[mode](peer, seen)
    peer.tcp.close()
    file.write_text(json.dumps(seen))
