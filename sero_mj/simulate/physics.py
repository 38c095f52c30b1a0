"""`Physics`: m equal worlds that MuJoCo steps together, the first axis of all arrays."""

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
# MuJoCo's warnings about an unstable motion.
_POSITION, _SPEED, _ACCELERATION = _UNSTABLE = [
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]


class Physics:
    """m equal worlds that are stepped together.

    One world is an `MjData` of its own, because a batch of one takes 4 to 8 us longer per step
    (an LWR's `mj_step` takes 7 us), and to read its `MjData` another 8 us. Worlds of a batch whose
    motion becomes unstable wait where they were at the last `begin`.

    Args:
        is_pushed: whether the poses of bodies are needed after every step.

    Attributes:
        batch: MuJoCo's simulations; None for one world.
        qpos: (m, nq), in place, as are the two that follow.
        qvel: (m, nv).
        applied: (m, nv), `qfrc_applied`, Nm or N.
        unstable: (m,), worlds whose motion has become unstable since `begin`.
        broken: time (s) and accelerations (nv,) of each of these.
        is_ahead: whether kinematics and bias torques of the current state have been computed.
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
        self.is_ahead = True
        if m == 1:
            data = self._data
            self._warned = memoryview(data.warning.number)
            self.qpos: Array = data.qpos[None]
            self.qvel: Array = data.qvel[None]
            self.applied: Array = data.qfrc_applied[None]
            return
        # Persistent data have the constraint forces, which a batch cannot bind.
        self.batch = batch = Batch(model, m, 1, persistent=True)
        self.qpos, self.qvel = batch.bind("qpos"), batch.bind("qvel")
        self.applied = batch.bind("qfrc_applied")
        self._constrained: Array = batch.bind("qfrc_constraint")
        self._constraints, self._frictions = batch.bind("nefc"), batch.bind("nf")
        self._contacts = batch.bind("ncon")
        self._bound: dict[str, Array] = {}
        self.begin(np.ones(m, bool))

    def settle(self, k: int, data: mujoco.MjData) -> None:
        """Sets world k to the state of data that `mj_forward` has completed."""
        if self.batch is not None:
            mujoco.mj_getState(self.model, data, self.batch.state[k], _STATE)
            self.batch.forward([k], stage=_VELOCITY)
        self.is_ahead = True

    def begin(self, which: Bools) -> None:
        """Selects the worlds of the next steps, (m,)."""
        self.unstable[:] = False
        self.broken.clear()
        self._which = which.copy()
        if self.batch is not None:
            self._choose()
            self.is_ahead = False
            self._before: Array = self.batch.state.copy()

    def bind(self, field: str) -> Array:
        """An array of `MjData` of all worlds, (m, ...), as `step` and `look_ahead` leave it."""
        if self.batch is None:
            return np.asarray(getattr(self._data, field))[None]
        if field not in self._bound:
            self._bound[field] = self.batch.bind(field)
            self.is_ahead = False  # it is not written before the next call
        return self._bound[field]

    def drop(self, k: int) -> None:
        """Excludes world k from further steps until the next `begin`."""
        if self.batch is not None:
            self._which[k] = False
            self._choose()

    def _choose(self) -> None:
        self._ids = None if self._which.all() else np.flatnonzero(self._which)

    def step(self) -> bool:
        """Simulates a step of the selected worlds; returns whether their motion is stable."""
        if self.batch is None:
            (mj_step2 if self.is_ahead else mj_step)(self.model, self._data)
            self.is_ahead = False
            warned = self._warned
            if not (warned[_POSITION] or warned[_SPEED] or warned[_ACCELERATION]):
                return True
            self.broken[0] = float(self._data.time), self._data.qacc
            self.unstable[0] = True
            return False
        self.batch.step(self._ids, stage=self._stage)
        self.is_ahead = self._stage == _VELOCITY
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

    def look_ahead(self) -> None:
        """Computes kinematics and bias torques of the selected worlds, if not done yet."""
        if self.is_ahead:
            return
        if self.batch is None:
            mj_step1(self.model, self._data)
        else:
            self.batch.forward(self._ids, stage=_VELOCITY)
        self.is_ahead = True

    def poses_of(self, worlds: Sequence[int], bodies: Ints) -> Array:
        """T_world_body now, (k, 4, 4), m, of k bodies, each in the matching one of `worlds`."""
        positions, rotations = self.bind("xpos"), self.bind("xmat")
        self.look_ahead()
        at = np.asarray(worlds, np.intp), bodies
        poses: Array = np.zeros((len(bodies), 4, 4))
        poses[:, :3, 3], poses[:, :3, :3] = positions[at], rotations[at].reshape(-1, 3, 3)
        poses[:, 3, 3] = 1.0
        return poses

    def data_of(self, k: int) -> mujoco.MjData:
        """Data of a world after its last step or `look_ahead`; of several, valid until a call."""
        return self._data if self.batch is None else self.batch.get_data(k, self._data)

    def model_of(self, k: int) -> mujoco.MjModel:
        """The model of a world, not to be changed."""
        return self._models[k]

    def own_model(self, k: int) -> mujoco.MjModel:
        """The model of a world by itself, to be changed; call `refresh` afterwards."""
        if self.batch is not None and self._models[k] is self.model:
            self._models[k] = copy.copy(self.model)
        return self._models[k]

    def forget_model(self, k: int) -> bool:
        """Gives a world the shared model again; returns whether it had one of its own."""
        is_own = self._models[k] is not self.model
        if is_own and self.batch is not None:
            self._models[k] = self.model
            self.batch.set_models(self._models)
        return is_own

    def refresh(self, k: int) -> None:
        """Computes kinematics and bias torques of a world after a change of its model."""
        if self.batch is None:
            self.is_ahead = False
            self.look_ahead()
            return
        self.batch.set_models(self._models)
        self.batch.forward([k], stage=_VELOCITY)

    def touching(self) -> Sequence[int]:
        """The worlds in which there were contacts in the last step."""
        if self.batch is None:
            return (0,) if self._data.ncon else ()
        return self._contacts.nonzero()[0].tolist() if self._contacts.any() else ()

    def read_inner_forces(self, couplings: Ints, dofs_with_friction: Ints, out: Array) -> None:
        """Writes the forces of couplings, then of Coulomb friction, that acted in the last step.

        They exist until `look_ahead`.

        Args:
            out: (m, k), to be written, Nm or N.
        """
        if self.batch is None:
            _read_inner_forces(self._data, couplings, len(dofs_with_friction), out[0])
            return
        out[:, len(couplings) :] = self._constrained[:, dofs_with_friction]
        hidden = self._which & (self._constraints != self._frictions)
        if not hidden.any():  # else friction acts among other constraints
            return
        for k in np.flatnonzero(hidden).tolist():
            data, forces = self.data_of(k), out[k]
            # Of joints without friction in this world there is no force.
            rubs = self._models[k].dof_frictionloss[dofs_with_friction] > 0
            inner = np.zeros(len(couplings) + int(rubs.sum()))
            _read_inner_forces(data, couplings, int(rubs.sum()), inner)
            forces[: len(couplings)], forces[len(couplings) :] = inner[: len(couplings)], 0.0
            forces[len(couplings) :][rubs] = inner[len(couplings) :]


def _read_inner_forces(data: mujoco.MjData, couplings: Ints, rubs: int, out: Array) -> None:
    # Coulomb friction's rows stand behind those of equality constraints, and before all others.
    if len(couplings):
        out[: len(couplings)] = data.efc_force[couplings]
    if rubs:
        out[len(couplings) :] = data.efc_force[data.ne : data.ne + rubs]
