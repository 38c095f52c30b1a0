"""Entry points: extensions by other packages, and sero-mj's own parts.

docs/plugins.md lists the groups. A package adds a kind in its pyproject.toml:

    [project.entry-points."sero_mj.sources"]
    json = "my_package:JsonLines"
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any

from .errors import PluginError, UnknownName, mismatch, shown

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

log = logging.getLogger(__name__)

IMPORTERS, ROBOTS, SOURCES = "sero_mj.importers", "sero_mj.robots", "sero_mj.sources"
CONTROLLERS, TARGET_MOTIONS = "sero_mj.controllers", "sero_mj.target_motions"
DECOR, TOOLS, COMMANDS = "sero_mj.decor", "sero_mj.tools", "sero_mj.commands"
NAMES, WHEN_IMPORTED = "sero_mj.names", "sero_mj.when_imported"
MESHES, EXPORTS = "sero_mj.meshes", "sero_mj.exports"
RECORDINGS, NETWORKS, COLUMNS = "sero_mj.recordings", "sero_mj.networks", "sero_mj.columns"
SNIPPETS, NOTEBOOKS = "sero_mj.snippets", "sero_mj.notebooks"
EXPLAINERS, BACKGROUNDS = "sero_mj.explainers", "sero_mj.backgrounds"
SENDERS, KNOWN_PACKETS = "sero_mj.senders", "sero_mj.known_packets"
SNIFFERS, TABLES = "sero_mj.sniffers", "sero_mj.tables"
LISTED, RENDERERS, ENGINES = "sero_mj.listed", "sero_mj.renderers", "sero_mj.engines"
_WITH_KIND = (CONTROLLERS, TARGET_MOTIONS)  # classes say their name, the entry point's, again
_OWN = "sero_mj"


@cache
def _entry_points() -> EntryPoints:
    # Finding packages takes a third of the time of `import sero_mj`, which needs none of them.
    from importlib.metadata import entry_points

    return entry_points()  # type: ignore[return-value]  # SelectableGroups is of Python 3.11


@cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Entry points of a group by name; sero-mj's own first, and never replaced by another's."""
    found: dict[str, EntryPoint] = {}
    points = _entry_points().select(group=group)
    for point in sorted(points, key=lambda point: not is_own(point)):
        found.setdefault(point.name, point)
    return found


def forget_plugins() -> None:
    """Looks for entry points again, where packages were installed since."""
    for found in (_entry_points, plugins, load_all):
        found.cache_clear()


def is_own(point: EntryPoint) -> bool:
    """Whether it is part of sero-mj."""
    return point.value.partition(".")[0] == _OWN


def is_own_class(kind: type) -> bool:
    """Whether a class is part of sero-mj."""
    return kind.__module__.partition(".")[0] == _OWN


def load_plugin(group: str, name: str, base: type | None = None) -> Any:
    """Imports what an entry point names, a subclass of `base` if given.

    Raises UnknownName, or PluginError if its package cannot be imported or it names something else.
    """
    known = plugins(group)
    if name not in known:
        what = group.rpartition(".")[2].removesuffix("s").replace("_", " ")
        raise UnknownName(what, name, known)
    try:
        found = known[name].load()
        if base is not None and not (isinstance(found, type) and issubclass(found, base)):
            raise TypeError(f"found {shown(found)}; expected a subclass of {base.__name__}")
        if isinstance(found, type) and (lacking := getattr(found, "__abstractmethods__", ())):
            raise TypeError(f"{found.__name__} lacks {', '.join(sorted(lacking))}")
        kind = getattr(found, "model_fields", {}).get("kind")
        if kind is None and group in _WITH_KIND:
            expected = f'{found.__name__} has no field kind: Literal["{name}"] = "{name}"'
            raise TypeError(expected)
        if kind is not None and kind.default != name:
            raise mismatch(kind.default, "the entry point's name", "found kind =")
        return found
    except Exception as error:  # whatever another package raises when it is imported
        raise PluginError(group, known[name], error) from error


@cache
def load_all(group: str, base: type | None = None) -> Mapping[str, Any]:
    """All of a group by name; logs once which cannot be loaded, and leaves them out.

    Args:
        base: of the classes that they have to name.
    """
    found: dict[str, Any] = {}
    for name in plugins(group):
        try:
            found[name] = load_plugin(group, name, base)
        except PluginError as error:
            log.warning("%s; left out", error)
    return found


def load_first(group: str, base: type) -> Any | None:
    """Makes an object of the first class of a group, without arguments; None without any."""
    return next((kind() for kind in load_all(group, base).values()), None)


def plugin_name(group: str, item: type) -> str:
    """The name under which a class is an entry point of a group.

    Raises UnknownName if it is not an entry point.
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
