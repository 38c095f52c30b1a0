"""`export_html`: a scene as it moves, as one HTML file that asks nobody for anything."""

from __future__ import annotations

import base64
import hashlib
import html
import zlib
from collections.abc import Sequence
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
    ".catch(()=>{document.getElementById('problem').hidden=false})"
)


def export_html(
    scene: Scene, path: Path | str, *, title: str = "", marks: Sequence[Mark] = (), **keywords: Any
) -> list[str]:
    """Writes a page that plays a scene: a recording, a run, or live sources for some seconds.

    Args:
        scene: what to show, see `load_scene`.
        path: the file; .html.
        title: of the page; the scene's name when empty.
        marks: on the time line.
        **keywords: of `capture`: `seconds` and `begin` (s), `fps`, `camera`, `wait` (s),
            `on_progress`.

    Returns:
        names of the sources without data; their robots have the declared pose.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or the file; or it is too long.
    """
    captured = capture(scene, marks=marks, **keywords)
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
    try:
        path.write_text(_page(encode(captured, title), title), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _page(run: bytes, title: str) -> str:
    static = files(__package__) / "static"
    script, style, page, licences = (
        (static / name).read_text(encoding="utf-8")
        for name in ("player.js", "player.css", "page.html", "LICENCES.txt")
    )
    policy = (
        f"default-src 'none'; script-src {_hash(_LOADER)} {_hash(script)}; "
        f"style-src {_hash(style)}; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    filled = {
        "POLICY": policy,
        "TITLE": html.escape(title),
        "STYLE": style,
        "LICENCES": html.escape(licences),
        "RUN": _packed(run),
        "PLAYER": _packed(script.encode()),
        "LOADER": _LOADER,
    }
    before, *parts = page.split("%%")
    for name, after in zip(parts[::2], parts[1::2], strict=True):
        before += filled[name] + after
    return before


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _packed(data: bytes) -> str:
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    return base64.b64encode(deflate.compress(data) + deflate.flush()).decode()
