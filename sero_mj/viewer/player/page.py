"""`export_html`: writes a moving scene as one HTML file that needs no network."""

from __future__ import annotations

import base64
import hashlib
import html
import zlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from ...base.errors import UsageError
from ...robots.declared.scene import Scene
from .capture import CapturedRun, Mark, capture
from .encode import encode

# This script decompresses and starts the player. The content security policy contains its hash.
_LOADER = (
    "(async()=>{const e=document.getElementById('player'),"
    "b=Uint8Array.from(atob(e.textContent),c=>c.charCodeAt(0)),"
    "s=document.createElement('script');"
    "s.textContent=await new Response(new Blob([b]).stream().pipeThrough("
    "new DecompressionStream('deflate-raw'))).text();document.head.append(s)})()"
    ".catch(()=>{document.getElementById('problem').hidden=false;"
    "document.documentElement.dataset.ready='0'})"
)

_RUN = '<script type="text/plain" id="run">%%RUN%%</script>\n'
_PLAYER = '<script type="text/plain" id="player">%%PLAYER%%</script>\n<script>%%LOADER%%</script>\n'
_LINKS = """\
<link rel="icon" href="data:,">
<link rel="stylesheet" href="/uploads.css">
<link rel="stylesheet" href="/player.css">
<script src="/access.js" defer></script>
<script src="/uploads.js" defer></script>
<script src="/player.js" defer></script>
"""


def export_html(
    scene: Scene,
    path: Path | str,
    *,
    title: str = "",
    marks: Sequence[Mark] = (),
    meanings: Mapping[str, str] | None = None,
    **keywords: Any,
) -> list[str]:
    """Writes an HTML page that plays a recording, a simulation, or a few seconds of live data.

    Args:
        scene: scene to export, see `load_scene`.
        path: path of the .html file.
        title: title of the page; an empty string for the name of the scene.
        marks: marks on the timeline.
        meanings: mapping from labels on billboards to meanings, such as `A` to a file name.
        **keywords: other keyword arguments of `capture`, such as `seconds`, `fps` and `camera`.

    Returns:
        names of the sources without data. Their robots have the declared pose.

    Raises:
        SeroError: the scene, a source, the camera or the file has a problem, or the run is too
            long.
    """
    captured = capture(scene, marks=marks, **keywords)
    captured.meanings = meanings or {}
    write_page(captured, Path(path), title)
    return captured.silent


def write_page(captured: CapturedRun, path: Path, title: str = "") -> None:
    """Writes a run as an HTML page. If `title` is empty, the title is the name of the scene.

    Raises:
        UsageError: the file cannot be written.
    """
    title = title or captured.world.scene.name
    look = requested_look(captured.world.scene)
    try:
        run = packed(encode(captured, title))
        page = _page_alone(_RUN + _PLAYER, RUN=run, TITLE=title, LOOK=look)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def requested_look(scene: Scene) -> str:
    """Returns the requested look of a scene, or an empty string for the browser's setting."""
    return scene.view.look if "look" in scene.view.model_fields_set else ""


def live_page(look: str) -> str:
    """Returns the HTML of a live page. Its server must also serve `player_files`."""
    return _filled(KIND=" data-live", TITLE="sero-mj", LOOK=look, STYLE=_LINKS)


def player_files() -> dict[str, bytes]:
    """Returns the script and the style sheet of pages, as a mapping from file names to contents."""
    return {name: _static(name).encode() for name in ("player.js", "player.css")}


def cell_page(cell: str, title: str, look: str) -> str:
    """Returns the HTML of a notebook cell, which shows live data or a run stored in the notebook.

    The page sends `cell`, the id of the cell, to the kernel, see `extensions/notebook`.
    """
    return _page_alone(_PLAYER, KIND=f' data-cell="{html.escape(cell)}"', TITLE=title, LOOK=look)


def packed(data: bytes) -> str:
    """Compresses bytes to a raw deflate stream in base64, as pages contain it."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    return base64.b64encode(deflate.compress(data) + deflate.flush()).decode()


def _page_alone(scripts: str, **values: str) -> str:
    script, style = _static("player.js"), _static("player.css")
    policy = (
        f"default-src 'none'; script-src {hash_of(_LOADER)} {hash_of(script)}; "
        f"style-src {hash_of(style)}; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    values["TITLE"] = html.escape(values["TITLE"])
    return _filled(
        POLICY=f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
        STYLE=f"<style>{style}</style>\n",
        SCRIPT=fill_template(
            scripts, {"PLAYER": packed(script.encode()), "LOADER": _LOADER, **values}
        ),
        **values,
    )


def _static(name: str) -> str:
    return (files(__package__) / "static" / name).read_text(encoding="utf-8")


def _filled(**values: str) -> str:
    licences = html.escape(_static("LICENCES.txt"))
    nothing = {"POLICY": "", "SCRIPT": "", "KIND": ""}
    return fill_template(_static("page.html"), {"LICENCES": licences, **nothing, **values})


def fill_template(text: str, values: Mapping[str, str]) -> str:
    """Returns a text in which each `%%NAME%%` is replaced by a value."""
    parts = text.split("%%")
    parts[1::2] = [values[name] for name in parts[1::2]]
    return "".join(parts)


def hash_of(text: str) -> str:
    """Returns the source expression of a content security policy that allows a script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
