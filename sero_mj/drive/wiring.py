"""Checked routes: what leads from where to where."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..assemble.inputs import Input
from ..errors import Problem
from ..receive.source import SIGNALS, Source
from .affine import Affine


@dataclass(frozen=True, eq=False)
class Route:
    """One checked route of numbers.

    Attributes:
        to: the input it leads to.
        text: where it leads from, as declared.
        value: how the input's numbers are computed.
        negated: whether a switch is turned round.
    """

    to: Input
    text: str
    value: Affine
    negated: bool = False

    @property
    def sources(self) -> list[str]:
        """Names of the sources whose packets it takes numbers from."""
        return list(dict.fromkeys(o.name for o in self.value.origins if o.is_event))

    @property
    def outputs(self) -> list[str]:
        """What it reads of robots, doubles and arrows, `name.key`."""
        return [str(origin) for origin in self.value.origins if not origin.is_event]

    @property
    def direct(self) -> str | None:
        """The source, where a packet of it is all that it takes; else None."""
        sources = self.sources
        if any(o.is_event and o.key in SIGNALS for o in self.value.origins):
            return None  # changes without a packet
        return sources[0] if len(sources) == 1 and not self.outputs else None


@dataclass(frozen=True)
class FrameRoute:
    """One checked route from a frame.

    Attributes:
        to: the input it leads to.
        frame: name of the frame, or of the robot whose `fwd_kin_base_to_flange` it is.
        is_fwd_kin: which of the two.
    """

    to: Input
    frame: str
    is_fwd_kin: bool = False


@dataclass
class Wiring:
    """The sources of a scene and the routes from them.

    Attributes:
        sources: by name, not yet opened.
        routes: those of numbers that are right.
        later: those among them that need more than one packet, each after what it reads.
        frame_routes: those from frames that are right.
        levels: names of what frames place, each after what it depends on.
        problems: what is wrong with the others.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
    later: list[Route] = field(default_factory=list)
    frame_routes: list[FrameRoute] = field(default_factory=list)
    levels: list[list[str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
