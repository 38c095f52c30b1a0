"""How Sphinx makes the site of these pages: `make docs`."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import sero_mj

project = "sero-mj"
copyright = "The sero-mj authors, Apache-2.0"
version = release = sero_mj.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_extra_path = ["_made/runs"]
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_title = f"sero-mj {version}"
exclude_patterns = ["_made/README.md", "_made/packages.md"]
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings give shapes and units
autodoc_default_options = {"members": True, "exclude-members": "model_config"}
napoleon_use_ivar = True

_HERE = Path(__file__).parent


def _declarations() -> str:
    """Every table of robot, scene and scenario files, from the declarations themselves."""
    from sero_mj.cli.listing import field_rows, scenario_tables, scene_tables

    lines = ["# Keys of files", ""]
    for title, declaration in {**scene_tables(), **scenario_tables()}.items():
        lines += [f"## `{title}`", "", "| key | default | |", "|---|---|---|"]
        for name, default, about in field_rows(declaration):
            cells = (f"`{name}`", f"`{default}`" if default else "", about)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines)


# Classes that only plug-ins need. They are imported from their modules.
_PLUGIN_CLASSES = (
    "data.receive.source.Source",
    "data.receive.connecting.ConnectingSource",
    "simulate.control.controller.Controller",
    "simulate.control.controller.ControllerDeclaration",
    "simulate.control.controller.Sensed",
    "simulate.control.controller.Target",
    "base.errors.Problem",
    "base.trust.RequestedAction",
)


def _reference() -> str:
    """Returns the page of the Python reference, in the order of the packages."""
    lines = ["Python", "======", "", ".. automodule:: sero_mj", "   :no-members:", ""]
    for name, home in sero_mj._HOME.items():
        item = getattr(sero_mj, name)
        kind = "class" if inspect.isclass(item) else "function"
        if kind == "class" and issubclass(item, Exception):
            kind = "exception"
        lines += [f".. auto{kind}:: sero_mj.{home}.{name}", ""]
    lines += ["Classes for plug-ins", "--------------------", ""]
    lines += ["Import these classes from their modules. :doc:`../plugins` and"]
    lines += [":doc:`../own_protocol` explain how to use them.", ""]
    for path in _PLUGIN_CLASSES:
        lines += [f".. autoclass:: sero_mj.{path}", ""]
    return "\n".join(lines)


# What `sero-mj` writes for the pages that play runs.
_RUNS = {
    "push.mcap": "simulate impedance_push --record {}",
    "fault.mcap": "simulate sensor_fault --record {}",
    "run_push.html": "export push.mcap -o {}",
    "run_fault.html": "compare fault.mcap --against-model -o {}",
    "run_justin.html": "export justin_push --to 3 -o {}",
}


def _write_runs() -> None:
    """Writes the runs that pages play, unless there are some of this player."""
    made, site = _HERE / "_made", _HERE / "_made" / "runs"
    site.mkdir(exist_ok=True)
    player = Path(sero_mj.__file__).parent / "viewer" / "player" / "static" / "player.js"
    for name, command in _RUNS.items():
        path = (site if name.endswith(".html") else made) / name
        if path.exists() and path.stat().st_mtime > player.stat().st_mtime:
            continue
        words = [*command.format(path).split(), "--quiet"]
        if path.suffix == ".mcap":
            words.append("--overwrite")
        subprocess.run([sys.executable, "-m", "sero_mj", *words], cwd=made, check=True)


def _link_structure(app: Any, name: str, source: list[str]) -> None:
    """Links to the generated page of the structure language instead of its source file."""
    source[0] = source[0].replace("../sero_mj/data/receive/STRUCTURE.md", "_made/structure.md")


def setup(app: Any) -> None:
    """Writes the pages that are generated from declarations and docstrings."""
    app.connect("source-read", _link_structure)
    made = _HERE / "_made"
    made.mkdir(exist_ok=True)
    structure = (_HERE.parent / "sero_mj" / "data" / "receive" / "STRUCTURE.md").read_text("utf-8")
    packages = (_HERE.parent / "README.md").read_text("utf-8").partition("## Packages")[2]
    pages = {
        "keys.md": _declarations(),
        "python.rst": _reference(),
        "structure.md": structure,
        "packages.md": "# Packages\n" + re.split(r"\n\[CONTRIB", packages)[0],  # in `inside.md`
    }
    for name, text in pages.items():
        file = made / name
        if not file.exists() or file.read_text("utf-8") != text:
            file.write_text(text, encoding="utf-8")
    _write_runs()
