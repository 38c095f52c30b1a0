"""`Sections`: the state of a page in named parts, of which a browser is sent what has changed.

A slow browser misses states, but no part: a message has the newest of all that changed since the
last one. `js/src/sections.js` reads messages.
"""

from __future__ import annotations

import json
import struct
import threading
from typing import Any

import numpy as np

_ALIGNED = 4  # bytes
_KEPT = 4  # messages, for browsers that have seen the same


class Sections:
    """The parts of a page's state; one thread puts them, another one takes messages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._version = 0
        # Version and contents by name: JSON as text, or bytes.
        self._found: dict[str, tuple[int, str | bytes]] = {}
        self._messages: dict[tuple[int, int], bytes] = {}  # by what was seen, and is now

    @property
    def version(self) -> int:
        return self._version

    def put(self, name: str, value: Any) -> None:
        """Sets a part: an array is sent as its bytes, everything else as JSON."""
        if isinstance(value, np.ndarray):
            value = value.tobytes()
        content = value if isinstance(value, bytes) else _json(value)
        with self._lock:
            last = self._found.get(name)
            if last is None or last[1] != content:
                self._version += 1
                self._found[name] = self._version, content

    def since(self, seen: int) -> tuple[bytes | None, int]:
        """Returns a message with all that changed after a version, or None; and the new version."""
        with self._lock:
            now = self._version
            if seen == now:
                return None, now
            if (seen, now) not in self._messages:
                changed = {
                    name: content
                    for name, (version, content) in self._found.items()
                    if version > seen
                }
                while len(self._messages) >= _KEPT:
                    del self._messages[next(iter(self._messages))]
                self._messages[seen, now] = message_of(changed)
            return self._messages[seen, now], now


def message_of(parts: dict[str, str | bytes]) -> bytes:
    """Returns a message of parts by name: JSON as text, or bytes."""
    values = [f"{_json(name)}:{part}" for name, part in parts.items() if isinstance(part, str)]
    payloads = {name: part for name, part in parts.items() if isinstance(part, bytes)}
    lengths = _json([[name, len(part)] for name, part in payloads.items()])
    head = f'{{"json":{{{",".join(values)}}},"bytes":{lengths}}}'.encode()
    head += b" " * (-len(head) % _ALIGNED)
    padded = [part + b"\0" * (-len(part) % _ALIGNED) for part in payloads.values()]
    return b"".join([struct.pack("<I", len(head)), head, *padded])


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
