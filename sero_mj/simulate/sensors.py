"""Sensors of a robot: what they add to the truth, and how they fail.

A value goes through gain and bias, noise, quantisation and faults, and then through the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy import add, copyto, divide, multiply, rint
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

from ..assemble.declaration import Declaration, numbers
from ..errors import UnknownName

Array = NDArray[np.float64]
Signal = Literal["angles", "velocities", "torques"]
SIGNALS: tuple[Signal, ...] = ("angles", "velocities", "torques")
_ERRORS = ("gain", "bias", "noise", "resolution")
_BLOCK = 256  # steps; drawing noise for each by itself takes longer than the rest


def _per_joint(value: Any) -> Array:
    array = numbers(value)
    if array.ndim > 1:
        raise ValueError(f"found {array.ndim} dimensions; expected one number, or one per joint")
    return array


def _at_least_zero(array: Array) -> Array:
    if (array < 0).any():
        raise ValueError(f"found {array.tolist()}; expected 0 or more")
    return array


_PerJoint = Annotated[Array, BeforeValidator(_per_joint)]
_NotNegative = Annotated[Array, BeforeValidator(_per_joint), AfterValidator(_at_least_zero)]


class SensorErrors(Declaration):
    """What sensors of one kind add to the truth: one number for all joints, or (n,).

    Attributes:
        noise: standard deviation of white noise, rad, rad/s or Nm.
        bias: rad, rad/s or Nm.
        resolution: distance of the values there are; 0 for all.
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

    Args:
        n: number of joints.
        angles: of the link, behind gear and spring.
        velocities: likewise.
        torques: of the torque sensors.
        seed: of the noise; the same seed gives the same values.

    Attributes:
        measured: (3, n), what was read last; the same array all the time.
        seed: of the noise from the next `reset` on.

    Raises:
        ValueError: an error has neither one number nor n.
    """

    def __init__(
        self,
        n: int,
        angles: SensorErrors | None = None,
        velocities: SensorErrors | None = None,
        torques: SensorErrors | None = None,
        seed: int = 0,
    ) -> None:
        self.n = n
        self.measured = np.zeros((3, n))
        self.seed = seed
        self._declared = [errors or SensorErrors() for errors in (angles, velocities, torques)]
        self._noise_block = np.zeros((_BLOCK, 3, n))
        self._value, self._steps = np.zeros((3, n)), np.zeros((3, n))
        self._k = 0
        self.repair()
        self.reset(self.measured)

    def repair(self) -> None:
        """Ends all faults and changes: every sensor is as it was declared."""
        shape = (3, self.n)
        self._errors = {key: np.zeros(shape) for key in _ERRORS}
        self._dead = np.zeros(shape, bool)
        self._frozen = np.zeros(shape, bool)
        self._held = np.zeros(shape)
        for row, (signal, declared) in enumerate(zip(SIGNALS, self._declared, strict=True)):
            for key in _ERRORS:
                value = getattr(declared, key)
                if value.shape not in ((), (1,), (self.n,)):
                    raise ValueError(
                        f"{signal}.{key}: found {len(value)} numbers; expected 1 or {self.n}"
                    )
                self._errors[key][row] = value
        self._delays = [declared.delay for declared in self._declared]
        self._plan()

    def reset(self, actual: Array) -> None:
        """Begins anew: the noise from its seed, and delays as if all had stood still before.

        Args:
            actual: (3, n), the true values now.
        """
        self._rng = np.random.default_rng(self.seed)
        self._k = 0
        self._past = np.zeros((max(self._delays) + 1, 3, self.n))
        for _ in self._past:
            self.measure(actual)

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
        """
        row = _row(signal)
        for key, value in errors.items():
            if key not in _ERRORS:
                raise UnknownName("sensor error", key, _ERRORS)
            self._errors[key][row, slice(None) if joints is None else joints] = value
        self._plan()

    def delay(self, signal: Signal, steps: int) -> None:
        """Delays a signal by so many steps from now on.

        What was read before is kept; before the first delay only what was read last.
        """
        self._delays[_row(signal)] = steps
        length, old = max(self._delays) + 1, len(self._past)
        past = np.empty((length, 3, self.n))
        past[:] = self.measured
        for age in range(min(length, old) if self._delayed else 0):
            past[(self._k - 1 - age) % length] = self._past[(self._k - 1 - age) % old]
        self._past = past
        self._plan()

    def kill(self, signal: Signal, joint: int) -> None:
        """A sensor that reads zero."""
        self._dead[_row(signal), joint] = True
        self._plan()

    def freeze(self, signal: Signal, joint: int) -> None:
        """A sensor that goes on reading what it has read last."""
        row = _row(signal)
        self._frozen[row, joint] = True
        self._held[row, joint] = self.measured[row, joint]
        self._plan()

    def _plan(self) -> None:
        """Finds out what there is to do in every step."""
        errors = self._errors
        self._scaled = bool((errors["gain"] != 1).any())
        self._biased = bool((errors["bias"] != 0).any())
        self._noisy = bool((errors["noise"] != 0).any())
        self._coarse = errors["resolution"] > 0
        self._grid = np.where(self._coarse, errors["resolution"], 1.0)
        self._quantised = bool(self._coarse.any())
        self._faulty = bool(self._dead.any() or self._frozen.any())
        self._delayed = any(self._delays)
        self._perfect = not (
            self._scaled or self._biased or self._noisy or self._quantised or self._faulty
        )
        self._transparent = self._perfect and not self._delayed

    def measure(self, actual: Array) -> Array:
        """Reads all sensors.

        Args:
            actual: (3, n), the true values.

        Returns:
            `measured`, (3, n).
        """
        if self._transparent:
            copyto(self.measured, actual)
            self._k += 1
            return self.measured
        value = self._value
        copyto(value, actual)
        if not self._perfect:
            self._falsify(value)
        if not self._delayed:
            copyto(self.measured, value)
        else:
            length = len(self._past)
            self._past[self._k % length] = value
            for row, steps in enumerate(self._delays):
                self.measured[row] = self._past[(self._k - steps) % length, row]
        self._k += 1
        return self.measured

    def _falsify(self, value: Array) -> None:
        if self._scaled:
            multiply(value, self._errors["gain"], value)
        if self._biased:
            add(value, self._errors["bias"], value)
        if self._noisy:
            k = self._k % _BLOCK
            if k == 0:
                self._rng.standard_normal(out=self._noise_block)
            multiply(self._noise_block[k], self._errors["noise"], self._steps)
            add(value, self._steps, value)
        if self._quantised:
            divide(value, self._grid, self._steps)
            rint(self._steps, self._steps)
            multiply(self._steps, self._grid, self._steps)
            copyto(value, self._steps, where=self._coarse)
        if self._faulty:
            copyto(value, self._held, where=self._frozen)
            copyto(value, 0.0, where=self._dead)


def _row(signal: str) -> int:
    if signal not in SIGNALS:
        raise UnknownName("signal", signal, SIGNALS)
    return SIGNALS.index(signal)
