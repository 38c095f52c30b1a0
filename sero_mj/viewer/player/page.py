"""`export_html`: a scene as it moves, as one HTML file that makes no requests."""

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
from .capture import Capture, Mark, capture
from .encode import encode

# Adds the player, which is compressed as the run is; the policy knows its hash.
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


def export_html(
    scene: Scene,
    path: Path | str,
    *,
    title: str = "",
    marks: Sequence[Mark] = (),
    meanings: Mapping[str, str] | None = None,
    **keywords: Any,
) -> list[str]:
    """Writes a page that plays a scene: a recording, a run, or live sources for some seconds.

    Args:
        scene: what to show, see `load_scene`.
        path: the file; .html.
        title: of the page; the scene's name when empty.
        marks: on the time line.
        meanings: of labels on cards, by label: the file that `A` is, say.
        **keywords: of `capture`: `seconds` and `begin` (s), `fps`, `camera`, `follow`,
            `wait` (s), `on_progress`.

    Returns:
        names of the sources without data; their robots have the declared pose.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or the file; or it is too long.
    """
    captured = capture(scene, marks=marks, **keywords)
    captured.meanings = meanings or {}
    write_page(captured, Path(path), title)
    return captured.silent


def write_page(captured: Capture, path: Path, title: str = "") -> None:
    """Writes a run that was collected as a page.

    Args:
        captured: the run.
        path: the file.
        title: of the page; the scene's name when empty.

    Raises:
        UsageError: it cannot be written.
    """
    title = title or captured.world.scene.name
    look = look_asked_for(captured.world.scene)
    try:
        path.write_text(_page(encode(captured, title), title, look), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def look_asked_for(scene: Scene) -> str:
    """Returns the look that a scene or an option asks for; empty where the browser's is taken."""
    return scene.view.look if "look" in scene.view.model_fields_set else ""


def cell_page(cell: str, title: str, look: str) -> str:
    """Returns a page for a cell of a notebook: live, or the run that its notebook has kept.

    Args:
        cell: id, which the page tells its kernel, see `web/notebook.py`.
        title: of the page.
        look: see `look_asked_for`.
    """
    bodies = "".join(
        f'<template id="{name}">{_body(template)}</template>\n'
        for name, template in (("live", "live.html"), ("file", "page.html"))
    )
    head, _, _ = _static("page.html").partition("<body>")
    head = head.replace("<html", f'<html data-cell="{html.escape(cell)}"')
    page = f"{head}<body>\n{bodies}{_PLAYER}</body>\n</html>\n"
    return _filled(page, TITLE=html.escape(title), LOOK=look)


def packed(data: bytes) -> str:
    """Returns bytes as pages hold them: base64 of a raw deflate stream."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    return base64.b64encode(deflate.compress(data) + deflate.flush()).decode()


def _page(run: bytes, title: str, look: str) -> str:
    page = _static("page.html").replace("</body>", f"{_RUN}{_PLAYER}</body>")
    return _filled(page, TITLE=html.escape(title), RUN=packed(run), LOOK=look)


def _static(name: str) -> str:
    return (files(__package__) / "static" / name).read_text(encoding="utf-8")


def _body(name: str) -> str:
    """Returns what is in the body of a page."""
    return _static(name).partition("<body")[2].partition(">")[2].partition("</body>")[0]


def _filled(page: str, **values: str) -> str:
    """Returns a page with its placeholders filled in, which may stand in values as well."""
    script, style = _static("player.js"), _static("player.css")
    policy = (
        f"default-src 'none'; script-src {_hash(_LOADER)} {_hash(script)}; "
        f"style-src {_hash(style)}; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    filled = {
        "POLICY": policy,
        "STYLE": style,
        "LICENCES": html.escape(_static("LICENCES.txt")),
        "PLAYER": packed(script.encode()),
        "LOADER": _LOADER,
        **values,
    }
    before, *parts = page.split("%%")
    for name, after in zip(parts[::2], parts[1::2], strict=True):
        before += filled[name] + after
    return before


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
