"""Opens recordings of sero-mj and recordings in third-party formats.

An entry point in the group `sero_mj.recordings` adds a format. It is a function with the arguments
of `open_recording` that returns a `PacketFile`, or None if the file has another format.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from ...base.errors import RecordingError
from ...base.paths import open_file
from ...base.plugins import RECORDINGS, load_all
from ..receive.source import Source
from .mcap_reader import BROKEN
from .recording import PacketFile, Recording
from .recording_format import LIBRARY

_MAX_CACHED = 16  # recordings
_cached: OrderedDict[tuple[Any, ...], PacketFile] = OrderedDict()


def open_recording(
    path: Path | str,
    topics: Mapping[str, Source] | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> PacketFile:
    """Opens a recording; raises RecordingError if it cannot be read or no format matches.

    Args:
        topics: mapping from source names to receivers of their messages, for recordings of messages
            (default: the sources that the format chooses).
        report: function called with notes for the user.
    """
    path = Path(path)
    try:
        return Recording(path)
    except RecordingError as error:
        why = error
    if not mcap_header(path)[1].startswith(LIBRARY):
        for open_format in load_all(RECORDINGS).values():
            found: PacketFile | None = open_format(path, topics, report)
            if found is not None:
                return found
    raise why


def look_into(path: Path, topics: Mapping[str, Source] | None = None) -> PacketFile:
    """Returns a closed recording, whose sources and times can be read; see `open_recording`.

    The result is cached until the file changes, because opening a scene uses it many times.
    """
    named = {name: source.decoding_fields() for name, source in (topics or {}).items()}
    key = path.absolute(), _state_of(path), json.dumps(named)
    found = _cached.get(key)
    if found is None:
        with open_recording(path, topics) as found:
            _cached[key] = found
        while len(_cached) > _MAX_CACHED:
            _cached.popitem(last=False)
    return found


def _state_of(path: Path) -> tuple[tuple[str, int, int], ...]:
    # Names, sizes and times of the files in a folder, or of a file and its SQLite logs.
    logs = [path.with_name(f"{path.name}{ending}") for ending in ("", "-wal", "-journal")]
    found = []
    for file in sorted(path.iterdir()) if path.is_dir() else logs:
        with suppress(OSError):
            about = file.stat()
            found.append((file.name, about.st_size, about.st_mtime_ns))
    return tuple(found)


def mcap_header(path: Path) -> tuple[str, str]:
    """Returns the profile and library of an MCAP file, or empty texts if it cannot be read."""
    with suppress(OSError, ValueError, *BROKEN), open_file(path) as file:
        header = make_reader(file).get_header()
        return header.profile, header.library
    return "", ""
