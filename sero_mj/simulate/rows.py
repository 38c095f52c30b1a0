"""Rows: the worlds that a plant steps together, in MuJoCo.

A run has one, a `OneRow`: its arrays are those of a `MjData`, (nq,) and so on. `ManyRows` has many
equal ones, as a batch of MuJoCo: its arrays have the rows as their first axis. What is computed
with them, from joints to drives, stands in the code once for both: it looks at the last axis only.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import mj_step, mj_step1, mj_step2
from mujoco.batch import Batch

from ..base.frames import Array, Bools, Ints, RowIndex

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
# Of MuJoCo's warnings those of a motion that is unstable.
_POSITION, _SPEED, _ACCELERATION = _UNSTABLE = [
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]


class OneRow:
    """One world.

    Args:
        model: of it.
        data: likewise, up to date with its state.

    Attributes:
        model: as given.
        data: as given.
        shape: of what there is one of in a row: (), here.
        indices: of the rows.
        qpos: (nq,), as all that follows in place.
        qvel: (nv,).
        applied: (nv,), Nm or N, `qfrc_applied`.
        is_ahead: whether what follows from the state has been computed: kinematics, bias torques.
    """

    shape: tuple[int, ...] = ()
    indices: Sequence[RowIndex] = (...,)

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self.qpos, self.qvel, self.applied = data.qpos, data.qvel, data.qfrc_applied
        self._warned = memoryview(data.warning.number)
        self.is_ahead = True

    def step(self) -> bool:
        """Simulates a step; returns whether the motion is stable."""
        (mj_step2 if self.is_ahead else mj_step)(self.model, self.data)
        self.is_ahead = False
        warned = self._warned
        return not (warned[_ACCELERATION] or warned[_SPEED] or warned[_POSITION])

    def look_ahead(self) -> None:
        """Computes kinematics and bias torques of the state, if not done yet."""
        if not self.is_ahead:
            mj_step1(self.model, self.data)
            self.is_ahead = True

    def poses_of(self, rows: Sequence[RowIndex], bodies: Ints) -> Array:
        """T_world_body now, (k, 4, 4), m, of k bodies, of which there is one of each in `rows`."""
        self.look_ahead()
        return _poses(self.data.xpos[bodies], self.data.xmat[bodies])

    def data_of(self, row: RowIndex) -> mujoco.MjData:
        """`data`."""
        return self.data

    def model_of(self, row: RowIndex) -> mujoco.MjModel:
        """`model`."""
        return self.model

    def is_broken(self, row: RowIndex) -> bool:
        """Whether the motion became unstable in the last step, which was not stable."""
        return True

    def broken_at(self, row: RowIndex) -> tuple[float, Array]:
        """When the motion became unstable, s, and the accelerations then, (nv,)."""
        return float(self.data.time), self.data.qacc

    def own_model(self, row: RowIndex) -> mujoco.MjModel:
        """`model`, to be changed; call `refresh` afterwards."""
        return self.model

    def refresh(self, row: RowIndex) -> None:
        """Computes kinematics and bias torques after a change of the model."""
        self.is_ahead = False
        self.look_ahead()

    def touching(self) -> Sequence[RowIndex]:
        """The rows in which there were contacts in the last step."""
        return self.indices if self.data.ncon else ()

    def read_inner_forces(self, couplings: Ints, dofs_with_friction: Ints, out: Array) -> None:
        """Writes the forces of couplings, then of Coulomb friction, that acted in the step.

        They are there until `look_ahead`.

        Args:
            couplings: rows of theirs among the constraints.
            dofs_with_friction: indices in `qvel` of what has Coulomb friction.
            out: (k,), to be written, Nm or N.
        """
        _read_inner_forces(self.data, couplings, len(dofs_with_friction), out)


class ManyRows:
    """m equal worlds, which are stepped together.

    Rows whose motion becomes unstable wait where they were at the last `begin`.

    Args:
        model: of all of them.
        m: how many.
        is_pushed: whether it has to be known after every step where bodies are.

    Attributes:
        model: as given.
        batch: MuJoCo's simulations.
        shape: (m,), of what there is one of in a row.
        indices: of the rows.
        qpos: (m, nq), as all that follows in place.
        qvel: (m, nv).
        applied: (m, nv), Nm or N, `qfrc_applied`.
        data: of a world at rest.
        unstable: (m,), whose motion has become unstable since `begin`.
    """

    def __init__(self, model: mujoco.MjModel, m: int, *, is_pushed: bool = False) -> None:
        # Persistent data have the constraint forces, which a batch cannot bind.
        self.model, self.batch = model, Batch(model, m, 1, persistent=True)
        self.shape, self.indices = (m,), range(m)
        self._stage = _VELOCITY if is_pushed else _NOTHING
        self.qpos: Array = self.batch.bind("qpos")
        self.qvel: Array = self.batch.bind("qvel")
        self.applied: Array = self.batch.bind("qfrc_applied")
        self._constrained: Array = self.batch.bind("qfrc_constraint")
        self._constraints, self._frictions = self.batch.bind("nefc"), self.batch.bind("nf")
        self._contacts = self.batch.bind("ncon")
        self._bound: dict[str, Array] = {}
        self._warnings = self.batch.warning
        self._models: dict[RowIndex, mujoco.MjModel] = dict.fromkeys(range(m), model)
        self.data, self._scratch = mujoco.MjData(model), mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        self.unstable: Bools = np.zeros(m, bool)
        self.is_ahead = True
        self.begin(np.ones(m, bool))

    def place(self, k: int, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Sets row k to the state of an equal world.

        Returns:
            whether it had a model of its own, which is forgotten.
        """
        mujoco.mj_getState(model, data, self.batch.state[k], _STATE)
        if self._models[k] is self.model:
            self.batch.forward([k], stage=_VELOCITY)
            return False
        self._models[k] = self.model
        self.refresh(k)
        return True

    def begin(self, which: Bools) -> None:
        """Selects the rows of the next steps, (m,)."""
        self._choose(which)
        self.is_ahead = False
        self._before: Array = self.batch.state.copy()
        self._broken_at: dict[RowIndex, tuple[float, Array]] = {}
        self.unstable[:] = False

    def bind(self, field: str) -> Array:
        """An array of `MjData` of all rows, (m, ...), as `step` and `look_ahead` leave it."""
        if field not in self._bound:
            self._bound[field] = self.batch.bind(field)
            self.is_ahead = False  # it is not written before the next call
        return self._bound[field]

    def drop(self, k: RowIndex) -> None:
        """Excludes row k from further steps until the next `begin`."""
        which = self._which.copy()
        which[k] = False
        self._choose(which)

    def _choose(self, which: Bools) -> None:
        self._which = which
        self._ids = None if which.all() else np.flatnonzero(which)

    def step(self) -> bool:
        """Simulates a step of the selected rows; returns whether their motion is stable."""
        self.batch.step(self._ids, stage=self._stage)
        self.is_ahead = self._stage == _VELOCITY
        if not self._warnings.any():
            return True
        broken = self._warnings[:, _UNSTABLE].any(axis=(1, 2))
        for k in np.flatnonzero(broken).tolist():
            data = self.data_of(k)
            self._broken_at[k] = float(data.time), data.qacc.copy()
        self.unstable |= broken
        self.batch.state[broken] = self._before[broken]
        self._warnings[:] = 0
        self._choose(self._which & ~broken)
        return not broken.any()

    def look_ahead(self) -> None:
        """Computes kinematics and bias torques of the selected rows, if not done yet.

        All at once, whoever asks: the next step goes on from there.
        """
        if not self.is_ahead:
            self.batch.forward(self._ids, stage=_VELOCITY)
            self.is_ahead = True

    def poses_of(self, rows: Sequence[RowIndex], bodies: Ints) -> Array:
        """See `OneRow`."""
        positions, rotations = self.bind("xpos"), self.bind("xmat")
        self.look_ahead()
        at = np.asarray(rows, np.intp), bodies
        return _poses(positions[at], rotations[at])

    def data_of(self, row: RowIndex) -> mujoco.MjData:
        """Data of a row after its last step or `look_ahead`; valid until the next call."""
        return self.batch.get_data(row, self._scratch)

    def model_of(self, row: RowIndex) -> mujoco.MjModel:
        """The model of a row, not to be changed."""
        return self._models[row]

    def is_broken(self, row: RowIndex) -> bool:
        """Whether a row's motion has become unstable since `begin`."""
        return row in self._broken_at

    def broken_at(self, row: RowIndex) -> tuple[float, Array]:
        """See `OneRow`; of a row that is among `broken`."""
        return self._broken_at[row]

    def own_model(self, row: RowIndex) -> mujoco.MjModel:
        """The model of a row by itself, to be changed; call `refresh` afterwards."""
        if self._models[row] is self.model:
            self._models[row] = copy.copy(self.model)
        return self._models[row]

    def refresh(self, row: RowIndex) -> None:
        """Lets a row's own model, which was changed, be that of its next steps."""
        self.batch.set_models([*self._models.values()])
        self.batch.forward([row], stage=_VELOCITY)

    def touching(self) -> Sequence[RowIndex]:
        """The rows in which there were contacts in the last step."""
        return self._contacts.nonzero()[0].tolist() if self._contacts.any() else ()

    def read_inner_forces(self, couplings: Ints, dofs_with_friction: Ints, out: Array) -> None:
        """See `OneRow`; out is (m, k)."""
        out[:, len(couplings) :] = self._constrained[:, dofs_with_friction]
        hidden = self._which & (self._constraints != self._frictions)
        if hidden.any():  # friction acts among other constraints
            for k in np.flatnonzero(hidden).tolist():
                data, row = self.batch.get_data(k, self._scratch), out[k]
                if self._models[k] is self.model:
                    _read_inner_forces(data, couplings, len(dofs_with_friction), row)
                    continue
                # Of joints without friction in this row there is no force.
                rubs = self._models[k].dof_frictionloss[dofs_with_friction] > 0
                inner = np.zeros(len(couplings) + int(rubs.sum()))
                _read_inner_forces(data, couplings, int(rubs.sum()), inner)
                row[: len(couplings)], row[len(couplings) :] = inner[: len(couplings)], 0.0
                row[len(couplings) :][rubs] = inner[len(couplings) :]


def _poses(positions: Array, rotations: Array) -> Array:
    poses: Array = np.zeros((len(positions), 4, 4))
    poses[:, :3, 3], poses[:, :3, :3] = positions, rotations.reshape(-1, 3, 3)
    poses[:, 3, 3] = 1.0
    return poses


def _read_inner_forces(data: mujoco.MjData, couplings: Ints, rubs: int, out: Array) -> None:
    # Coulomb friction's rows stand behind those of equality constraints, and before all others.
    forces = data.efc_force
    if len(couplings):
        out[: len(couplings)] = forces[couplings]
        out[len(couplings) :] = forces[data.ne : data.ne + rubs]
    elif rubs:
        out[...] = forces if len(forces) == rubs else forces[data.ne : data.ne + rubs]
