"""Opens a recording that somebody else has named, if it is a file."""

from __future__ import annotations

from pathlib import Path

from ..errors import RecordingError
from ..files import open_file
from ..record.recording import Recording


def open_recording(path: Path | str) -> Recording:
    """Opens a recording that was named by somebody else.

    Raises:
        RecordingError: it cannot be read, is no recording, or not even a file: a pipe, say, which
            would keep its reader waiting.
    """
    try:
        open_file(path).close()
    except FileNotFoundError:
        pass  # told below
    except OSError as error:
        raise RecordingError(path, f"{error.strerror}") from error
    except ValueError:
        pass
    return Recording(path)
