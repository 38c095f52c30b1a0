"""`Sections`: the state of a page in named parts. Browsers receive only the changed parts.

A message contains the newest value of each part that has changed since the last message. A slow
browser skips intermediate states, but receives every part. `js/src/sections.js` parses messages.
"""

from __future__ import annotations

import json
import struct
import threading
from typing import Any

import numpy as np

_ALIGNED = 4  # alignment of binary parts, bytes
_CACHED = 4  # number of cached messages, which several browsers may need


class Sections:
    """The state of a page. One thread writes named parts, and another thread reads messages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._version = 0
        # For each name: version and contents, as JSON text or bytes.
        self._found: dict[str, tuple[int, str | bytes]] = {}
        self._messages: dict[tuple[int, int], bytes] = {}  # keys: old and new version

    @property
    def version(self) -> int:
        return self._version

    def put(self, name: str, value: Any) -> None:
        """Sets a part. Arrays and bytes are sent unchanged, and other values as JSON."""
        if isinstance(value, np.ndarray):
            value = value.tobytes()
        content = value if isinstance(value, bytes) else _json(value)
        with self._lock:
            last = self._found.get(name)
            if last is None or last[1] != content:
                self._version += 1
                self._found[name] = self._version, content

    def since(self, seen: int) -> tuple[bytes | None, int]:
        """Returns a message with all parts changed since a version, and the new version."""
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
                while len(self._messages) >= _CACHED:
                    del self._messages[next(iter(self._messages))]
                self._messages[seen, now] = message_of(changed)
            return self._messages[seen, now], now


def message_of(parts: dict[str, str | bytes]) -> bytes:
    """Encodes a mapping from names of parts to JSON text or bytes as a message."""
    values = [f"{_json(name)}:{part}" for name, part in parts.items() if isinstance(part, str)]
    payloads = {name: part for name, part in parts.items() if isinstance(part, bytes)}
    lengths = _json([[name, len(part)] for name, part in payloads.items()])
    head = f'{{"json":{{{",".join(values)}}},"bytes":{lengths}}}'.encode()
    head += b" " * (-len(head) % _ALIGNED)
    padded = [part + b"\0" * (-len(part) % _ALIGNED) for part in payloads.values()]
    return b"".join([struct.pack("<I", len(head)), head, *padded])


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
