"""A plug-in: a kind of source that reads JSON lines from a TCP server.

Each line is an object with a list of numbers per event:
{"values0": [...], "values1": [...]}.
Its pyproject.toml has:

    [project.entry-points."sero_mj.sources"]
    json_lines = "json_lines:JsonLines"
"""

from __future__ import annotations

import json
import socket
from typing import ClassVar

import numpy as np

from sero_mj.data.receive.connecting import ConnectingSource, Connection


class JsonLines(ConnectingSource):
    """Connects to `host` and `port`; the structure declares the events of a line."""

    host: str = "127.0.0.1"

    protocol: ClassVar[str] = "JSON lines"

    def converse(self, wake: socket.socket) -> None:
        """Receives lines until the connection ends; the base class reconnects."""
        with Connection(self.host, self.port, wake) as connection:
            self.note_connected()
            received = b""
            while connection.wait():
                *lines, received = (received + connection.read()).split(b"\n")
                for line in lines:
                    self._accept_line(line)

    def _accept_line(self, line: bytes) -> None:
        try:
            fields = json.loads(line)
            events = {
                name: np.array(fields[name], float).reshape(shape)
                for name, shape in self.events.items()
            }
        except (ValueError, TypeError, KeyError) as error:
            self.reject(line, f"invalid line: {error!r}")
        else:
            self.accept([self.layout.encode(events)])
