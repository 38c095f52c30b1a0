"""`Sensors`: noise, bias, quantisation, delay and faults of a robot's sensors.

A value goes through gain and bias, noise, quantisation and faults, and then through the delay.
Velocities may be differentiated from what the encoders of the angles read before that:

    v(k) = v(k-1) + (1 - exp(-w t)) ((q(k) - q(k-1)) / t - v(k-1)),

differences through a first-order low pass of bandwidth w, exact for what is constant during a step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy import add, copyto, divide, multiply, rint
from pydantic import AfterValidator, BeforeValidator, Field

from ..base.declaration import Declaration, numbers
from ..base.errors import Problem, UnknownName
from ..base.frames import Array, Bools, Ints, RowIndex

Signal = Literal["angles", "velocities", "torques"]
SIGNALS: tuple[Signal, ...] = ("angles", "velocities", "torques")
_ERRORS = ("gain", "bias", "noise", "resolution")
_BLOCK = 256  # steps; drawing noise for each by itself takes longer than the rest


def _per_joint(value: Any) -> Array:
    array = numbers(value)
    if array.ndim > 1:
        raise Problem(
            found=array.ndim, of="dimensions", expected="one number, or one per joint"
        ).error()
    return array


def _at_least_zero(array: Array) -> Array:
    if (array < 0).any():
        raise Problem(found=array.tolist(), expected="0 or more").error()
    return array


_PerJoint = Annotated[Array, BeforeValidator(_per_joint)]
_NotNegative = Annotated[Array, BeforeValidator(_per_joint), AfterValidator(_at_least_zero)]


class SensorErrors(Declaration):
    """Errors of the sensors of one signal: one number for all joints, or (n,).

    Attributes:
        noise: standard deviation of white noise, rad, rad/s or Nm.
        bias: rad, rad/s or Nm.
        resolution: quantisation step; 0 for none.
        gain: 1 for a sensor that is right, 0 for one that shows its bias only.
        delay: steps until a value is read; whole, the same for all joints.
    """

    noise: _NotNegative = np.array(0.0)
    bias: _PerJoint = np.array(0.0)
    resolution: _NotNegative = np.array(0.0)
    gain: _PerJoint = np.array(1.0)
    delay: int = Field(0, ge=0, le=100_000)


class Sensors:
    """Sensors of n joints for three signals: angles, velocities and torques, in that order.

    With m rows, of which each has sensors and noise of its own (see `joined`), all arrays have the
    rows as their first axis.

    Args:
        n: number of joints.
        angles: of the link, behind gear and spring.
        velocities: likewise.
        torques: of the torque sensors.
        seed: of the noise; the same seed gives the same values.
        velocity_filter: w, (n,), 1/s, of joints whose velocities are differentiated, with their own
            errors on top; 0 for those that have tachometers. None for no differentiated ones.
        timestep: t, s between two readings; needed with `velocity_filter`.

    Attributes:
        is_perfect: whether they read the truth, at once.
        measured: (3, n), what was read last; the same array all the time.
        seed: of the noise from the next `reset` on.

    Raises:
        ValueError: an error has neither one number nor n, or the timestep is missing.
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
        errors = [each or SensorErrors() for each in (angles, velocities, torques)]
        filters = np.zeros(n) if velocity_filter is None else np.array(velocity_filter)
        if filters.any() and not timestep > 0:
            raise Problem("timestep", found=timestep, of="s", expected="more than 0").error()
        self._build(n, (), [errors], filters, timestep, seed)
        self.reset(self.measured)

    @classmethod
    def joined(cls, each: Sequence[Sensors]) -> Self:
        """The sensors of as many rows, which begin with `reset_row`.

        Args:
            each: of every row, of n joints and with one timestep.
        """
        first, made = each[0], cls.__new__(cls)
        declared = [one._declared[0] for one in each]
        filters = np.array([one._filters for one in each])
        made._build(first.n, (len(each),), declared, filters, first._timestep, first.seed)
        made._alone = each
        return made

    def _build(
        self,
        n: int,
        rows: tuple[int, ...],
        declared: list[list[SensorErrors]],
        filters: Array,
        timestep: float,
        seed: int,
    ) -> None:
        self.n, self._rows, self._declared, self.seed = n, rows, declared, seed
        m, shape = len(declared), (*rows, 3, n)
        self.measured = np.zeros(shape)
        # Noise alone, and all in all.
        self._noise, self._offsets = np.zeros((2, _BLOCK, *shape))
        self._offset_rows = tuple(self._offsets)
        self._grid_steps = np.zeros((*rows, n))
        # Of every joint in a ring of late values.
        self._places: tuple[Ints, ...] = (np.arange(n),)
        if rows:
            self._places = (np.arange(m)[:, None], *self._places)
        self._filters, self._timestep = filters, timestep
        self._differentiated: Bools | None = filters > 0 if filters.any() else None
        self._new_share = -np.expm1(-filters * timestep)
        self._speeds, self._read_angles = np.zeros((2, *rows, n))
        self._has_read = False
        # What was read without its delay.
        self._past = [np.zeros((1, *rows, n)) for _ in SIGNALS]
        self._rngs = [np.random.default_rng(seed) for _ in declared]
        self._k = 0  # readings until now
        self._first = np.zeros(m, np.intp)  # where the noise of every row begins
        self._together: int | None = 0  # the same where it is one for all
        self._has_noise, self._has_drawn = np.zeros((2, m), bool)
        self._errors = {key: np.zeros(shape) for key in _ERRORS}
        self._held: Array = np.zeros(shape)
        self._dead, self._frozen = np.zeros((2, *shape), bool)
        self._delays = np.zeros(shape, np.intp)
        self._changed: set[RowIndex] = set()
        self._alone: Sequence[Sensors] = ()
        for row in range(m) if rows else (...,):
            self._of: Any = row  # the rows that are changed
            self.repair()
        self._of = ...

    def repair(self) -> None:
        """Ends all faults and changes: every sensor is as it was declared."""
        of = self._of
        errors = self._declared[0 if of is ... else of]
        self._dead[of] = self._frozen[of] = False
        self._held[of] = 0.0
        for row, (signal, declared) in enumerate(zip(SIGNALS, errors, strict=True)):
            for key in _ERRORS:
                value = getattr(declared, key)
                if value.shape not in ((), (1,), (self.n,)):
                    place, expected = f"{signal}.{key}", f"1 or {self.n}"
                    raise Problem(place, found=len(value), of="numbers", expected=expected).error()
                self._errors[key][of][..., row, :] = value
        self._delays[of] = 0
        for signal, declared in zip(SIGNALS, errors, strict=True):
            self.delay(signal, declared.delay)

    @contextmanager
    def only(self, row: RowIndex) -> Iterator[None]:
        """Limits the changes in its context to one row; `...` is the single one."""
        self._changed.add(row)
        before, self._of = self._of, row
        try:
            yield
        finally:
            self._of = before

    def reset(self, actual: Array) -> None:
        """Restarts the noise from its seed, and delays as if everything had been at rest.

        Args:
            actual: (3, n), the true values now.
        """
        self._rngs = [np.random.default_rng(self.seed)]
        self._has_drawn[:] = self._drawn = False
        self._k = 0
        self._speeds[:] = 0.0
        self._has_read = False
        for _ in range(int(self._delays.max()) + 1):
            self.measure(actual)

    def reset_row(self, row: int, actual: Array, seed: int) -> None:
        """Resets one of the rows, without faults.

        Args:
            row: from 0.
            actual: (3, n), the true values now.
            seed: of its noise.
        """
        if row in self._changed:
            with self.only(row):
                self.repair()
            self._changed.remove(row)
        one = self._alone[row]
        one.seed = seed
        one.reset(actual)
        self.measured[row], self._rngs[row] = one.measured, one._rngs[0]
        self._speeds[row], self._read_angles[row] = one._speeds, one._read_angles
        self._has_read |= one._has_read  # of rows without a filter it does not matter
        for signal, past in enumerate(one._past):
            own = self._past[signal]
            for age in range(len(past)):
                own[(self._k - 1 - age) % len(own), row] = past[(one._k - 1 - age) % len(past)]
        self._noise[:, row], self._has_drawn[row] = one._noise, one._drawn
        self._first[row] = self._k - one._k
        self._find_together()
        self._drawn = bool(self._has_drawn[self._has_noise].all())
        self._offset(row)

    def change(
        self, signal: Signal, joints: int | Sequence[int] | slice | None = None, **errors: float
    ) -> None:
        """Changes gain, bias, noise or resolution of some sensors while they run.

        Args:
            signal: `angles`, `velocities` or `torques`.
            joints: from 0; all when None.
            **errors: of `SensorErrors`, but `delay`.

        Raises:
            UnknownName: no such signal or error.
            ValueError: noise or resolution below 0.
        """
        row = _row(signal)
        for key, value in errors.items():
            if key not in _ERRORS:
                raise UnknownName("sensor error", key, _ERRORS)
            if key in ("noise", "resolution") and not value >= 0:
                raise Problem(f"{signal}.{key}", found=value, expected="0 or more").error()
            chosen = slice(None) if joints is None else joints
            self._errors[key][self._of][..., row, chosen] = value
        self._plan()

    def delay(
        self, signal: Signal, steps: int, joints: int | Sequence[int] | slice | None = None
    ) -> None:
        """Sets the delay of a signal, in steps.

        What was read before is kept; before the first delay only what was read last.

        Args:
            signal: `angles`, `velocities` or `torques`.
            steps: 0 ends a delay.
            joints: from 0; all when None.

        Raises:
            UnknownName: no such signal.
            ValueError: fewer than 0 steps.
        """
        row = _row(signal)
        if steps < 0:
            raise Problem(
                signal, "found a delay of", found=steps, of="steps", expected="0 or more"
            ).error()
        delays = self._delays[self._of][..., row, :].copy()
        delays[..., slice(None) if joints is None else joints] = steps
        self._delay(row, delays)
        self._plan()

    def _delay(self, row: int, delays: Ints) -> None:
        """Sets the delays of a signal's joints, (n,)."""
        of = self._of
        was_late = self._delays[of][..., row, :].any()
        has_late = self._delays[..., row, :].any()
        self._delays[of][..., row, :] = delays
        longest = int(self._delays[..., row, :].max())
        old, past = self._past[row], np.empty((longest + 1, *self._rows, self.n))
        past[:] = now = self.measured[..., row, :]
        for age in range(min(len(old), len(past)) if has_late else 0):
            past[(self._k - 1 - age) % len(past)] = old[(self._k - 1 - age) % len(old)]
        if has_late and not was_late:
            past[:, of] = now[of]
        self._past[row] = past

    def end_faults(self, reapply: Callable[[], None]) -> None:
        """Ends all faults and changes, and applies the remaining ones again.

        Args:
            reapply: makes these once more; for them it is as if nothing had been.
        """
        of = self._of
        held, delays, past = self._held[of].copy(), self._delays[of].copy(), list(self._past)
        self.repair()
        reapply()
        self._held[of] = held
        wanted = self._delays[of].copy()
        self._delays[of], self._past = delays, past
        for row in range(len(SIGNALS)):
            if (wanted[..., row, :] != delays[..., row, :]).any():
                self._delay(row, wanted[..., row, :])
        self._plan()

    def kill(self, signal: Signal, joint: int) -> None:
        """A sensor that reads zero."""
        self._dead[self._of][..., _row(signal), joint] = True
        self._plan()

    def freeze(self, signal: Signal, joint: int) -> None:
        """A sensor that keeps its last reading."""
        row = _row(signal)
        of = self._of
        self._frozen[of][..., row, joint] = True
        self._held[of][..., row, joint] = self.measured[of][..., row, joint]
        self._plan()

    def _plan(self) -> None:
        """Determines the operations of every step."""
        errors = self._errors
        self._gain = errors["gain"]
        self._scaled = bool((self._gain != 1).any())
        self._noisy = bool((errors["noise"] != 0).any())
        self._shifted = self._noisy or bool((errors["bias"] != 0).any())
        self._has_noise[:] = (errors["noise"] != 0).reshape(len(self._rngs), -1).any(axis=1)
        self._drawn = bool(self._has_drawn[self._has_noise].all())
        for row in range(len(self._rngs)) if self._of is ... else (self._of,):
            self._offset(row)
        coarse = errors["resolution"] > 0
        # Values, their resolution, and for which of them; None for all.
        self._grids = [
            (
                self.measured[..., row, :],
                np.where(coarse[..., row, :], errors["resolution"][..., row, :], 1.0),
                None if coarse[..., row, :].all() else coarse[..., row, :],
            )
            for row in range(len(SIGNALS))
            if coarse[..., row, :].any()
        ]
        self._faulty = bool(self._dead.any() or self._frozen.any())
        self._late = [
            (self.measured[..., row, :], past, self._delays[..., row, :])
            for row, past in enumerate(self._past)
            if self._delays[..., row, :].any()
        ]

        is_off = self._dead | self._frozen | (self._delays != 0)
        for key, right in (("gain", 1.0), ("bias", 0.0), ("noise", 0.0), ("resolution", 0.0)):
            is_off |= errors[key] != right
        if self._differentiated is not None:
            is_off[...] = True
        # Perfect sensors by themselves are not asked to `measure`: among rows it does not count.
        self._idle = ~is_off.reshape(len(self._rngs), -1).any(axis=1)
        self._has_idle = bool(self._rows) and bool(self._idle.any())
        self.is_perfect = bool(self._idle.all())

    def _offset(self, row: int) -> None:
        """Noise and bias of a row together for a block of steps: one addition in every step."""
        shape = (-1, 3, self.n)
        noise, bias = (self._errors[key].reshape(shape)[row] for key in ("noise", "bias"))
        offsets = self._offsets.reshape(_BLOCK, *shape)[:, row]
        multiply(self._noise.reshape(_BLOCK, *shape)[:, row], noise, offsets)
        add(offsets, bias, offsets)

    def _offsets_now(self) -> Array:
        """Noise and bias of this reading, (3, n)."""
        if self._together is not None:
            k = (self._k - self._together) % _BLOCK
            if self._noisy and (k == 0 or not self._drawn):
                self._draw(np.full(len(self._rngs), k))
            together: Array = self._offset_rows[k]
            return together
        rows = (self._k - self._first) % _BLOCK
        if self._noisy and not (self._drawn and rows.all()):
            self._draw(rows)
        return np.asarray(self._offsets[rows, self._places[0][:, 0]])

    def _find_together(self) -> None:
        first = int(self._first[0])
        self._together = first if (self._first == first).all() else None

    def _draw(self, k: Ints) -> None:
        """Draws the noise of a block of steps, of rows that are at its beginning or need it now.

        Args:
            k: (m,), where in their blocks the rows are.
        """
        noise = self._noise.reshape(_BLOCK, -1, 3, self.n)
        for row in np.flatnonzero(self._has_noise & ((k == 0) | ~self._has_drawn)).tolist():
            noise[:, row] = self._rngs[row].standard_normal((_BLOCK, 3, self.n))
            self._has_drawn[row] = True
            self._offset(row)
        self._drawn = True

    def measure(self, actual: Array) -> Array:
        """Reads all sensors.

        Args:
            actual: (3, n), the true values.

        Returns:
            `measured`, (3, n).
        """
        measured, source = self.measured, actual
        if self._scaled:
            source = multiply(source, self._gain, measured)
        offsets = self._offsets_now() if self._shifted else None
        if offsets is not None:
            source = add(source, offsets, measured)
        if source is actual:
            copyto(measured, actual)
        for values, grid, coarse in self._grids:
            steps = values if coarse is None else self._grid_steps
            divide(values, grid, steps)
            rint(steps, steps)
            multiply(steps, grid, steps)
            if coarse is not None:
                copyto(values, steps, where=coarse)
        if self._differentiated is not None:
            self._differentiate(self._differentiated, offsets)
        if self._faulty:
            copyto(measured, self._held, where=self._frozen)
            copyto(measured, 0.0, where=self._dead)
        for values, past, late in self._late:
            past[self._k % len(past)] = values
            values[:] = past[((self._k - late) % len(past), *self._places)]
        self._k += 1
        if self._has_idle:
            self._first += self._idle
            self._find_together()
        return measured

    def _differentiate(self, joints: Bools, offsets: Array | None) -> None:
        """Replaces the velocities of some joints by what their angles have changed by."""
        angles = self.measured[..., 0, :]
        gain, resolution = (
            of_all[..., 1, :] for of_all in (self._gain, self._errors["resolution"])
        )
        if self._has_read:
            change = (angles - self._read_angles) / self._timestep
            self._speeds += self._new_share * (change - self._speeds)
        self._read_angles[:], self._has_read = angles, True
        values = self._speeds * gain
        if offsets is not None:
            values += offsets[..., 1, :]
        grid = np.where(resolution > 0, resolution, 1.0)
        values = np.where(resolution > 0, rint(values / grid) * grid, values)
        copyto(self.measured[..., 1, :], values, where=joints)


def _row(signal: str) -> int:
    if signal not in SIGNALS:
        raise UnknownName("signal", signal, SIGNALS)
    return SIGNALS.index(signal)
