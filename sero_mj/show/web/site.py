"""Studio's page, with the title of the scene and a correction for touch screens."""

from __future__ import annotations

import html
from pathlib import Path

from mujoco.studio.web import web_server

from ...errors import RenderError

# After a tap a browser also sends mouse events, for pages without touch support. Studio 4.0 handles
# both, so a tap would count as two clicks.
_HEAD = """\
    <meta name="viewport" content="width=device-width, initial-scale=1" />
    <style>canvas { touch-action: none; }</style>
    <script>
      document.addEventListener("touchend", (event) => {
        if (event.cancelable) event.preventDefault();
      }, { passive: false });
    </script>
  </head>"""


def with_head(page: str, title: str) -> str:
    """Returns Studio's page with title and additions, where its head matches the expected text."""
    start, found, rest = page.partition("<title>")
    if found:
        page = start + found + html.escape(title) + rest[rest.find("</title>") :]
    return page.replace("  </head>", _HEAD, 1)


def find_files() -> Path:
    """Returns the folder with the files of Studio's page.

    Raises:
        RenderError: this MuJoCo has none.
    """
    found = web_server._find_static_files_dir()
    if found is None:
        raise RenderError(
            "no web page: this MuJoCo does not include the files of Studio's web client; "
            "`sero-mj view SCENE --window` needs none"
        )
    return Path(found)


def read_page(title: str) -> bytes:
    """Returns the page, which refers to Studio's files.

    Args:
        title: of the browser's tab.

    Raises:
        RenderError: this MuJoCo has no page.
    """
    return with_head((find_files() / "index.html").read_text("utf-8"), title).encode()
