"""Opens a page in the user's browser without showing its token to other users."""

from __future__ import annotations

import html
import os
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

from ..base.paths import make_temporary_folder
from ..viewer.image.backend import has_display


def can_open_browser() -> bool:
    """Whether this process has a terminal and a display, and does not run in an SSH session."""
    is_remote = bool(os.environ.get("SSH_CONNECTION") or os.environ.get("SSH_TTY"))
    return sys.stdout.isatty() and has_display() and not is_remote


def open_in_browser(url: str) -> None:
    """Opens a page in the user's browser, if a browser is installed.

    All users of a machine can read the arguments of processes. Therefore, the browser opens a
    file that redirects to the page and that only this user can read.
    """
    file = redirect_to(url)

    def open_it() -> None:
        with suppress(webbrowser.Error, OSError):
            webbrowser.open(file.as_uri())

    # A thread is needed, because some browsers block.
    threading.Thread(target=open_it, name="sero-mj browser", daemon=True).start()


def redirect_to(url: str) -> Path:
    """Writes an HTML file that redirects to a page; the file exists until this process ends."""
    file = make_temporary_folder() / "open.html"
    file.touch(0o600)
    target = html.escape(url)
    file.write_text(
        f'<!doctype html><meta charset="utf-8"><title>sero-mj</title>'
        f'<meta http-equiv="refresh" content="0; url={target}">'
        f'<a href="{target}">sero-mj</a>\n',
        encoding="utf-8",
    )
    return file
