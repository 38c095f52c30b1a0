"""History of the joints' commanded and measured torques, for the plots of live hosts."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ...data.drive.route import Route
from ...data.receive.mailbox import Packets
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import joint_values
from ..decor.staleness import Staleness

SPAN = 8.0  # duration of the plots, s
_GAP = 0.25  # minimum duration of a visible gap, s
_BIN = 0.002  # duration for which the least and the greatest value are kept, s
_SHOWN = round(SPAN / _BIN) + 1  # bins of the plots
_MEASURED, _COMMANDED, _ERROR = range(3)
_ROWS = {"torques": _MEASURED, "commanded_torques": _COMMANDED}


class TorqueHistory:
    """The least and the greatest torques of all joints, in every 2 ms of the last seconds.

    So no peak is lost, however many packets come between two frames: those of a live source are
    added by `add_packets`, everything else by `add`, with a sample for every frame or every few ms.
    When time goes back, later samples are deleted.

    Args:
        world: the compiled scene.
        routes: those whose packets are added by `add_packets`.
        kept: s that are kept.

    Attributes:
        until: the time, s, up to which torques are returned; the newest when None.
    """

    def __init__(self, world: WorldView, routes: Iterable[Route] = (), kept: float = SPAN) -> None:
        joints = len(world.joints.names)
        self.until: float | None = None
        self._count = count = round(kept / _BIN) + 1  # of bins
        self._world = world
        self._staleness = Staleness(world)
        self._times = np.full(count, np.nan)  # of the last sample of a bin
        self._low = np.full((count, 3, joints), np.nan, np.float32)
        self._high = np.full((count, 3, joints), np.nan, np.float32)
        self._last: int | None = None  # newest bin; bin i is in row i % count
        self._newest = 0.0  # time, s
        # By source: where the torques of a packet go.
        self._routes: dict[str, list[tuple[Route, int, slice]]] = {}
        self._by_packet = np.zeros((3, joints), bool)
        for route in routes:
            row, owner = _ROWS.get(route.to.key), world.owners.get(route.to.name)
            if route.direct is not None and row is not None and owner is not None:
                self._routes.setdefault(route.direct, []).append((route, row, owner.joints))
                self._by_packet[[row, _ERROR], owner.joints] = True

    def add(self, data: mujoco.MjData) -> None:
        """Adds the torques at `data.time`, except those that packets bring."""
        if data.time < self._newest - 1e-9:
            self._last = None
        stale = self._staleness.find(data)
        values = self._received(data)
        values[self._by_packet] = np.nan
        self._put(np.array([data.time]), values[None])
        if stale:  # the line ends at the time of the last data, not when it became stale
            gap = self._staleness.time_without_data(data, stale)
            with np.errstate(invalid="ignore"):
                past = (gap > 0) & (self._times[:, None] > data.time - gap + 1e-6)
            for extremes in (self._low, self._high):
                np.copyto(extremes, np.nan, where=past[:, None])

    def add_packets(self, data: mujoco.MjData, source: str, packets: Packets, now: float) -> None:
        """Adds the torques of packets, each at its arrival.

        Args:
            data: the world's state before the last packet is applied; `data.time` is now.
            source: its name.
            packets: of the source, in order.
            now: on the clock of their arrivals, s.
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
        self._put(data.time - now + packets.arrivals, values)

    def _received(self, data: mujoco.MjData) -> Array:
        """Returns measured and commanded torques and their error, (3, N)."""
        found = joint_values(self._world, data)
        return np.array([found["torques"], found["commanded_torques"], found["torque_error"]])

    def _put(self, times: Array, values: Array) -> None:
        """Adds samples at times (n,), s, rising, with values (n, 3, N)."""
        bins = np.floor(times / _BIN + 1e-6).astype(np.intp)
        newest = int(bins[-1])
        if self._last is None:
            self._newest = -np.inf
            self._times[:] = np.nan
            self._low[:] = self._high[:] = np.nan
        elif newest > self._last:
            new = np.arange(max(self._last, newest - self._count) + 1, newest + 1) % self._count
            self._times[new] = np.nan
            self._low[new] = self._high[new] = np.nan
        self._last = newest if self._last is None else max(newest, self._last)
        self._newest = max(float(times[-1]), self._newest)
        kept = bins > self._last - self._count
        bins, times, values = bins[kept], times[kept], values[kept]
        bins, begins = np.unique(bins, return_index=True)
        ends = np.append(begins[1:], len(times)) - 1
        rows = bins % self._count
        self._times[rows] = np.fmax(self._times[rows], times[ends])
        with np.errstate(over="ignore"):  # nonsense that was received is beyond float32
            self._low[rows] = np.fmin(self._low[rows], np.fmin.reduceat(values, begins, axis=0))
            self._high[rows] = np.fmax(self._high[rows], np.fmax.reduceat(values, begins, axis=0))

    def of(self, joint: int, points: int = 2 * _SHOWN) -> tuple[Array, Array]:
        """Returns the torques of a joint, oldest first.

        Args:
            joint: index in the world.
            points: about as many are returned at most, two at least; each stands for the least or
                the greatest value of its stretch of time.

        Returns:
            times (k,), s, relative to the newest (0 and below), and values (3, k): measured,
            commanded, and commanded - measured, Nm or N, NaN for no data.
        """
        if self._last is None:
            return np.zeros(0), np.zeros((3, 0))
        last = self._last
        if self.until is not None:
            last = min(last, int(np.floor(self.until / _BIN + 1e-6)))
        bins = np.arange(max(last - _SHOWN, self._last - self._count) + 1, last + 1)
        bins = bins[np.isfinite(self._times[bins % self._count])]
        if not len(bins):
            return np.zeros(0), np.zeros((3, 0))
        rows = bins % self._count
        times = self._times[rows]
        low, high = self._low[rows, :, joint], self._high[rows, :, joint]
        points = max(points, 2)
        if 2 * len(bins) > points:
            # Stretches begin at multiples of their length, so that a line does not flicker.
            stretches = bins // -(-2 * (int(bins[-1] - bins[0]) + 1) // points)
            begins = np.flatnonzero(np.diff(stretches, prepend=stretches[0] - 1))
            low = np.fmin.reduceat(low, begins, axis=0)
            high = np.fmax.reduceat(high, begins, axis=0)
            times = times[np.append(begins[1:], len(times)) - 1]
        both = np.arange(len(times)).repeat(1 + (low < high).any(axis=1))
        is_high = np.diff(both, prepend=-1) == 0
        values = np.where(is_high[:, None], high[both], low[both]).T
        times = times[both] - times[-1]
        kept = times >= -SPAN
        return times[kept], values[:, kept]


def split_at_gaps(times: Array, values: Array) -> list[Ints]:
    """Splits the samples of a line at gaps in the data.

    Args:
        times: (k,), s, rising.
        values: (k,), NaN for no data; gaps shorter than `GAP` are ignored.

    Returns:
        indices of the samples of each piece; none is NaN.
    """
    there = np.isfinite(values).nonzero()[0]
    if not len(there):
        return []
    is_gap = (np.diff(there) > 1) & (np.diff(times[there]) > _GAP)
    return np.split(there, is_gap.nonzero()[0] + 1)


def joint_name(world: WorldView, joint: int) -> str:
    """Returns the name of a joint with its robot or double: `lwr/A4`."""
    owner = list(world.owners)[int(world.joints.owner[joint])]
    name = world.joints.names[joint]
    return name if name.startswith(f"{owner}/") else f"{owner}/{name}"
