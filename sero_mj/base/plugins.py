"""Entry points of sero-mj and of third-party packages.

docs/plugins.md lists the groups. For example, a package adds a kind of source in pyproject.toml:

    [project.entry-points."sero_mj.sources"]
    json = "my_package:JsonLines"
"""

from __future__ import annotations

import logging
import warnings
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
EXPLAINERS, COMPARISONS = "sero_mj.explainers", "sero_mj.comparisons"
BACKGROUNDS = "sero_mj.backgrounds"
SENDERS, KNOWN_PACKETS = "sero_mj.senders", "sero_mj.known_packets"
SNIFFERS, TABLES = "sero_mj.sniffers", "sero_mj.tables"
LISTED, RENDERERS, ENGINES = "sero_mj.listed", "sero_mj.renderers", "sero_mj.engines"
_WITH_KIND = (CONTROLLERS, TARGET_MOTIONS)  # groups whose classes repeat the name as `kind`
_OWN = "sero_mj"


@cache
def _entry_points() -> EntryPoints:
    # This import takes a third of the time of `import sero_mj`, which needs no entry points.
    from importlib.metadata import entry_points

    return entry_points()  # type: ignore[return-value]  # Python 3.11: SelectableGroups


@cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Returns the entry points of a group by name. sero-mj takes precedence over other packages."""
    found: dict[str, EntryPoint] = {}
    points = _entry_points().select(group=group)
    for point in sorted(points, key=lambda point: not is_own(point)):
        found.setdefault(point.name, point)
    return found


def forget_plugins() -> None:
    """Clears the cache, so that packages installed since the last call are found."""
    for found in (_entry_points, plugins, load_all):
        found.cache_clear()


def is_own(point: EntryPoint) -> bool:
    """Returns whether an entry point is part of sero-mj."""
    return point.value.partition(".")[0] == _OWN


def is_own_class(kind: type) -> bool:
    """Returns whether a class is part of sero-mj."""
    return kind.__module__.partition(".")[0] == _OWN


def accept_old_names(kind: type, renamed: Mapping[str, str]) -> None:
    """Copies attributes of a third-party class from their earlier names to their current names.

    `renamed` maps earlier names to current names. Each earlier name causes a DeprecationWarning.
    """
    for old, new in renamed.items():
        if old in vars(kind) and not is_own_class(kind):
            text = f"`{kind.__name__}.{old}` is now named `{new}`"
            warnings.warn(text, DeprecationWarning, stacklevel=3)
            setattr(kind, new, vars(kind)[old])


def load_plugin(group: str, name: str, base: type | None = None) -> Any:
    """Loads an entry point, which must be a subclass of `base` unless `base` is None.

    Raises UnknownName if it does not exist, or PluginError if it cannot be loaded or is invalid.
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
    except Exception as error:  # third-party code may raise anything
        raise PluginError(group, known[name], error) from error


@cache
def load_all(group: str, base: type | None = None) -> Mapping[str, Any]:
    """Loads all entry points of a group, and returns them by name.

    Entry points that cannot be loaded, or are not subclasses of `base`, are skipped with a warning.
    """
    found: dict[str, Any] = {}
    for name in plugins(group):
        try:
            found[name] = load_plugin(group, name, base)
        except PluginError as error:
            log.warning("%s; skipped", error)
    return found


def load_first(group: str, base: type) -> Any | None:
    """Returns an instance of the first class of a group, or None if the group is empty."""
    return next((kind() for kind in load_all(group, base).values()), None)


def plugin_name(group: str, item: type) -> str:
    """Returns the name of the entry point for a class.

    Raises UnknownName if the class has no entry point in the group.
    """
    value = f"{item.__module__}:{item.__qualname__}"
    found = plugins(group)
    for name, point in found.items():
        if point.value == value:
            return name
    for name, point in found.items():  # the package may export the class from another module
        with suppress(Exception):
            if not is_own(point) and point.load() is item:
                return name
    raise UnknownName(f"entry point in {group}", value, [p.value for p in plugins(group).values()])
