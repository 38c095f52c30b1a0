"""Extensions by other packages: entry points, also used for sero-mj's own parts.

    sero_mj.importers       files of robots, see `robots.importers.importer.Importer`
    sero_mj.sources         kinds of sources in scenes, see `data.receive.source.Source`
    sero_mj.controllers     kinds of controllers, see `simulate.control.controller`
    sero_mj.target_motions  kinds of targets, see `simulate.control.target_motions`
    sero_mj.decor           visual features, see `viewer.decor.feature.Feature`
    sero_mj.tools           what pointer, keys and panel do, see `viewer.session.tool.Tool`
    sero_mj.commands        commands of `sero-mj`, see `cli`

A package adds a kind in its pyproject.toml, and no line of sero-mj changes:

    [project.entry-points."sero_mj.sources"]
    json = "my_package:JsonLines"
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from .errors import PluginError, UnknownName

IMPORTERS, SOURCES = "sero_mj.importers", "sero_mj.sources"
CONTROLLERS, TARGET_MOTIONS = "sero_mj.controllers", "sero_mj.target_motions"
DECOR, TOOLS, COMMANDS = "sero_mj.decor", "sero_mj.tools", "sero_mj.commands"
_OWN = "sero-mj"


@cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Entry points of a group by name; sero-mj's own first, and never replaced by another's."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group), key=lambda point: not is_own(point)):
        found.setdefault(point.name, point)
    return found


def is_own(point: EntryPoint) -> bool:
    """Whether it is part of sero-mj."""
    return point.dist is not None and point.dist.name == _OWN


def is_own_class(kind: type) -> bool:
    """Whether a class is part of sero-mj."""
    return kind.__module__.partition(".")[0] == "sero_mj"


def load_plugin(group: str, name: str) -> Any:
    """Imports the object of an entry point.

    Raises:
        UnknownName: no such name; names the nearest.
        PluginError: its package cannot be imported.
    """
    known = plugins(group)
    if name not in known:
        what = group.rpartition(".")[2].removesuffix("s").replace("_", " ")
        raise UnknownName(what, name, known)
    try:
        return known[name].load()
    except Exception as error:  # whatever another package raises when it is imported
        raise PluginError(group, known[name], error) from error


def plugin_name(group: str, item: type) -> str:
    """The name under which a class is an entry point of a group.

    Raises:
        UnknownName: it is not an entry point.
    """
    value = f"{item.__module__}:{item.__qualname__}"
    found = plugins(group)
    for name, point in found.items():
        if point.value == value:
            return name
    for name, point in found.items():  # its package may re-export it from another module
        with suppress(Exception):
            if not is_own(point) and point.load() is item:
                return name
    raise UnknownName(f"entry point in {group}", value, [p.value for p in plugins(group).values()])
