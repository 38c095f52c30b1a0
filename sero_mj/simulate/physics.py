"""`Physics`: m worlds that MuJoCo steps together; they are the first axis of all arrays."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import mj_step, mj_step1, mj_step2
from mujoco.batch import Batch

from ..base.frames import Array, Bools, Ints

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
# MuJoCo's warnings of an unstable motion.
_POSITION, _SPEED, _ACCELERATION = _UNSTABLE = [
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]


class Physics:
    """The m worlds of a batch, which MuJoCo steps together.

    A single world is a plain `MjData`, because a batch of one takes 4 to 8 us longer per step
    (`mj_step` of an LWR takes 7 us), and reading its `MjData` takes another 8 us. If the motion of
    a world in a batch becomes unstable, the world is reset to its state at the last `begin`.

    Args:
        is_pushed: whether body poses are needed after every step.

    Attributes:
        batch: MuJoCo's batch; None for one world.
        qpos: generalized positions, shape (m, nq); may be changed in place.
        qvel: generalized velocities, shape (m, nv); may be changed in place.
        applied: applied torques (`qfrc_applied`), shape (m, nv), Nm or N; may be changed in place.
        unstable: mask of worlds whose motion has become unstable since `begin`, shape (m,).
        broken: time in seconds and accelerations, shape (nv,), by index of an unstable world.
        is_forwarded: whether kinematics and bias torques of the current state are computed.
    """

    def __init__(self, model: mujoco.MjModel, m: int = 1, *, is_pushed: bool = False) -> None:
        self.model, self.m = model, m
        self.batch: Batch | None = None
        self._models = [model] * m
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._stage = _VELOCITY if is_pushed else _NOTHING
        self.unstable: Bools = np.zeros(m, bool)
        self.broken: dict[int, tuple[float, Array]] = {}
        self.is_forwarded = True
        if m == 1:
            data = self._data
            self._warned = memoryview(data.warning.number)
            self.qpos: Array = data.qpos[None]
            self.qvel: Array = data.qvel[None]
            self.applied: Array = data.qfrc_applied[None]
            return
        # Persistent data provide the constraint forces, which a batch cannot bind.
        self.batch = batch = Batch(model, m, 1, persistent=True)
        self.qpos, self.qvel = batch.bind("qpos"), batch.bind("qvel")
        self.applied = batch.bind("qfrc_applied")
        self._constrained: Array = batch.bind("qfrc_constraint")
        self._constraints, self._frictions = batch.bind("nefc"), batch.bind("nf")
        self._contacts = batch.bind("ncon")
        self._bound: dict[str, Array] = {}
        self.begin(np.ones(m, bool))

    def settle(self, k: int, data: mujoco.MjData) -> None:
        """Sets world k to the state of `data`, for which `mj_forward` has been called."""
        if self.batch is not None:
            mujoco.mj_getState(self.model, data, self.batch.state[k], _STATE)
            self.batch.forward([k], stage=_VELOCITY)
        self.is_forwarded = True

    def begin(self, which: Bools) -> None:
        """Selects the worlds to be stepped with a mask, shape (m,)."""
        self.unstable[:] = False
        self.broken.clear()
        self._which = which.copy()
        if self.batch is not None:
            self._choose()
            self.is_forwarded = False
            self._before: Array = self.batch.state.copy()

    def bind(self, field: str) -> Array:
        """Returns an `MjData` field of all worlds, (m, ...), which `step` and `forward` update."""
        if self.batch is None:
            return np.asarray(getattr(self._data, field))[None]
        if field not in self._bound:
            self._bound[field] = self.batch.bind(field)
            self.is_forwarded = False  # the new array is written by the next call
        return self._bound[field]

    def drop(self, k: int) -> None:
        """Excludes world k from further steps until the next `begin`."""
        if self.batch is not None:
            self._which[k] = False
            self._choose()

    def _choose(self) -> None:
        self._ids = None if self._which.all() else np.flatnonzero(self._which)

    def step(self) -> bool:
        """Steps the selected worlds, and returns whether their motion is stable."""
        if self.batch is None:
            (mj_step2 if self.is_forwarded else mj_step)(self.model, self._data)
            self.is_forwarded = False
            warned = self._warned
            if not (warned[_POSITION] or warned[_SPEED] or warned[_ACCELERATION]):
                return True
            self.broken[0] = float(self._data.time), self._data.qacc
            self.unstable[0] = True
            return False
        self.batch.step(self._ids, stage=self._stage)
        self.is_forwarded = self._stage == _VELOCITY
        warnings = self.batch.warning
        if not warnings.any():
            return True
        broken = warnings[:, _UNSTABLE].any(axis=(1, 2))
        for k in np.flatnonzero(broken).tolist():
            data = self.data_of(k)
            self.broken[k] = float(data.time), data.qacc.copy()
        self.unstable |= broken
        self.batch.state[broken] = self._before[broken]
        warnings[:] = 0
        self._which &= ~broken
        self._choose()
        return not broken.any()

    def forward(self) -> None:
        """Computes kinematics and bias torques of the selected worlds if they are out of date."""
        if self.is_forwarded:
            return
        if self.batch is None:
            mj_step1(self.model, self._data)
        else:
            self.batch.forward(self._ids, stage=_VELOCITY)
        self.is_forwarded = True

    def poses_of(self, worlds: Sequence[int], bodies: Ints) -> Array:
        """Returns the poses T_world_body, shape (k, 4, 4), m, for k pairs of a world and a body."""
        positions, rotations = self.bind("xpos"), self.bind("xmat")
        self.forward()
        at = np.asarray(worlds, np.intp), bodies
        poses: Array = np.zeros((len(bodies), 4, 4))
        poses[:, :3, 3], poses[:, :3, :3] = positions[at], rotations[at].reshape(-1, 3, 3)
        poses[:, 3, 3] = 1.0
        return poses

    def data_of(self, k: int) -> mujoco.MjData:
        """Returns a world's `MjData`; in a batch, a copy that is valid until the next call."""
        return self._data if self.batch is None else self.batch.get_data(k, self._data)

    def model_of(self, k: int) -> mujoco.MjModel:
        """Returns the model of a world, which must not be changed."""
        return self._models[k]

    def own_model(self, k: int) -> mujoco.MjModel:
        """Returns a world's own model, which may be changed; call `refresh` afterwards."""
        if self.batch is not None and self._models[k] is self.model:
            self._models[k] = copy.copy(self.model)
        return self._models[k]

    def forget_model(self, k: int) -> bool:
        """Replaces a world's model with the shared model, and returns whether it had its own."""
        is_own = self._models[k] is not self.model
        if is_own and self.batch is not None:
            self._models[k] = self.model
            self.batch.set_models(self._models)
        return is_own

    def refresh(self, k: int) -> None:
        """Computes kinematics and bias torques of a world after a change of its model."""
        if self.batch is None:
            self.is_forwarded = False
            self.forward()
            return
        self.batch.set_models(self._models)
        self.batch.forward([k], stage=_VELOCITY)

    def touching(self) -> Sequence[int]:
        """Returns the worlds that had contacts in the last step."""
        if self.batch is None:
            return (0,) if self._data.ncon else ()
        return self._contacts.nonzero()[0].tolist() if self._contacts.any() else ()

    def read_inner_forces(self, couplings: Ints, dofs_with_friction: Ints, out: Array) -> None:
        """Writes the forces of couplings and Coulomb friction in the last step, Nm or N.

        It must be called before `forward`, which changes the forces in MuJoCo's data.

        Args:
            out: output array, shape (m, couplings + degrees of freedom with friction).
        """
        if self.batch is None:
            _read_inner_forces(self._data, couplings, len(dofs_with_friction), out[0])
            return
        out[:, len(couplings) :] = self._constrained[:, dofs_with_friction]
        hidden = self._which & (self._constraints != self._frictions)
        if not hidden.any():  # otherwise there are other constraints than friction
            return
        for k in np.flatnonzero(hidden).tolist():
            data, forces = self.data_of(k), out[k]
            # In this world, joints without friction have no constraint.
            rubs = self._models[k].dof_frictionloss[dofs_with_friction] > 0
            inner = np.zeros(len(couplings) + int(rubs.sum()))
            _read_inner_forces(data, couplings, int(rubs.sum()), inner)
            forces[: len(couplings)], forces[len(couplings) :] = inner[: len(couplings)], 0.0
            forces[len(couplings) :][rubs] = inner[len(couplings) :]


def _read_inner_forces(data: mujoco.MjData, couplings: Ints, rubs: int, out: Array) -> None:
    # Friction constraints follow the equality constraints.
    if len(couplings):
        out[: len(couplings)] = data.efc_force[couplings]
    if rubs:
        out[len(couplings) :] = data.efc_force[data.ne : data.ne + rubs]
