"""`TorqueHistory`: recent commanded and measured torques of the joints, for plots."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ...data.drive.route import Route
from ...data.receive.mailbox import Packets
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import IMPLAUSIBLE_FACTOR, joint_values
from ..decor.staleness import Staleness
from .binned_history import SHOWN, SPAN, BinnedHistory

_GAP = 0.25  # minimum duration of a visible gap in a line, s
_MEASURED, _COMMANDED, _ERROR = range(3)
_ROWS = {"torques": _MEASURED, "commanded_torques": _COMMANDED}
ROWS = {**_ROWS, "torque_error": _ERROR}  # row of each quantity in the history


class TorqueHistory:
    """Stores the recent torques of all joints.

    `add_packets` adds all packets of live sources. `add` adds all other torques, with one sample
    per frame or every few ms. If the displayed time goes back, all samples are deleted.

    Args:
        world: world with the joints.
        routes: routes of the packets for `add_packets`.
        span: duration of the history in seconds.

    Attributes:
        until: last time of the returned samples in seconds; None for the time of the newest sample.
    """

    def __init__(self, world: WorldView, routes: Iterable[Route] = (), span: float = SPAN) -> None:
        joints = len(world.joints.names)
        self.until: float | None = None
        self._world = world
        self._staleness = Staleness(world)
        self._history = BinnedHistory((3, joints), span)
        # For each source: route, row of the quantity, and joints.
        self._routes: dict[str, list[tuple[Route, int, slice]]] = {}
        self._by_packet = np.zeros((3, joints), bool)
        for route in routes:
            row, owner = _ROWS.get(route.to.key), world.owners.get(route.to.name)
            if route.direct is not None and row is not None and owner is not None:
                self._routes.setdefault(route.direct, []).append((route, row, owner.joints))
                self._by_packet[[row, _ERROR], owner.joints] = True

    def add(self, data: mujoco.MjData) -> None:
        """Adds the torques at `data.time`, except torques that `add_packets` adds."""
        history = self._history
        if data.time < history.newest - 1e-9:
            history.restart()
        stale = self._staleness.find(data)
        values = self._received(data)
        values[self._by_packet] = np.nan
        history.add(np.array([data.time]), values[None])
        if stale:  # A line ends at the time of the last data, not when the data became stale.
            gap = self._staleness.time_without_data(data, stale)
            history.forget(np.where(gap > 0, data.time - gap + 1e-6, np.inf)[None])

    def add_packets(self, data: mujoco.MjData, source: str, packets: Packets, now: float) -> None:
        """Adds the torques of packets at their arrival times.

        Args:
            data: state of the world at the current time, before the last packet is applied.
            source: name of the packets' source.
            packets: packets to add.
            now: current time in seconds, from the same clock as `packets.arrivals`.
        """
        routes = self._routes.get(source)
        if routes is None:
            return
        values = np.tile(self._received(data), (len(packets), 1, 1))
        came = np.zeros(values.shape[1:], bool)
        for route, row, joints in routes:
            with np.errstate(over="ignore", invalid="ignore"):
                found = route.value.evaluate(
                    lambda origin: packets.values[origin.key].reshape(len(packets), -1)
                )
            values[:, row, joints] = np.where(np.isfinite(found), found, np.nan)
            came[[row, _ERROR], joints] = True
        values[:, _ERROR] = values[:, _COMMANDED] - values[:, _MEASURED]
        values[:, ~came] = np.nan
        if self._world.joints.is_largest.any():  # Peaks between two frames must count, too.
            for row in (_MEASURED, _COMMANDED):
                size = np.fmax.reduce(np.abs(values[:, row]), axis=0)
                self._world.joints.note_largest(size, IMPLAUSIBLE_FACTOR)
        self._history.add(data.time - now + packets.arrivals, values)

    def _received(self, data: mujoco.MjData) -> Array:
        found = joint_values(self._world, data)
        return np.array([found["torques"], found["commanded_torques"], found["torque_error"]])

    def of(self, joint: int, points: int = 2 * SHOWN) -> tuple[Array, Array]:
        """Returns the torques of a joint, with the oldest sample first.

        Args:
            joint: index of the joint in the world.
            points: approximate maximum number of samples.

        Returns:
            times in seconds relative to the newest sample, shape (k,), and values in Nm or N, shape
            (3, k). The rows are measured, commanded, and commanded - measured torques; NaN for no
            data.
        """
        times, values = self._history.until(self.until, points, (slice(None), joint))
        times = times - times[-1:]
        is_recent = times >= -SPAN
        return times[is_recent], values[:, is_recent]

    def one(self, joint: int, key: str, points: int) -> tuple[Array, Array]:
        """Returns one quantity of a joint, a key of `ROWS`, with the oldest sample first.

        Returns:
            times in seconds, shape (k,), and values in Nm or N, shape (k,); NaN for no data.
        """
        times, values = self._history.until(self.until, points, (ROWS[key], joint))
        return times, values[0]


def split_at_gaps(times: Array, values: Array) -> list[Ints]:
    """Splits a line of a plot at gaps of 0.25 s and more.

    Args:
        times: increasing times in seconds, shape (k,).
        values: values of the line, shape (k,); NaN for no data.

    Returns:
        sample indices of each continuous piece of the line.
    """
    there = np.isfinite(values).nonzero()[0]
    if not len(there):
        return []
    is_gap = (np.diff(there) > 1) & (np.diff(times[there]) > _GAP)
    return np.split(there, is_gap.nonzero()[0] + 1)
