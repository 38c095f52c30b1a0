"""Sources by the `kind` that a scene names; other packages add kinds by entry points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import DeclarationError, PluginError, Problem, nearest
from ..plugins import SOURCES, load_plugin, plugins
from .source import Source


def make_source(name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Builds a source from a scene's table; a source object passes through.

    Raises:
        DeclarationError: no such kind, one that cannot be loaded, or wrong fields.
    """
    if not isinstance(declared, Mapping):
        if not hasattr(declared, "events"):
            message = f"found {declared!r}; expected a table with kind, or a source"
            raise DeclarationError([Problem("", message)])
        return declared
    fields = dict(declared)
    kind = fields.pop("kind", None)
    if "name" in fields:
        raise DeclarationError([Problem("name", "is what stands in the header; leave it out")])
    kinds = plugins(SOURCES)
    if not isinstance(kind, str) or kind not in kinds:
        expected = " or ".join(map(repr, kinds))
        if kind is None:
            message = f"is required; expected {expected}"
        else:
            message = f"found {kind!r}; expected {expected}"
            near = nearest(kind, kinds) if isinstance(kind, str) else None
            message += f"; did you mean '{near}'?" if near else ""
        raise DeclarationError([Problem("kind", message)])
    try:
        source: Source = load_plugin(SOURCES, kind)(**{**fields, "name": name})
    except PluginError as error:
        raise DeclarationError([Problem("kind", str(error))]) from error
    return source
