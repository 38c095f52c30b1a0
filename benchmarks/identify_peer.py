"""Identifies a robot with Pinocchio and SciPy, from the runs that `identify.py peer` has written.

    python benchmarks/identify_peer.py         (needs `pip install pin scipy`, but not sero-mj)

The equations are those of a textbook: regressor of the joint torques, both filtered
by the same Butterworth filter without phase shift, and bounded linear least squares with positive
masses and moments of inertia.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
from scipy.optimize import lsq_linear
from scipy.signal import butter, filtfilt

OUT, STEP, CUTOFF, EVERY = Path("out/identify"), 0.001, 10.0, 32
URDF = Path(__file__).parent / "verdicts" / "robots" / "g3.urdf"
model = pinocchio.buildModelFromUrdf(str(URDF))
data, n = model.createData(), model.nv
coefficients = butter(4, 2.0 * CUTOFF * STEP)


def smooth(values: np.ndarray) -> np.ndarray:
    return filtfilt(*coefficients, values, axis=0)


def configuration(q: np.ndarray) -> np.ndarray:
    # Continuous joints have cosine and sine.
    found = []
    for joint, angle in zip(model.joints[1:], q, strict=True):
        found += [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
    return np.array(found)


def regressor(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    rows = zip(q, v, a, strict=True)
    return np.array([
        pinocchio.computeJointTorqueRegressor(model, data, configuration(angles), *rates)
        for angles, *rates in rows
    ])  # fmt: skip


def read(seed: int) -> tuple[np.ndarray, ...]:
    table = np.loadtxt(OUT / f"peer{seed}.csv", delimiter=",", skiprows=1)
    angles, torques, commands = (table[:, 1 + k * n : 1 + (k + 1) * n] for k in range(3))
    # A row contains the torques of the step before it, and the angles at its end.
    v, a = np.diff(angles, axis=0)[:-1] / STEP, np.diff(angles, n=2, axis=0) / STEP**2
    links = regressor(angles[1:-1], v, a).reshape(len(v), -1)
    sign = np.sign(smooth(v))
    torques, lag = torques[2:], (commands - torques)[2:]
    found = [smooth(each)[200:-200:EVERY] for each in (links, v, a, sign, torques, lag)]
    offsets = np.broadcast_to(np.eye(n), (len(found[0]), n, n))
    found[0] = np.concatenate([found[0].reshape(-1, n, 10 * n), offsets], axis=2)
    return tuple(found)


X, v, a, sign, torques, lag = read(1)
X2, v2, a2, sign2, torques2, lag2 = read(2)
rows = X.reshape(-1, 11 * n)
lower = np.full(11 * n, -np.inf)
lower[: 10 * n].reshape(n, 10)[:, [0, 4, 6, 9]] = 0.0  # mass, Ixx, Iyy, Izz
weights = np.ones(n)
for _ in range(2):
    W = np.tile(weights, len(X))
    theta = lsq_linear(
        rows * W[:, None], torques.ravel() * W, (lower, np.inf), "bvls", 1e-12, max_iter=2000
    ).x
    weights = 1.0 / (torques.ravel() - rows @ theta).reshape(-1, n).std(axis=0)
with np.load(OUT / "peer.npz") as truth:
    states, true = truth["states"], truth["torques"]
left = regressor(*states) @ theta[: 10 * n] - true
print("link torques at random states, rms error:", np.sqrt(np.mean(left**2, axis=0)).round(4))
left = torques2 - X2 @ theta
print("link side of the other run, rms error:", np.sqrt(np.mean(left**2, axis=0)).round(5))
for k in range(n):
    moving = np.abs(sign[:, k]) > 0.999
    columns = [np.stack([s[:, k], w[:, k], u[:, k], np.ones(len(s))], axis=1)
               for s, w, u in ((sign, v, a), (sign2, v2, a2))]  # fmt: skip
    bounds = ([0, 0, 0, -np.inf], np.inf)
    values = lsq_linear(columns[0][moving], lag[moving, k], bounds).x
    other = np.abs(sign2[:, k]) > 0.999
    left = lag2[other, k] - columns[1][other] @ values
    print(f"joint_{k + 1}: Coulomb, viscous, inertia, offset:", values.round(5),
          f"other run: {np.sqrt(np.mean(left**2)):.5f}")  # fmt: skip
