"""Pinocchio's functions, and its visualizer for MeshCat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from common import (
    DAMPING,
    STIFFNESS,
    best,
    folder,
    main,
    measure_shown,
    open_page,
    poses,
    tell,
    tell_picture,
    urdf,
)
from pinocchio.visualize import MeshcatVisualizer

NAME = "pin"


def load() -> tuple[pin.Model, pin.Data]:
    model = pin.buildModelFromUrdf(urdf(7))
    return model, model.createData()


def fk_one() -> None:
    model, data = load()
    q, flange = poses(7)[0], model.getFrameId("flange")
    out = [np.eye(4)]

    def call() -> None:
        pin.forwardKinematics(model, data, q)
        out[0] = pin.updateFramePlacement(model, data, flange).homogeneous

    tell(NAME, best(call), out[0])


def fk_many() -> None:
    model, data = load()
    q, flange = poses(7), model.getFrameId("flange")
    out = np.empty((len(q), 4, 4))

    def call() -> None:
        for each, frame in zip(q, out, strict=True):
            pin.forwardKinematics(model, data, each)
            frame[...] = pin.updateFramePlacement(model, data, flange).homogeneous

    tell(NAME, best(call, 2, 20), out[-1])


def mass_gravity() -> None:
    model, data = load()
    q = poses(7)[0]

    def call() -> None:
        pin.crba(model, data, q)
        pin.computeGeneralizedGravity(model, data, q)

    seconds = best(call)
    M = np.triu(data.M)
    tell(NAME, seconds, [*(M + np.triu(M, 1).T).ravel(), *data.g])


def control() -> None:
    model, data = load()
    q, v, wanted, out = poses(7)[0], np.zeros(7), poses(7)[1], np.zeros(7)

    def call() -> None:
        g = pin.computeGeneralizedGravity(model, data, q)
        out[:] = STIFFNESS * (wanted - q) - DAMPING * v + g

    tell(NAME, best(call), out)


def meshcat(joints: int) -> MeshcatVisualizer:
    model, collision, visual = pin.buildModelsFromUrdf(urdf(joints), str(Path(folder())))
    shown = MeshcatVisualizer(model, collision, visual)
    shown.initViewer(open=False)
    shown.loadViewerModel()
    return shown


def show(joints: int) -> None:
    from meshcat import geometry

    shown = meshcat(joints)
    model, data, viewer = shown.model, shown.data, shown.viewer
    for k in range(joints):
        viewer[f"torque{k}"].set_object(geometry.Cylinder(1.0, 0.01))
    along = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # a cylinder of MeshCat is along y

    def update(angles: np.ndarray, torques: np.ndarray) -> None:
        shown.display(angles)
        for k in range(joints):
            frame = data.oMi[k + 1].homogeneous
            frame[:3, :3] = frame[:3, :3] @ along * [1.0, 0.01 * torques[k], 1.0]
            viewer[f"torque{k}"].set_transform(frame)

    assert model.nv == joints
    open_page(viewer.url())
    measure_shown("meshcat", joints, update)


def first_page() -> None:
    shown = meshcat(7)
    shown.display(np.zeros(7))
    open_page(shown.viewer.url())
    tell_picture("meshcat", np.asarray(shown.viewer.get_image()))


if __name__ == "__main__":
    main({
        "fk_one": fk_one,
        "fk_many": fk_many,
        "mass_gravity": mass_gravity,
        "control": control,
        "show_page_7": lambda: show(7),
        "show_page_51": lambda: show(51),
        "first_page": first_page,
    })  # fmt: skip
