"""`open_recording`: opens a recording of this program or of a third-party format.

A package adds a format by an entry point in the group `sero_mj.recordings`. It names a function
`open(path, topics, tell)` with the arguments of `open_recording`. The function returns a
`PacketFile`, or None if the file has another format.
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

_REMEMBERED = 16  # recordings
_looked_into: OrderedDict[tuple[Any, ...], PacketFile] = OrderedDict()


def open_recording(
    path: Path | str,
    topics: Mapping[str, Source] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> PacketFile:
    """Opens a recording; raises RecordingError if it cannot be read, or no format fits.

    Args:
        topics: name of each source that is read from messages to the receiver of these messages; by
            default the format chooses the sources.
    """
    path = Path(path)
    try:
        return Recording(path)
    except RecordingError as error:  # also if its summary is missing, or in a damaged chunk
        why = error
    if not mcap_header(path)[1].startswith(LIBRARY):
        for open_format in load_all(RECORDINGS).values():
            found: PacketFile | None = open_format(path, topics, tell)
            if found is not None:
                return found
    raise why


def look_into(path: Path, topics: Mapping[str, Source] | None = None) -> PacketFile:
    """Returns a closed recording: its sources, its begin and its end; raises RecordingError.

    The result is cached until the file changes, because opening a scene needs it many times.

    Args:
        path: as for `open_recording`.
        topics: as for `open_recording`.
    """
    named = {name: source.decoding_fields() for name, source in (topics or {}).items()}
    key = path.absolute(), _state_of(path), json.dumps(named)
    found = _looked_into.get(key)
    if found is None:
        with open_recording(path, topics) as found:
            _looked_into[key] = found
        while len(_looked_into) > _REMEMBERED:
            _looked_into.popitem(last=False)
    return found


def _state_of(path: Path) -> tuple[tuple[str, int, int], ...]:
    # Names, sizes and times of the files of a folder, or of a file and its logs.
    logs = [path.with_name(f"{path.name}{ending}") for ending in ("", "-wal", "-journal")]
    found = []
    for file in sorted(path.iterdir()) if path.is_dir() else logs:
        with suppress(OSError):
            about = file.stat()
            found.append((file.name, about.st_size, about.st_mtime_ns))
    return tuple(found)


def mcap_header(path: Path) -> tuple[str, str]:
    """Returns profile and library of an MCAP file; empty if it cannot be read."""
    with suppress(OSError, ValueError, *BROKEN), open_file(path) as file:
        header = make_reader(file).get_header()
        return header.profile, header.library
    return "", ""
