"""A simulated controller of Universal Robots with the part of RTDE that receiving clients need.

It encodes messages with `struct` according to UR's guide. `python tests/rtde_server.py` runs a
controller of a moving robot.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

TYPES = {
    "timestamp": "DOUBLE",
    **dict.fromkeys(
        ("actual_q", "actual_qd", "actual_current", "actual_current_as_torque", "target_moment",
         "target_q", "target_qd", "actual_TCP_force", "actual_TCP_pose"),
        "VECTOR6D",
    ),
    **dict.fromkeys(("robot_mode", "safety_mode"), "INT32"),
    **dict.fromkeys(("runtime_state", "robot_status_bits", "safety_status_bits"), "UINT32"),
}  # fmt: skip
CODES = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I"}


def message(kind: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def text_message(text: str, source: str = "PolyScope", level: int = 2) -> bytes:
    said, by = text.encode(), source.encode()
    return message("M", bytes([len(said)]) + said + bytes([len(by)]) + by + bytes([level]))


class RtdeServer:
    """A server that accepts one client at a time, answers its requests, and sends data packages.

    Args:
        version: version of the controller.
        types: types of variables by name; None for those of current controllers.
        answers: other answers by type of the request: bytes, or a function of the payload.
        host: address to listen on.
        port: port to listen on; 0 for any port.

    Attributes:
        asked: type and payload of all received messages.
        connections: number of clients so far.
        started: event that is set while a client waits for data packages.
    """

    def __init__(
        self,
        version: tuple[int, int, int, int] = (5, 25, 1, 0),
        types: dict[str, str] | None = None,
        answers: dict[str, Any] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        self.version, self.types = version, TYPES if types is None else types
        self.answers = answers or {}
        self.asked: list[tuple[str, bytes]] = []
        self.connections = 0
        self.started = threading.Event()
        self.recipe: list[str] = []
        self.rate = 0.0
        self._client: socket.socket | None = None
        self._listening = socket.create_server((host, port))
        self.port = int(self._listening.getsockname()[1])
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> RtdeServer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # ends `accept`
        self._listening.close()
        self.drop()
        self._thread.join(5.0)

    def drop(self) -> None:
        """Ends the connection to the client."""
        self.started.clear()
        if (client := self._client) is not None:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def send(self, *messages: bytes) -> None:
        """Sends messages to a client that waits for data packages."""
        assert self.started.wait(5.0)
        assert self._client is not None
        self._client.sendall(b"".join(messages))

    def package(self, recipe: int = 1, **values: Any) -> bytes:
        """Returns a data package of the requested recipe; omitted values are 0."""
        values = {"robot_mode": 7, "safety_mode": 1, **values}
        data = b""
        for name in self.recipe:
            code = CODES[self.types[name]]
            count = int(code[:-1] or 1)
            given = values.get(name, 0)
            numbers = [*given] if isinstance(given, list | tuple) else [given] * count
            data += struct.pack(f">{code}", *numbers)
        return message("U", bytes([recipe]) + data)

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
            self.connections += 1
            with contextlib.suppress(OSError), client:
                self._talk(client)
            self.started.clear()

    def _talk(self, client: socket.socket) -> None:
        if greeting := self.answers.get("hello"):
            client.sendall(greeting)
        received = b""
        while more := client.recv(4096):
            received += more
            while len(received) >= 3 and len(received) >= (size := received[0] << 8 | received[1]):
                kind, payload = chr(received[2]), received[3:size]
                received = received[size:]
                self.asked.append((kind, payload))
                answer = self.answers.get(kind)
                if answer is None:
                    client.sendall(self._answer(kind, payload))
                elif callable(answer):
                    client.sendall(answer(payload))
                else:
                    client.sendall(answer)
                if kind == "S":
                    self.started.set()

    def _answer(self, kind: str, payload: bytes) -> bytes:
        if kind == "V":
            return message("V", bytes([struct.unpack(">H", payload)[0] == 2]))
        if kind == "v":
            return message("v", struct.pack(">4I", *self.version))
        if kind == "O":
            (self.rate,) = struct.unpack_from(">d", payload)
            # ur_rtde ends the session in this way.
            self.recipe = payload[8:].decode().rstrip(",").split(",")
            found = ",".join(self.types.get(name, "NOT_FOUND") for name in self.recipe)
            return message("O", b"\1" + found.encode())
        if kind in "SP":
            return message(kind, b"\1")
        if kind == "I":
            return message("I", b"\1" + b"IN_USE")
        raise AssertionError(f"message {kind}")


def play(server: RtdeServer, seconds: float, values: Callable[[float], dict[str, Any]]) -> int:
    """Sends packages at the requested rate and returns their number."""
    assert server.started.wait(30.0)
    begin, sent = time.perf_counter(), 0
    while (t := sent / server.rate) < seconds and server.started.is_set():
        time.sleep(max(begin + t - time.perf_counter(), 0.0))
        server.send(server.package(timestamp=100.0 + t, **values(t)))
        sent += 1
    return sent


def moving(t: float) -> dict[str, Any]:
    """Returns the values of a nodding arm."""
    q = [0.3 * math.sin(0.8 * t), -1.6, 1.4 + 0.3 * math.sin(t), -1.4, -1.57, 0.0]
    torques = [4.0 * math.cos(0.8 * t), -62.0, -28.0 - 6.0 * math.sin(t), -4.0, 1.0, 0.4]
    return {
        "actual_q": q,
        "target_q": [angle + 0.05 for angle in q],
        "actual_current_as_torque": torques,
        "target_moment": [0.9 * torque for torque in torques],
        "actual_TCP_force": [10.0, 0.0, -30.0, 0.5, 0.0, 0.2],
    }


if __name__ == "__main__":
    host, port = (*sys.argv[1:], "127.0.0.1", "30004")[:2]
    with RtdeServer(host=host, port=int(port)) as server:
        while True:
            with contextlib.suppress(OSError, AssertionError):
                play(server, 1e9, moving)
