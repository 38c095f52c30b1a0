"""What the names in routes stand for: events, outputs, frames and units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..assemble.inputs import Input
from ..assemble.scene import Scene
from ..errors import Problem, did_you_mean, nearest
from ..receive.source import SIGNALS, Source
from ._expression import Value, constant, numbers_of
from ._units import UNITS, dimension_of
from .affine import Origin

FWD_KIN = "fwd_kin_base_to_flange"
# What can be read of robots, doubles and arrows: what can be set, but for switches and poses.
_READABLE = ("angles", "values", "vector")


class Names:
    """Everything that an origin can name.

    Args:
        scene: robots and routes.
        sources: those of the scene's that are right.
        inputs: all of the scene's, by `name.key`.
    """

    def __init__(
        self, scene: Scene, sources: Mapping[str, Source], inputs: Mapping[str, Input]
    ) -> None:
        self._scene = scene
        self._sources = sources
        self._frames = scene.named_frames()
        self._outputs = {target: item for target, item in inputs.items() if item.kind in _READABLE}
        self._owners = {item.name for item in self._outputs.values()}

    def is_frame(self, text: str) -> bool:
        """Whether a name is that of a frame, and not of numbers."""
        return "/" in text or text in self._frames

    def is_fwd_kin(self, text: str) -> bool:
        """Whether a name is that of a robot's forward kinematics."""
        name, _, key = text.partition(".")
        return key == FWD_KIN and name in self._scene.robots and name not in self._scene.sources

    def frame_hint(self, text: str) -> str:
        """A hint at what was meant by an unknown name of a frame."""
        events = [f"{n}.{event}" for n, source in self._sources.items() for event in source.events]
        spaces = _missing_spaces(text, [*UNITS, *self._outputs, *events])
        return spaces or did_you_mean(text, self._frames)

    def find(self, name: str) -> Value | Problem | None:
        """What a name in an expression stands for.

        Returns:
            its numbers, what is wrong with it, or None where that is reported elsewhere.
        """
        if name in UNITS:
            return constant(*UNITS[name])
        if self.is_frame(name) or self.is_fwd_kin(name):
            return self._frame(name)
        owner, _, key = name.partition(".")
        if self._scene.declares("sources", owner):
            return self._event(owner, key)
        if owner in self._owners or owner in self._scene.robots:
            return self._output(owner, key)
        sections = ("robots", "doubles", "arrows")
        if {*sections, *(f"{section}.{owner}" for section in sections)} & self._scene.broken:
            return None
        return Problem("", f"no {self._unknown(owner, is_bare=not key)}")

    def _frame(self, name: str) -> Problem | None:
        if name in self._frames or self.is_fwd_kin(name):
            return Problem("", f"{name} is a 4 x 4 frame, which cannot be indexed or combined")
        if self._scene.is_broken(name.partition("/")[0]):
            return None
        return Problem("", f"no frame '{name}'{self.frame_hint(name)}")

    def _event(self, name: str, event: str) -> Value | Problem | None:
        if name not in self._sources:
            return None
        events = {**self._sources[name].events, **SIGNALS}
        if event in events:
            return numbers_of(Origin(name, event, True), tuple(events[event]), None)
        spaces = _missing_spaces(event, events)
        return Problem("", f"no event '{event}' of {name}{spaces or did_you_mean(event, events)}")

    def _output(self, name: str, key: str) -> Value | Problem:
        target = f"{name}.{key}"
        if target in self._outputs:
            item = self._outputs[target]
            origin = Origin(name, key, False)
            return numbers_of(origin, item.shape, dimension_of(self._scene, item))
        keys = [item.key for item in self._outputs.values() if item.name == name]
        hint = _missing_spaces(key, keys)
        if not hint and name in self._scene.robots:
            hint = did_you_mean(key, [*keys, FWD_KIN])
            if nearest(key, [*keys, FWD_KIN]) is None:
                hint += f"; its frames are {name}/flange and so on"
        return Problem("", f"no output '{key}' of {name}{hint or did_you_mean(key, keys)}")

    def _unknown(self, owner: str, *, is_bare: bool) -> str:
        """A message about an unknown name, with the nearest known one."""
        sources = self._scene.declared("sources")
        if nearest(owner, sources) is None:
            near = nearest(owner, self._owners)
            if near is not None:
                return f"source or robot '{owner}'; did you mean '{near}'?"
            near = nearest(owner, UNITS) if is_bare else None
            if near is not None:
                return f"unit '{owner}'; did you mean '{near}'?"
        return f"source '{owner}'{did_you_mean(owner, sources)}"


def _missing_spaces(name: str, known: Iterable[str]) -> str:
    """Advice where a known name runs into an operator that can also stand in names."""
    for i, sign in enumerate(name):
        if sign in "-/" and name[:i] in known:
            return f"; put spaces about '{sign}'"
    return ""
