"""`Sensors`: noise, bias, quantization, delay and faults of a robot's sensors.

Gain and bias, noise, quantization, faults and delay act on the true value in this order. Velocities
can be differentiated from the encoder readings before the delay:

    v(k) = v(k-1) + (1 - exp(-w t)) ((q(k) - q(k-1)) / t - v(k-1)).

This is the difference quotient for the time step t after a first-order low-pass filter of bandwidth
w. The filter is exact if the quotient is constant during a step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from ..base.declaration import Declaration, numbers
from ..base.errors import Problem, UnknownName
from ..base.frames import Array, Bools, Ints

Signal = Literal["angles", "velocities", "torques"]
SIGNALS: tuple[Signal, ...] = ("angles", "velocities", "torques")
_ERRORS = ("gain", "bias", "noise", "resolution")
_BLOCK = 256  # number of steps of noise drawn at once; single draws would dominate the time


def _per_joint(value: Any) -> Array:
    array = numbers(value)
    if array.ndim > 1:
        reason, expected = "found an array with", "one number, or one per joint"
        raise Problem("", reason, found=array.ndim, of="dimensions", expected=expected).error()
    return array


def _at_least_zero(array: Array) -> Array:
    if (array < 0).any():
        raise Problem(found=array.tolist(), expected="0 or more").error()
    return array


_PerJoint = Annotated[Array, BeforeValidator(_per_joint)]
_NotNegative = Annotated[Array, BeforeValidator(_per_joint), AfterValidator(_at_least_zero)]


class SensorErrors(Declaration):
    """Sensor errors of one signal: one number for all joints, or one per joint.

    Attributes:
        noise: standard deviation of white noise, rad, rad/s or Nm.
        bias: constant error, rad, rad/s or Nm.
        resolution: quantization step; 0 for none.
        gain: factor of the true value: 1 for an ideal sensor, 0 for a sensor that reads only its
            bias.
        delay: delay of the readings in whole steps, the same for all joints.
    """

    noise: _NotNegative = np.array(0.0)
    bias: _PerJoint = np.array(0.0)
    resolution: _NotNegative = np.array(0.0)
    gain: _PerJoint = np.array(1.0)
    delay: int = Field(0, ge=0, le=100_000)


_ALL = slice(None)
Joints = int | Sequence[int] | slice


class Sensors:
    """Sensors of n joints for three signals: angles, velocities and torques of the links.

    Args:
        seed: seed of the noise.
        velocity_filter: filter bandwidth w of differentiated velocities, shape (n,), 1/s; 0 for
            joints with tachometers (default: tachometers only). `velocities` errors are added.
        timestep: time t between two readings in seconds; required with `velocity_filter`.

    Attributes:
        rows: sensors of all rows, which are read together. This object is the row `row`.
        seed: seed of the noise from the next `reset` on.

    Raises:
        ValueError: a sensor error has neither one value nor n values, or the time step is missing.
    """

    def __init__(
        self,
        n: int,
        angles: SensorErrors | None = None,
        velocities: SensorErrors | None = None,
        torques: SensorErrors | None = None,
        seed: int = 0,
        *,
        velocity_filter: Array | None = None,
        timestep: float = 0.0,
    ) -> None:
        self.n, self.seed, self.timestep = n, seed, timestep
        self.declared = [each or SensorErrors() for each in (angles, velocities, torques)]
        self.filters = np.zeros(n) if velocity_filter is None else np.array(velocity_filter)
        if self.filters.any() and not timestep > 0:
            raise Problem("timestep", found=timestep, of="s", expected="more than 0").error()
        self.row, self.rows = 0, SensorRows([self])

    @property
    def measured(self) -> Array:
        """The last readings, shape (3, n); always the same array."""
        return np.asarray(self.rows.measured[self.row])

    @property
    def is_perfect(self) -> bool:
        """Whether the sensors read the true values without delay."""
        return bool(self.rows.is_idle[self.row])

    def reset(self, actual: Array) -> None:
        """Restarts the noise, and fills the delay buffer from the true values, shape (3, n)."""
        self.rows.reset(self.row, actual, self.seed)

    def measure(self, actual: Array) -> Array:
        """Returns the readings `measured` of a single row for its true values, shape (3, n)."""
        return np.asarray(self.rows.measure(actual[None])[0])

    def change(self, signal: Signal, joints: Joints | None = None, **errors: float) -> None:
        """Changes gain, bias, noise or resolution of some sensors during a run.

        Args:
            joints: indices of joints; None for all.

        Raises:
            UnknownName: there is no such signal or error.
            ValueError: noise or resolution is negative.
        """
        number = _number(signal)
        for key, value in errors.items():
            if key not in _ERRORS:
                raise UnknownName("sensor error", key, _ERRORS)
            if key in ("noise", "resolution") and not value >= 0:
                raise Problem(f"{signal}.{key}", found=value, expected="0 or more").error()
            chosen = slice(None) if joints is None else joints
            self.rows.errors[key][self.row, number, chosen] = value
        self.rows.update()

    def delay(self, signal: Signal, steps: int, joints: Joints | None = None) -> None:
        """Sets the delay of a signal in steps; 0 removes the delay.

        If the signal was not delayed before, its last reading is used as all earlier readings.

        Args:
            joints: indices of joints; None for all.

        Raises:
            UnknownName: there is no such signal.
            ValueError: the delay is negative.
        """
        number = _number(signal)
        if steps < 0:
            problem = Problem(
                signal, "found a delay of", found=steps, of="steps", expected="0 or more"
            )
            raise problem.error()
        delays = self.rows.delays[self.row].copy()
        delays[number, slice(None) if joints is None else joints] = steps
        self.rows.set_delays(self.row, delays)

    def kill(self, signal: Signal, joint: int) -> None:
        """Makes a sensor read zero."""
        self.rows.dead[self.row, _number(signal), joint] = True
        self.rows.update()

    def freeze(self, signal: Signal, joint: int) -> None:
        """Makes a sensor hold its last reading."""
        place = self.row, _number(signal), joint
        self.rows.frozen[place], self.rows.held[place] = True, self.rows.measured[place]
        self.rows.update()

    def repair(self) -> None:
        """Ends all sensor faults, and restores the declared errors and delays."""
        self.rows.repair(self.row)

    def end_faults(self, reapply: Callable[[], None]) -> None:
        """Ends all sensor faults, and applies those again that are still active.

        Args:
            reapply: function that applies the active faults. Frozen and delayed readings remain.
        """
        rows, row = self.rows, self.row
        held, delays, past = rows.held[row].copy(), rows.delays[row].copy(), rows.past.copy()
        self.repair()
        reapply()
        wanted = rows.delays[row].copy()
        rows.held[row], rows.delays[row], rows.past = held, delays, past
        rows.set_delays(row, wanted)


class SensorRows:
    """The sensors of m rows, which are read together. The rows are the first axis of all arrays.

    Args:
        each: sensors of each row, with the same number of joints and the same time step. Their
            `rows` is set to this object.

    Attributes:
        measured: last readings, shape (m, 3, n); always the same array.
        errors: gain, bias, noise and resolution, shape (m, 3, n) each; call `update` after a
            change.
        dead: mask of sensors that read zero, shape (m, 3, n).
        frozen: mask of sensors that hold a reading, shape (m, 3, n).
        delays: delays in steps, shape (m, 3, n).
        past: ring buffer of readings before the delay, shape (L, m, 3, n).
        is_idle: mask of rows that read the true values, shape (m,).
        is_perfect: whether all rows read the true values, so that `measure` need not be called.
    """

    def __init__(self, each: Sequence[Sensors]) -> None:
        first, m = each[0], len(each)
        self._each, shape = each, (m, 3, first.n)
        self.measured: Array = np.zeros(shape)
        self.errors: dict[str, Array] = {key: np.zeros(shape) for key in _ERRORS}
        self.held: Array = np.zeros(shape)
        self.dead, self.frozen = np.zeros((2, *shape), bool)
        self.delays: Ints = np.zeros(shape, np.intp)
        self.past: Array = np.zeros((1, *shape))
        self._place = 0  # index in the ring buffer
        filters = np.array([one.filters for one in each])
        self._is_filtered: Bools = filters > 0
        self._differentiates = bool(filters.any())
        self._timestep = first.timestep
        self._new_share = -np.expm1(-filters * self._timestep)
        self._speeds, self._read_angles = np.zeros((2, m, first.n))
        self._has_read: Bools = np.zeros((m, 1), bool)
        self._noise: Array = np.zeros((m, _BLOCK, 3, first.n))
        self._has_drawn: Bools = np.zeros(m, bool)
        self._k: Ints = np.zeros(m, np.intp)  # number of readings
        self._rngs = [np.random.default_rng(one.seed) for one in each]
        self._at = np.arange(m)[:, None, None], np.arange(3)[:, None], np.arange(first.n)
        for row, one in enumerate(each):
            one.rows, one.row = self, row
            self.repair(row)
            self.reset(row, self.measured[row].copy(), one.seed)

    def repair(self, row: int) -> None:
        self.dead[row] = self.frozen[row] = False
        self.held[row] = 0.0
        delays = np.zeros_like(self.delays[row])
        n = delays.shape[-1]
        for number, (signal, declared) in enumerate(
            zip(SIGNALS, self._each[row].declared, strict=True)
        ):
            for key in _ERRORS:
                value = getattr(declared, key)
                if value.shape not in ((), (1,), (n,)):
                    place, expected = f"{signal}.{key}", f"1 or {n}"
                    raise Problem(place, found=len(value), of="numbers", expected=expected).error()
                self.errors[key][row, number] = value
            delays[number] = declared.delay
        self.set_delays(row, delays)

    def set_delays(self, row: int, delays: Ints) -> None:
        """Sets the delays of a row, shape (3, n), in steps."""
        was_late = self.delays.any(axis=(0, 2))  # signals of any row
        row_was_late = self.delays[row].any(axis=1)
        is_new = (delays != self.delays[row]).any(axis=1)
        self.delays[row] = delays
        old, longest = self.past, int(self.delays.max())
        past: Array = np.empty((longest + 1, *self.measured.shape))
        past[:] = self.measured
        for age in range(1, min(len(old), len(past)) + 1):
            kept = old[(self._place - age) % len(old)][:, was_late]
            past[(self._place - age) % len(past)][:, was_late] = kept
        begins = is_new & ~row_was_late
        past[:, row, begins] = self.measured[row, begins]
        self.past = past
        self.update()

    def update(self) -> None:
        """Updates cached flags after a change of errors or faults."""
        errors = self.errors
        self._has_noise: Bools = np.asarray(errors["noise"].any(axis=(1, 2)))
        self._coarse: Bools = errors["resolution"] > 0
        self._grid = np.where(self._coarse, errors["resolution"], 1.0)
        self._grids = [
            (signal, self._grid[:, signal], self._coarse[:, signal])
            for signal in range(len(SIGNALS))
            if self._coarse[:, signal].any()
        ]
        self._is_noisy = bool(self._has_noise.any())
        self._is_biased = bool(errors["bias"].any())
        self._is_scaled = bool((errors["gain"] != 1.0).any())
        self._is_faulty = bool(self.dead.any() or self.frozen.any())
        self._is_late = bool(self.delays.any())
        is_off = self.dead | self.frozen | (self.delays != 0)
        for key, right in (("gain", 1.0), ("bias", 0.0), ("noise", 0.0), ("resolution", 0.0)):
            is_off |= errors[key] != right
        if self._differentiates:
            is_off[...] = True
        self.is_idle: Bools = np.logical_not(np.asarray(is_off.any(axis=(1, 2))))
        self._counts = (~self.is_idle).astype(np.intp)
        self.is_perfect = bool(self.is_idle.all())

    def reset(self, row: int, actual: Array, seed: int) -> None:
        """Restarts a row's noise, and fills its delay buffer from the true values, shape (3, n)."""
        self._rngs[row] = np.random.default_rng(seed)
        self._has_drawn[row] = self._has_read[row] = False
        self._k[row], self._speeds[row] = 0, 0.0
        only = slice(row, row + 1)
        for age in range(int(self.delays[row].max()) + 1, 0, -1):
            self.measured[only] = self._read(actual[None], only)
            self.past[(self._place - age) % len(self.past), row] = self.measured[row]
            self._k[row] += 1
        late = (self._place - 1 - self.delays[row]) % len(self.past)
        self.measured[row] = self.past[late, row, *self._at[1:]]

    def measure(self, actual: Array) -> Array:
        """Returns the readings `measured` of all rows, shape (m, 3, n), for their true values."""
        measured = self.measured
        measured[...] = self._read(actual, _ALL)
        if self._is_late:
            self.past[self._place % len(self.past)] = measured
            measured[...] = self.past[(self._place - self.delays) % len(self.past), *self._at]
        self._place += 1
        self._k += self._counts
        return measured

    def _read(self, actual: Array, rows: slice) -> Array:
        errors = self.errors
        offsets, gain = errors["bias"][rows], errors["gain"][rows]
        if self._is_noisy:
            offsets = offsets + errors["noise"][rows] * self._noise_now(rows)
        values: Array = actual * gain if self._is_scaled else actual.copy()
        if self._is_noisy or self._is_biased:
            values += offsets
        for signal, grid, coarse in self._grids:
            of = values[:, signal]
            np.copyto(of, np.rint(of / grid[rows]) * grid[rows], where=coarse[rows])
        if self._differentiates:
            self._differentiate(values, gain, offsets, rows)
        if self._is_faulty:
            np.copyto(values, self.held[rows], where=self.frozen[rows])
            np.copyto(values, 0.0, where=self.dead[rows])
        return values

    def _noise_now(self, rows: slice) -> Array:
        if len(self._k) == 1:
            k = int(self._k[0]) % _BLOCK
            if k == 0 or not self._has_drawn[0]:
                self._noise[0] = self._rngs[0].standard_normal(self._noise[0].shape)
                self._has_drawn[0] = True
            return self._noise[:, k]
        at = self._k[rows] % _BLOCK
        numbers = np.arange(len(self._k))[rows]
        due = self._has_noise[rows] & ((at == 0) | ~self._has_drawn[rows])
        for row in numbers[due].tolist():
            self._noise[row] = self._rngs[row].standard_normal(self._noise[row].shape)
            self._has_drawn[row] = True
        return np.asarray(self._noise[numbers, at])

    def _differentiate(self, values: Array, gain: Array, offsets: Array, rows: slice) -> None:
        angles, speeds = values[:, 0], self._speeds[rows]
        change = (angles - self._read_angles[rows]) / self._timestep
        speeds += np.where(self._has_read[rows], self._new_share[rows] * (change - speeds), 0.0)
        self._read_angles[rows], self._has_read[rows] = angles, True
        found = speeds * gain[:, 1] + offsets[:, 1]
        grid = self._grid[rows, 1]
        found = np.where(self._coarse[rows, 1], np.rint(found / grid) * grid, found)
        np.copyto(values[:, 1], found, where=self._is_filtered[rows])


def _number(signal: str) -> int:
    if signal not in SIGNALS:
        raise UnknownName("signal", signal, SIGNALS)
    return SIGNALS.index(signal)
