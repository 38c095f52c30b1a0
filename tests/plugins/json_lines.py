"""A plug-in: a kind of source that reads JSON lines from a TCP server.

Each line is an object with a list of numbers per event:
{"values0": [...], "values1": [...]}.
Its pyproject.toml has:

    [project.entry-points."sero_mj.sources"]
    json_lines = "json_lines:JsonLines"
"""

from __future__ import annotations

import contextlib
import json
import socket
from typing import Any

import numpy as np
from pydantic import Field, PrivateAttr

from sero_mj.base.errors import SourceError
from sero_mj.data.receive.source import Source


class JsonLines(Source):
    """Connects to `host` and `port`; the structure declares the events of a line."""

    host: str = "127.0.0.1"
    port: int = Field(ge=1, le=65535)

    _socket: socket.socket | None = PrivateAttr(None)

    @property
    def about(self) -> str:
        """Kind and address of the source."""
        return f"JSON lines from {self.host}:{self.port}"

    def open(self) -> None:
        """Connects, and reads lines in the thread of the source."""
        self.close()
        try:
            self._socket = socket.create_connection((self.host, self.port), timeout=5)
        except OSError as error:
            where = f"{self.host}:{self.port}"
            raise SourceError(self.name, f"{where}: {error.strerror}") from error
        self._socket.settimeout(None)
        self.reset()
        self.start_receiving(self._read, interrupt=self._end_connection)

    def close(self) -> None:
        """Closes the connection."""
        self.stop_receiving()
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _end_connection(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _read(self, _: socket.socket) -> None:
        """Accepts lines; called again after a pause if it raises an exception."""
        assert self._socket is not None
        with self._socket.makefile("rb") as lines:
            for line in lines:
                self.accept([self._packet(line)])

    def _packet(self, line: bytes) -> bytes:
        """Encodes a line as a packet; returns an empty packet for an invalid line."""
        try:
            fields: dict[str, Any] = json.loads(line)
            events = {
                name: np.array(fields[name], float).reshape(shape)
                for name, shape in self.events.items()
            }
        except (ValueError, TypeError, KeyError):
            return b""
        return self.layout.encode(events)
