"""An external package: a kind of source that reads JSON lines from a TCP server.

Each line is an object with a list of numbers per event: {"values0": [...], "values1": [...]}.
Its pyproject.toml has:

    [project.entry-points."sero_mj.sources"]
    json_lines = "json_lines:JsonLines"
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from typing import Any

import numpy as np
from pydantic import Field, PrivateAttr

from sero_mj.base.errors import SourceError
from sero_mj.data.receive.source import Source


class JsonLines(Source):
    """Connects to `host` and `port`; the structure says which events lines have."""

    host: str = "127.0.0.1"
    port: int = Field(ge=1, le=65535)

    _socket: socket.socket | None = PrivateAttr(None)
    _thread: threading.Thread | None = PrivateAttr(None)

    @property
    def about(self) -> str:
        """Kind and place in a few words."""
        return f"JSON lines from {self.host}:{self.port}"

    def open(self) -> None:
        """Connects, and reads lines on a thread."""
        self.close()
        try:
            self._socket = socket.create_connection((self.host, self.port), timeout=5)
        except OSError as error:
            raise SourceError(self.name, f"{self.host}:{self.port}: {error.strerror}") from error
        self._socket.settimeout(None)
        self.reset()
        self._thread = threading.Thread(target=self._read, args=(self._socket,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the connection."""
        if self._socket is not None and self._thread is not None:
            self.closing.set()
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._thread.join()
            self._socket.close()
        self._socket = self._thread = None

    def _read(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection.makefile("rb") as lines:
            for line in lines:
                self.accept([self._packet(line)])

    def _packet(self, line: bytes) -> bytes:
        """The line as a packet of the structure; what is no such line is a packet of no size."""
        try:
            fields: dict[str, Any] = json.loads(line)
            events = {k: np.reshape(np.array(fields[k], float), s) for k, s in self.events.items()}
        except (ValueError, TypeError, KeyError):
            return b""
        return self.layout.encode(events)
