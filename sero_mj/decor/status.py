"""What is wrong with the sources, written into the corner of the picture."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from ..assemble.inputs import SOURCE_FIELDS
from ..assemble.world_view import WorldView
from ..receive import fri_layout as fri
from .cards import below
from .feature import Feature, Frame
from .panels import Panels, panel_sizes
from .picture_view import PictureView
from .quantities import implausible_torques
from .toggles import Toggles

FAULT_RGBA = (0.32, 0.03, 0.03, 0.88)
_MARGIN = 0.5  # of a line's height


SourceState = namedtuple("SourceState", SOURCE_FIELDS)  # type: ignore[misc]
_MOST_MORE = 3  # lines
SHOWN_FOR = 5.0  # s after a malformed packet, or one that was lost


def _complaints(name: str, state: Any) -> list[str]:
    """What is wrong with one source, a line each."""
    lines = []
    if state.malformed and state.fault_age < SHOWN_FOR:
        lines.append(f"{name}: {state.malformed:.0f} of {state.received:.0f} packets not applied")
        if state.wrong_size:
            lines.append(f"  {state.last_size:.0f} bytes, expected {state.size:.0f}")
        if state.not_frames:
            lines.append("  a matrix that is no frame")
        if state.wrong_constant:
            lines.append("  another kind of packet: a constant is wrong")
        if state.malformed > state.wrong_size + state.not_frames + state.wrong_constant:
            lines.append("  NaN or infinity")
    return lines


def _link_complaints(name: str, state: Any) -> list[str]:
    """What went wrong between a source and who sends to it."""
    lines = []
    if 0 <= state.link_age < SHOWN_FOR:
        # One of another size, or kind, has no number that could be read: it may be one of these.
        unread = " or not applied" if state.wrong_size or state.wrong_constant else ""
        counts = {
            f"{_packets(state.lost)} lost{unread}": state.lost,
            f"{state.late:.0f} came late": state.late,
            f"{_packets(state.duplicates)} came twice": state.duplicates,
            f"{state.dropped:.0f} thrown away here": state.dropped,
        }
        said = [text for text, count in counts.items() if count]
        lines += [f"{name}: {', '.join(said[:2])}"] * bool(said)
        lines += [f"  {', '.join(said[2:])}"] * bool(said[2:])  # the panel stays narrow
        if state.restarts:
            times = f" {state.restarts:.0f} times" if state.restarts > 1 else ""
            lines.append(f"{name}: the sender began anew{times}")
    if state.foreign and 0 <= state.foreign_age < SHOWN_FOR:
        lines.append(f"{name}: {_packets(state.foreign)} of others than its sender")
    if state.senders > 1:
        lines.append(f"{name}: {state.senders:.0f} senders at once; sender = ... chooses one")
    return lines


def _packets(count: float) -> str:
    return f"{count:.0f} packet{'' if count == 1 else 's'}"


def _controller_complaints(name: str, state: Any, answers: bool) -> list[str]:
    """What a robot's controller says is not good, now or when it was last heard of."""
    # Where nothing was received yet, all is 0, which here would mean something.
    if not state.received or state.link_quality < 0:
        return []
    if fri.is_good(state.robot_state, state.link_quality):
        return []
    quality = fri.QUALITIES.get(int(state.link_quality), f"{state.link_quality:.0f}")
    of_robot = fri.STATES.get(int(state.robot_state), f"{state.robot_state:.0f}")
    lines = [f"{name}: quality {quality}, state {of_robot}"]
    if quality == "unacceptable" and not answers:
        lines.append("  it gets no answers: answer = false")
    return lines


def _answers(source: Any) -> bool:
    """Whether a source, or what declares it, answers."""
    if isinstance(source, Mapping):
        return bool(source.get("answer", False))
    return bool(getattr(source, "answer", False))


class Status(Feature):
    """What is wrong with sources that send what cannot be used."""

    order = 50

    def __init__(self, world: WorldView) -> None:
        super().__init__(world)
        self._slots = [
            (name, world.slots[f"sources.{name}"], _answers(world.scene.sources[name]))
            for name in world.scene.sources
            if name in world.scene.sources_of()
        ]

    def lay_out(self, frame: Frame) -> None:
        """Adds what is wrong to the upper left corner, below the right one where they meet."""
        wrong = implausible_torques(self.world, frame.values)
        panel = self.panels(frame.data, frame.toggles, frame.view, wrong)
        if panel is not None:
            low, high = frame.view.free
            middle = (low[1] + high[1]) / 2
            for other in frame.corners:
                if other.centres[:, 1].max() > middle:
                    panel = below(other, panel)
            frame.corners.append(panel)

    def panels(
        self, data: mujoco.MjData, toggles: Toggles, view: PictureView, more: Sequence[str] = ()
    ) -> Panels | None:
        """Returns the panel in the upper left corner, or None when there is nothing to say.

        Args:
            data: the world's state.
            toggles: whether it is shown.
            view: of the picture.
            more: what else is wrong, a line each; the first few are written.
        """
        lines = [*more[:_MOST_MORE]]
        for name, slot, answers in self._slots:
            state = SourceState(*data.userdata[slot])
            lines += _complaints(name, state) + _link_complaints(name, state)
            lines += _controller_complaints(name, state, answers)
        if not lines or not toggles.status:
            return None
        texts = [line.encode("ascii", "replace")[:99] for line in lines]
        widest = max(view.font.width(text) for text in texts)
        size = panel_sizes(np.array([widest]), len(texts), view)
        margin = _MARGIN * view.font.height
        low, high = view.free
        corner = np.array([low[0] + margin, high[1] - margin])
        return Panels(corner + size * (0.5, -0.5), size, [texts], FAULT_RGBA)
