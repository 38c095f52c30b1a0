"""Packets that a simulated robot exchanges with a program in every step.

Both packets use the structure language (STRUCTURE.md). They are stored in memory and written
through views, because encoding them in every step would take longer than the step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...base.errors import Problem, StructureError
from ...base.frames import Array
from ...data.receive.structure import Structure
from ..control.controller import Sensed, Target
from ..control.robot_model import RobotModel

FIRST = 1  # flag of the first state of a run
# Events of a state that have n values, and the functions that return these values.
_OF_JOINTS: Mapping[str, Callable[[Sensed, Target], Array]] = {
    "angles": lambda sensed, _: sensed.angles,
    "velocities": lambda sensed, _: sensed.velocities,
    "torques": lambda sensed, _: sensed.torques,
    "motor_angles": lambda sensed, _: sensed.motor_angles,
    "motor_velocities": lambda sensed, _: sensed.motor_velocities,
    "target_angles": lambda _, target: target.angles,
    "target_velocities": lambda _, target: target.velocities,
    "target_accelerations": lambda _, target: target.accelerations,
}
VALUES = (*_OF_JOINTS, "gravity")
# Events that the robot's model computes from the motors' angles and velocities.
_OF_MODEL: Mapping[str, Callable[[RobotModel], Array]] = {
    "gravity": lambda model: model.gravity(),
    "coriolis": lambda model: model.coriolis(),
    "mass_matrix": lambda model: model.mass().ravel(),
}
_OTHERS = {"step": 1, "flags": 1, "time": 1, "target_pose": 16}
# Events of a command.
_ANSWERED = ("step", "torques", "joint_angles", "stiffness", "damping", "feed_forward")


def default_state(n: int) -> str:
    """Returns the default structure of a state."""
    joints = ("angles", "velocities", "torques", "target_angles", "target_velocities", "gravity")
    return f"< step:1I flags:1I time:1d {' '.join(f'{name}:{n}d' for name in joints)}"


def default_answer(n: int) -> str:
    """Returns the default structure of a command."""
    return f"< step:1I 4x torques:{n}d"


def structure_of(key: str, text: str, sizes: Mapping[str, int]) -> Structure:
    """Parses a structure, and checks its events.

    Args:
        sizes: number of values by event name.

    Raises:
        DeclarationError: the structure is invalid, or has other events or sizes.
    """
    try:
        structure = Structure(text)
    except StructureError as error:
        raise Problem(key, str(error)).error() from None
    for name, shape in structure.events.items():
        if name not in sizes:
            raise Problem(key, "no value", found=name, available=sizes).error()
        count = int(np.prod(shape))
        if count != sizes[name]:
            problem = Problem(key, f"{name} has", found=count, of="numbers", expected=sizes[name])
            raise problem.error()
    return structure


def modulus_of(counter: Any) -> int:
    """Returns the modulus at which a counter, shape (1,), wraps, or 2^64 without a counter."""
    if counter is None:
        return 1 << 64
    kind: np.dtype[Any] = counter.dtype
    if kind.kind == "f":
        return 2 << int(np.finfo(kind).nmant)  # larger integers are not exact
    return 1 + int(np.iinfo(kind).max)


class State:
    """The packet with a robot's state, which is sent to a program.

    Args:
        text: structure of the state; empty for `default_state`.

    Attributes:
        packet: bytes of the packet; always the same object.
        modulus: modulus at which the step counter wraps.

    Raises:
        DeclarationError: the structure has unknown events.
    """

    def __init__(self, text: str, model: RobotModel) -> None:
        n = model.n
        sizes = {**_OTHERS, **dict.fromkeys((*_OF_JOINTS, *_OF_MODEL), n), "mass_matrix": n * n}
        self.structure = structure_of("state", text or default_state(n), sizes)
        self.packet = bytearray(self.structure.size)
        self._model = model
        self._views = {name: _view(self.packet, self.structure, name)
                       for name in self.structure.events}  # fmt: skip
        for item in self.structure.fields:  # constants of the structure
            if item.constant is not None:
                np.frombuffer(self.packet, item.dtype, item.numbers, item.offset)[:] = item.constant
        self._row = np.frombuffer(self.packet, np.uint8)[None]
        self._bound: tuple[Sensed, Target] | None = None
        self._pairs: list[tuple[Array, Array]] = []
        self._word = self._views.get("step")
        self.modulus = modulus_of(self._word)
        self._flags, self._time = self._views.get("flags"), self._views.get("time")
        self._pose = self._views.get("target_pose")
        self._modelled = [(view, _OF_MODEL[name]) for name, view in self._views.items()
                          if name in _OF_MODEL]  # fmt: skip

    def fill(self, step: int, sensed: Sensed, target: Target) -> None:
        """Writes the state of a step to `packet`. Steps are counted from 1."""
        if self._bound is None or self._bound[0] is not sensed or self._bound[1] is not target:
            self._bound = sensed, target
            self._pairs = [
                (view, _OF_JOINTS[name](sensed, target))
                for name, view in self._views.items()
                if name in _OF_JOINTS
            ]
        for view, values in self._pairs:
            view[:] = values
        if self._word is not None:
            self._word[0] = step % self.modulus
        if self._flags is not None:
            self._flags[0] = FIRST if step == 1 else 0
        if self._time is not None:
            self._time[0] = sensed.time
        if self._pose is not None:
            self._pose[:] = target.pose.T.ravel()  # matrices in structures are column-major
        if self._modelled:
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            for view, of_model in self._modelled:
                view[:] = of_model(self._model)
        self.structure.seal(self._row)


class Answer:
    """The packet with a program's command, and the torques that result from it.

    A command contains either `torques`, or `joint_angles` for springs and dampers of the simulated
    robot. Their control law is tau = K (q_d - q) - D dq + g(q) + tau_0. K is `stiffness`, D is
    `damping` (both commanded or declared), and tau_0 is `feed_forward`.

    Args:
        text: structure of the answer; empty for `default_answer`.
        stiffness: declared stiffness K, shape (n,), Nm/rad.
        damping: declared damping D, shape (n,), Nm s/rad.

    Attributes:
        incoming: receive buffer, one byte longer than an answer.
        packet: bytes of the answer that is in use.
        modulus: modulus at which the step counter wraps.

    Raises:
        DeclarationError: the structure has unknown events, or not exactly one of torques and
            joint angles.
    """

    def __init__(
        self, text: str, model: RobotModel, stiffness: Array | None, damping: Array | None
    ) -> None:
        n = model.n
        sizes = {name: 1 if name == "step" else n for name in _ANSWERED}
        self.structure = structure_of("answer", text or default_answer(n), sizes)
        events = self.structure.events
        if ("torques" in events) == ("joint_angles" in events):
            found = " ".join(events) or "neither"
            problem = Problem("answer", found=found, expected="either torques or joint_angles")
            raise problem.error()
        springs = [name for name in ("stiffness", "damping") if name in events]
        if "torques" in events and springs:
            problem = Problem("answer", f"`{springs[0]}` requires `joint_angles`; found `torques`")
            raise problem.error()
        declared = {"stiffness": stiffness, "damping": damping}
        if "joint_angles" in events:
            for name, value in declared.items():
                if value is None and name not in events:
                    expected = f"one number per joint, or {name} in answer"
                    raise Problem(name, "is required", expected=expected).error()
        self.packet = bytearray(self.structure.size)
        self.incoming = bytearray(self.structure.size + 1)
        views = {name: _view(self.packet, self.structure, name) for name in events}
        came = {name: _view(self.incoming, self.structure, name) for name in events}
        self._step, self._torques = came.pop("step", None), views.get("torques")
        self._numbers = list(came.values())
        self.modulus = modulus_of(self._step)
        self._angles, self._more = views.get("joint_angles"), views.get("feed_forward")
        self._stiffness: Any = views.get("stiffness", stiffness)
        self._damping: Any = views.get("damping", damping)
        self._model = model

    @property
    def angles(self) -> Array | None:
        """Commanded angles, shape (n,), rad or m; None for commanded torques."""
        return self._angles

    @property
    def has_step(self) -> bool:
        """Whether answers contain the step number of their state."""
        return self._step is not None

    @property
    def step(self) -> float:
        """Number of the state that the incoming answer belongs to, modulo `modulus`."""
        return 0.0 if self._step is None else float(self._step[0])

    @property
    def is_finite(self) -> bool:
        """Whether all values of the incoming answer are finite."""
        return all(np.isfinite(view).all() for view in self._numbers)

    @property
    def wrong_checksum(self) -> str:
        """Description of a wrong checksum of the incoming answer; empty if it is right."""
        if not self.structure.checksums:
            return ""
        row = np.frombuffer(self.incoming, np.uint8)[None, :-1]
        return self.structure.describe_wrong_checksum(row)

    def use(self) -> None:
        """Replaces the answer in use with the incoming answer."""
        self.packet[:] = self.incoming[:-1]

    def write(self, sensed: Sensed, out: Array) -> None:
        """Writes the torques of the answer in use to `out`, shape (n,)."""
        if self._torques is not None:
            out[:] = self._torques
        else:
            assert self._angles is not None
            np.subtract(self._angles, sensed.motor_angles, out)
            np.multiply(out, self._stiffness, out)
            out -= self._damping * sensed.motor_velocities
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            out += self._model.gravity()
        if self._more is not None:
            out += self._more


def _view(packet: bytearray, structure: Structure, event: str) -> Any:
    item = structure.field(event)
    return np.frombuffer(packet, item.dtype, item.numbers, item.offset)
