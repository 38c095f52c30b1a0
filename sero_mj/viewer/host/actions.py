"""`Actions`: what keys and menus of a window or page do."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial

from ...base.errors import SeroError
from ..image.clicks import KEYS
from ..session.keys import HOST_KEYS, MORE_KEYS, Key
from ..session.tool import Action, Tool, Tools

log = logging.getLogger(__name__)


class Actions:
    """The actions of a host and of its tools by name, and the keys that perform them.

    Args:
        tools: whose actions and keys are added to these; they replace none.
    """

    def __init__(
        self, own: Mapping[str, Action], tools: Tools, say: Callable[[str, bool], None]
    ) -> None:
        self._actions, self._tools, self._say = dict(own), tools, say
        self._keys = {**HOST_KEYS, **MORE_KEYS, **{key: Key(f"switch_{key}") for key in KEYS}}
        for name, tool in tools.items():
            self._take_actions(name, tool)
        for name, tool in tools.items():
            self._take_keys(name, tool)

    def _act(self, tool: Tool, act: Action) -> str | None:
        return self._tools.call(tool, lambda _: act())

    def _take_actions(self, name: str, tool: Tool) -> None:
        for action, act in (self._tools.call(tool, lambda tool: tool.actions()) or {}).items():
            if action in self._actions:
                log.warning(
                    "the action %s of the tool %s is left out: another one has this name; "
                    "%s_%s would be its own", action, name, name, action,
                )  # fmt: skip
                continue
            self._actions[action] = partial(self._act, tool, act)

    def _take_keys(self, name: str, tool: Tool) -> None:
        for key, entry in tool.keys.items():
            action = entry[0]
            if key in self._keys:
                log.warning("the key %s of the tool %s is taken; it does nothing", key, name)
            elif action not in self._actions:
                log.warning("the tool %s has the key %s, but no action %s", name, key, action)
            self._keys.setdefault(key, Key(*entry))

    def add(self, own: Mapping[str, Action]) -> None:
        self._actions.update(own)

    def press(self, key: str, *, is_repeat: bool = False) -> None:
        """Performs the action of a key, if it has one."""
        found = self._keys.get(key)
        if found is not None and found.action in self._actions and found.repeats >= is_repeat:
            self.perform(found.action)

    def perform(self, action: str) -> None:
        try:
            message = self._actions[action]()
        except SeroError as error:
            self._say(str(error), True)
            return
        if message:
            self._say(message, False)
