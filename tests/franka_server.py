"""A simulated Franka robot with the part of FCI that reading clients need.

It uses `ctypes` structures from the headers of libfranka-common. `python tests/franka_server.py`
runs a moving robot.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any


def _state_type(version: int) -> type[ctypes.LittleEndianStructure]:
    """Returns the packed type `RobotState` of a version, in the order of rbk_types.h."""
    real = ctypes.c_float if version >= 10 else ctypes.c_double
    flags = ctypes.c_bool * (41 if version >= 5 else 37)
    named: list[tuple[str, Any]] = [("message_id", ctypes.c_uint64)]

    def reals(count: int, *names: str) -> None:
        named.extend((name, real * count) for name in names)

    reals(16, "O_T_EE", "O_T_EE_d", "F_T_EE", "EE_T_K")
    if version >= 4:
        reals(16, "F_T_NE", "NE_T_EE")
    for tool in ("ee", "load"):
        named.append((f"m_{tool}", real))
        reals(9, f"I_{tool}")
        reals(3, f"F_x_C{tool}")
    reals(2, "elbow", "elbow_d")
    reals(7, "tau_J", "tau_J_d", "dtau_J", "q", "q_d", "dq", "dq_d", "ddq_d")
    for level in ("contact", "collision"):
        reals(7, f"joint_{level}")
        reals(6, f"cartesian_{level}")
    reals(7, "tau_ext_hat_filtered")
    reals(6, "O_F_ext_hat_K", "K_F_ext_hat_K", "O_dP_EE_d")
    if version >= 5:
        reals(3, "O_ddP_O")
    reals(2, "elbow_c", "delbow_c", "ddelbow_c")
    reals(16, "O_T_EE_c")
    reals(6, "O_dP_EE_c", "O_ddP_EE_c")
    reals(7, "theta", "dtheta")
    if version >= 10:
        named += [(f"accelerometer_{place}", real * 3 * 6) for place in ("top", "bottom")]
    named += [(f"{name}_mode", ctypes.c_uint8) for name in ("motion_generator", "controller")]
    named += [("errors", flags), ("reflex_reason", flags), ("robot_mode", ctypes.c_uint8)]
    named.append(("control_command_success_rate", real))
    name, bases = f"RobotState{version}", (ctypes.LittleEndianStructure,)
    return type(name, bases, {"_pack_": 1, "_layout_": "ms", "_fields_": named})


STATES = {version: _state_type(version) for version in range(3, 11)}


def state(version: int = 10, **values: Any) -> bytes:
    """Returns a state; omitted values are 0, except that the robot is idle."""
    made = STATES[version]()
    for name, value in {"robot_mode": 1, **values}.items():
        if isinstance(value, list | tuple):
            getattr(made, name)[:] = value
        else:
            setattr(made, name, value)
    return bytes(made)


def answer(status: int = 0, version: int = 10, command: int = 0, number: int = 1) -> bytes:
    return struct.pack("<IIIBH", command, number, 15, status, version)


class FrankaServer:
    """A server that accepts one client at a time, answers its request, and sends states.

    Args:
        version: version of the server; like the robot, it rejects other versions.
        answers: answers to successive requests instead of the correct one. After an empty answer,
            the connection is closed.
        host: address to listen on.
        port: port to listen on; 0 for any port.

    Attributes:
        asked: bytes that each client has sent.
        connections: number of clients so far.
        started: event that is set while a client waits for states.
        on_start: function that is called when a client begins to wait.
    """

    def __init__(
        self,
        version: int = 10,
        answers: list[bytes] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        self.version, self.answers = version, answers or []
        self.asked: list[bytes] = []
        self.connections = self._count = 0
        self.started = threading.Event()
        self._client: socket.socket | None = None
        self._states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._states.bind((host, 0))
        self._listening = socket.create_server((host, port))
        self.port = int(self._listening.getsockname()[1])
        self.to = ("", 0)
        self.on_start: Callable[[], object] = lambda: None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> FrankaServer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # ends `accept`
        self._listening.close()
        self.drop()
        self._thread.join(5.0)
        self._states.close()

    def drop(self) -> None:
        """Ends the connection to the client."""
        self.started.clear()
        if (client := self._client) is not None:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def say(self, text: bytes) -> None:
        """Sends bytes over TCP to a client that waits for states."""
        assert self.started.wait(5.0) and self._client is not None
        self._client.sendall(text)

    def send(self, *datagrams: bytes) -> None:
        """Sends datagrams to a client that waits for states."""
        assert self.started.wait(5.0)
        for datagram in datagrams:
            self._states.sendto(datagram, self.to)

    def state(self, **values: Any) -> bytes:
        """Returns the next state in the version of the server."""
        self._count += 1
        return state(self.version, **{"message_id": self._count, **values})

    def _serve(self) -> None:
        while True:
            try:
                client, address = self._listening.accept()
            except OSError:
                return
            self._client = client
            self.connections += 1
            with contextlib.suppress(OSError), client:
                self._talk(client, address[0])
            self.started.clear()

    def _talk(self, client: socket.socket, host: str) -> None:
        question = b""
        while len(question) < 16:
            more = client.recv(16 - len(question))
            if not more:
                return
            question += more
        self.asked.append(question)
        number, version, port = struct.unpack("<4xI4xHH", question)
        self.to = (host, port)
        is_right = version == self.version
        good = answer(0 if is_right else 1, self.version, number=number)
        said = self.answers.pop(0) if self.answers else good
        client.sendall(said)
        if said == good and is_right:
            self.started.set()
            self.on_start()
        elif said in (b"", good):
            return
        while more := client.recv(4096):
            self.asked[-1] += more


def play(server: FrankaServer, seconds: float, values: Callable[[float], dict[str, Any]]) -> int:
    """Sends states at 1 kHz and returns their number."""
    assert server.started.wait(30.0)
    begin, sent = time.perf_counter(), 0
    while (t := sent * 1e-3) < seconds and server.started.is_set():
        time.sleep(max(begin + t - time.perf_counter(), 0.0))
        server.send(server.state(**values(t)))
        sent += 1
    return sent


def moving(t: float) -> dict[str, Any]:
    """Returns the state of a nodding arm."""
    q = [0.3 * math.sin(0.8 * t), -0.8, 0.0, -2.3 + 0.2 * math.sin(t), 0.0, 1.6, 0.8]
    torques = [0.5 * math.cos(t), -22.0, -1.0, 21.0 + 2.0 * math.sin(t), 1.0, 2.2, 0.0]
    return {
        "q": q,
        "q_d": [angle + 0.05 for angle in q],
        "tau_J": torques,
        "O_F_ext_hat_K": [5.0, 0.0, -12.0, 0.5, 0.0, 0.2],
        "robot_mode": 2,
    }


if __name__ == "__main__":
    host, port = (*sys.argv[1:], "127.0.0.1", "1337")[:2]
    with FrankaServer(host=host, port=int(port)) as server:
        while True:
            with contextlib.suppress(OSError, AssertionError):
                play(server, 1e9, moving)
