"""Shows errors of sources, and packets expected from silent sources, in the upper left corner."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np

from ...base.errors import SeroError
from ...base.frames import Array
from ...data.receive.source import Source, make_source
from ...robots.assemble.world_view import WorldView
from ...robots.declared.degrees import FAR_BEYOND, degrees_warning
from ...robots.declared.inputs import SOURCE_FIELDS
from .billboard_layout import move_below
from .feature import Feature, Frame
from .font import line_of
from .image_view import ImageView
from .panels import PANEL_RGBA, Panels, panel_sizes
from .quantities import implausible_torques
from .toggles import Toggles

FAULT_RGBA = (0.32, 0.03, 0.03, 0.88)
_MARGIN = 0.5  # distance from the image border, fraction of the line height


SourceState = namedtuple("SourceState", SOURCE_FIELDS)  # type: ignore[misc]
_MAX_MORE = 3  # maximum number of lines about implausible values
_MAX_AWAITED = 3  # maximum number of silent sources that are shown
_FEW_LINES = 20  # image height in lines below which panels have only one line
SHOWN_FOR = 5.0  # time for which a malformed or lost packet is shown, s


def _source_faults(name: str, state: Any, source: Source | None) -> list[str]:
    message = "" if source is None else source.layout.message
    lines = []
    if state.is_failing:
        times = f" {state.failures:.0f} times" if state.failures > 1 else ""
        lines.append(f"{name}: reception failed{times}; retrying")
    if state.malformed and state.fault_age < SHOWN_FOR:
        lines.append(f"{name}: {state.malformed:.0f} of {state.received:.0f} packets not applied")
        if state.wrong_size:
            bytes_ = f"{state.last_size:.0f} bytes"
            expected = f"{bytes_}, expected {state.size:.0f}"
            lines.append(f"  invalid {message}, {bytes_}" if message else f"  {expected}")
        if state.not_frames:
            lines.append("  a received matrix is not a frame")
        if state.wrong_constant:
            lines.append("  wrong constant: another kind of packet")
        if state.wrong_checksum:
            lines.append("  wrong checksum: corrupted packet")
        if state.implausible:
            lines.append("  some values are implausible")
        explained = state.wrong_size + state.not_frames + state.wrong_constant
        explained += state.wrong_checksum + state.implausible
        if state.malformed > explained:
            lines.append("  some values are NaN or infinite")
    return lines


def _link_faults(name: str, state: Any) -> list[str]:
    lines = []
    if 0 <= state.link_age < SHOWN_FOR:
        # A malformed packet has no readable sequence number and may count as lost.
        is_unread = state.wrong_size or state.wrong_constant or state.wrong_checksum
        unread = " or not applied" if is_unread else ""
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
        lines.append(
            f"{name}: {state.senders:.0f} concurrent senders; set sender = ... to choose one"
        )
    return lines


def _packets(count: float) -> str:
    return f"{count:.0f} packet{'' if count == 1 else 's'}"


def _controller_faults(name: str, state: Any, source: Source | None) -> list[str]:
    # Before the first packet the fields are 0, which is a valid state.
    if source is None or not state.received or state.link_quality < 0:
        return []
    first, *more = source.original.link_faults(state.robot_state, state.link_quality) or [""]
    return [f"{name}: {first}", *more] if first else []


def _sources(world: WorldView) -> dict[str, Source]:
    sources = {}
    for name, declared in world.scene.sources.items():
        with suppress(SeroError):
            source = make_source(name, declared)
            _ = source.original  # raises if the file of the source has errors
            sources[name] = source
    return sources


class Status(Feature):
    """The visual feature that shows errors of sources, and expected packets of silent sources."""

    order = 50

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._slots = [
            (name, world.slots[f"sources.{name}"])
            for name in world.scene.sources
            if name in world.scene.sources_of()
        ]
        self._sources = _sources(world)

    def lay_out(self, frame: Frame) -> None:
        wrong = implausible_torques(self.world, frame.values) + self._degrees(frame.values)
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

    def _degrees(self, values: dict[str, Array]) -> list[str]:
        angles = values["joint_angles"]
        if not (np.abs(angles) > FAR_BEYOND).any():
            return []
        parts = self.world.owners.values()
        found = [degrees_warning(part.robot, angles[part.joints]) for part in parts]
        return [
            line.replace("±", "+/-")  # panels are ASCII
            for text in found
            if text
            for line in text.replace(". Is", ".\n  Is").splitlines()
        ]

    def _awaited(self, data: mujoco.MjData, toggles: Toggles, view: ImageView) -> Panels | None:
        if not toggles.status:
            return None
        lines, can_be_played = [], False
        for name, slot in self._slots:
            state: Any = SourceState(*data.userdata[slot])
            source = self._sources.get(name)
            if source is not None and source.is_live and not state.received:
                lines += [f"no packet yet on {source.about}", f"  expected: {source.awaited}"]
                can_be_played |= source.can_be_played
        if not lines:
            return None
        lines = lines[: 2 * _MAX_AWAITED]
        if can_be_played:
            lines.append(f"  test with: sero-mj send {self.world.scene.argument}")
        return _corner(lines, PANEL_RGBA, view)

    def panels(
        self, data: mujoco.MjData, toggles: Toggles, view: ImageView, more: Sequence[str] = ()
    ) -> Panels | None:
        """Returns the panel with the errors of sources and the lines `more`, or None if empty."""
        lines = [*more[:_MAX_MORE]]
        for name, slot in self._slots:
            state, source = SourceState(*data.userdata[slot]), self._sources.get(name)
            lines += _source_faults(name, state, source) + _link_faults(name, state)
            lines += _controller_faults(name, state, source)
        return _corner(lines, FAULT_RGBA, view) if lines and toggles.status else None


def _corner(
    lines: Sequence[str], rgba: tuple[float, float, float, float], view: ImageView
) -> Panels:
    low, high = view.free
    if high[1] - low[1] < _FEW_LINES * view.font.height:
        lines = lines[:1]
    texts = [line_of(line) for line in lines]
    widest = max(view.font.width(text) for text in texts)
    size = panel_sizes(np.array([widest]), len(texts), view)
    margin = _MARGIN * view.font.height
    corner = np.array([low[0] + margin, high[1] - margin])
    return Panels(corner + size * (0.5, -0.5), size, [texts], rgba)
