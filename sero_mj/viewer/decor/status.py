"""What is awaited from sources, and their faults, in the upper left corner of the picture."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np

from ...base.errors import SeroError
from ...data.receive import fri
from ...data.receive.source import make_source
from ...robots.assemble.world_view import WorldView
from ...robots.declared.inputs import SOURCE_FIELDS
from .cards import move_below
from .feature import Feature, Frame
from .panels import PANEL_RGBA, Panels, panel_sizes
from .picture_view import PictureView
from .quantities import implausible_torques
from .toggles import Toggles

FAULT_RGBA = (0.32, 0.03, 0.03, 0.88)
_MARGIN = 0.5  # of a line's height


SourceState = namedtuple("SourceState", SOURCE_FIELDS)  # type: ignore[misc]
_MAX_MORE = 3  # lines
_MAX_AWAITED = 3  # sources
SHOWN_FOR = 5.0  # s for which a malformed or lost packet is shown


def _source_faults(name: str, state: Any) -> list[str]:
    """Returns the faults of one source, one per line."""
    lines = []
    if state.malformed and state.fault_age < SHOWN_FOR:
        lines.append(f"{name}: {state.malformed:.0f} of {state.received:.0f} packets not applied")
        if state.wrong_size:
            lines.append(f"  {state.last_size:.0f} bytes, expected {state.size:.0f}")
        if state.not_frames:
            lines.append("  a matrix that is not a frame")
        if state.wrong_constant:
            lines.append("  another kind of packet: a constant is wrong")
        if state.malformed > state.wrong_size + state.not_frames + state.wrong_constant:
            lines.append("  NaN or infinity")
    return lines


def _link_faults(name: str, state: Any) -> list[str]:
    """Returns the faults between a source and its sender, one per line."""
    lines = []
    if 0 <= state.link_age < SHOWN_FOR:
        # A malformed packet has no readable sequence number and may be one of the missing ones.
        unread = " or not applied" if state.wrong_size or state.wrong_constant else ""
        counts = {
            f"{_packets(state.lost)} lost{unread}": state.lost,
            f"{state.late:.0f} late": state.late,
            f"{_packets(state.duplicates)} duplicated": state.duplicates,
            f"{state.dropped:.0f} dropped by this machine": state.dropped,
        }
        counted = [text for text, count in counts.items() if count]
        lines += [f"{name}: {', '.join(counted[:2])}"] * bool(counted)
        # A second line limits the width of the panel.
        lines += [f"  {', '.join(counted[2:])}"] * bool(counted[2:])
        if state.restarts:
            times = f" {state.restarts:.0f} times" if state.restarts > 1 else ""
            lines.append(f"{name}: the sender restarted{times}")
    if state.foreign and 0 <= state.foreign_age < SHOWN_FOR:
        lines.append(f"{name}: {_packets(state.foreign)} from other senders")
    if state.senders > 1:
        lines.append(f"{name}: {state.senders:.0f} concurrent senders; sender = ... chooses one")
    return lines


def _packets(count: float) -> str:
    return f"{count:.0f} packet{'' if count == 1 else 's'}"


def _controller_faults(name: str, state: Any, answers: bool) -> list[str]:
    """Returns the faults that a robot's controller reports in its last packet, one per line."""
    # Before the first packet the fields are 0, which would be a valid state here.
    if not state.received or state.link_quality < 0:
        return []
    if fri.is_good(state.robot_state, state.link_quality):
        return []
    quality = fri.QUALITIES.get(int(state.link_quality), f"{state.link_quality:.0f}")
    of_robot = fri.STATES.get(int(state.robot_state), f"{state.robot_state:.0f}")
    lines = [f"{name}: quality {quality}, state {of_robot}"]
    if quality == "unacceptable" and not answers:
        lines.append("  no answers are sent to it: answer = false")
    return lines


def _about(world: WorldView, name: str) -> str:
    """Returns kind and address of a live source; empty for sources read from files."""
    with suppress(SeroError):
        declared = world.scene.sources[name]
        if isinstance(declared, Mapping):
            declared = make_source(name, {**declared, "debug_level": 0})
        return str(declared.about) if declared.is_live else ""
    return ""


def _answers(source: Any) -> bool:
    """Whether a source, or its declaration, sends answers."""
    if isinstance(source, Mapping):
        return bool(source.get("answer", False))
    return bool(getattr(source, "answer", False))


class Status(Feature):
    """Shows the faults of the sources, and the packets expected from silent ones."""

    order = 50

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._slots = [
            (name, world.slots[f"sources.{name}"], _answers(world.scene.sources[name]))
            for name in world.scene.sources
            if name in world.scene.sources_of()
        ]

        self._where = {
            name: about for name in world.scene.sources if (about := _about(world, name))
        }

    def lay_out(self, frame: Frame) -> None:
        """Adds panels to the upper left corner, below the right one's if they overlap."""
        wrong = implausible_torques(self.world, frame.values)
        panels = [
            self.panels(frame.data, frame.toggles, frame.view, wrong),
            self._awaited(frame.data, frame.toggles, frame.view),
        ]
        low, high = frame.view.free
        middle = (low[1] + high[1]) / 2
        for found in panels:
            if found is not None:
                panel = found
                for other in frame.corners:
                    if other.centres[:, 1].max() > middle:
                        panel = move_below(other, panel)
                frame.corners.append(panel)

    def _awaited(self, data: mujoco.MjData, toggles: Toggles, view: PictureView) -> Panels | None:
        """Returns the packets expected from silent sources, and the command to send them."""
        if not toggles.status:
            return None
        lines = []
        for name, slot, _ in self._slots:
            state: Any = SourceState(*data.userdata[slot])
            if name in self._where and not state.received:
                lines.append(f"nothing yet on {self._where[name]}")
                lines.append(f"  awaited: packets of {state.size:.0f} bytes")
        if not lines:
            return None
        lines = [*lines[: 2 * _MAX_AWAITED], f"  to try: sero-mj send {self.world.scene.argument}"]
        return _corner(lines, PANEL_RGBA, view)

    def panels(
        self, data: mujoco.MjData, toggles: Toggles, view: PictureView, more: Sequence[str] = ()
    ) -> Panels | None:
        """Returns the panel in the upper left corner, or None if there are no faults.

        Args:
            data: the world's state.
            toggles: whether it is shown.
            view: of the picture.
            more: other faults, one per line; only the first few are shown.
        """
        lines = [*more[:_MAX_MORE]]
        for name, slot, answers in self._slots:
            state = SourceState(*data.userdata[slot])
            lines += _source_faults(name, state) + _link_faults(name, state)
            lines += _controller_faults(name, state, answers)
        return _corner(lines, FAULT_RGBA, view) if lines and toggles.status else None


def _corner(
    lines: Sequence[str], rgba: tuple[float, float, float, float], view: PictureView
) -> Panels:
    """Returns a panel with lines of text in the upper left corner."""
    texts = [line.encode("ascii", "replace")[:99] for line in lines]
    widest = max(view.font.width(text) for text in texts)
    size = panel_sizes(np.array([widest]), len(texts), view)
    margin = _MARGIN * view.font.height
    low, high = view.free
    corner = np.array([low[0] + margin, high[1] - margin])
    return Panels(corner + size * (0.5, -0.5), size, [texts], rgba)
