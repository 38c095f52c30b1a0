"""MuJoCo as one uses it without anything else."""

from __future__ import annotations

import os
import socket
import time

import mujoco
import numpy as np
from common import (
    DAMPING,
    STIFFNESS,
    best,
    folder,
    main,
    measure_shown,
    poses,
    tell,
    tell_picture,
    urdf,
)

NAME = "mujoco"


def load(joints: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(urdf(joints))
    return model, mujoco.MjData(model)


def fk_one() -> None:
    model, data = load(7)
    q = poses(7)[0]
    flange = data.body("flange")
    position, rotation, out = flange.xpos, flange.xmat.reshape(3, 3), np.eye(4)

    def call() -> None:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        out[:3, :3], out[:3, 3] = rotation, position

    tell(NAME, best(call), out)


def fk_many() -> None:
    model, data = load(7)
    q = poses(7)
    flange = data.body("flange")
    position, rotation = flange.xpos, flange.xmat.reshape(3, 3)
    out = np.tile(np.eye(4), (len(q), 1, 1))

    def call() -> None:
        for each, frame in zip(q, out, strict=True):
            data.qpos[:] = each
            mujoco.mj_kinematics(model, data)
            frame[:3, :3], frame[:3, 3] = rotation, position

    tell(NAME, best(call, 2, 20), out[-1])


def mass_gravity() -> None:
    model, data = load(7)
    q, M, g = poses(7)[0], np.zeros((7, 7)), np.zeros(7)

    def call() -> None:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, M)
        mujoco.mj_rne(model, data, 0, g)

    tell(NAME, best(call), [*M.ravel(), *g])


def control() -> None:
    model, data = load(7)
    q, v, wanted = poses(7)[0], np.zeros(7), poses(7)[1]
    g, out = np.zeros(7), np.zeros(7)

    def call() -> None:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, g)
        out[:] = STIFFNESS * (wanted - q) - DAMPING * v + g

    tell(NAME, best(call), out)


def show_window(joints: int) -> None:
    import mujoco.viewer

    model, data = load(joints)
    ids = [model.joint(k).id for k in range(model.njnt)]
    rgba = np.array([1.0, 0.5, 0.0, 1.0], np.float32)
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    with mujoco.viewer.launch_passive(model, data) as viewer:
        scene = viewer.user_scn

        def show(angles: np.ndarray, torques: np.ndarray) -> None:
            with viewer.lock():
                data.qpos[:] = angles
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                scene.ngeom = 0
                for k in ids:
                    geom = scene.geoms[scene.ngeom]
                    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
                    tip = data.xanchor[k] + 0.01 * torques[k] * data.xaxis[k]
                    mujoco.mjv_connector(geom, kind, 0.01, data.xanchor[k], tip)
                    scene.ngeom += 1
            viewer.sync()

        time.sleep(2.0)
        measure_shown(NAME, joints, show)
        os._exit(0)  # MuJoCo 4.0 crashes when this closes on a virtual screen


def load_scene() -> tuple[mujoco.MjModel, mujoco.MjData, mujoco.MjvCamera]:
    """The robot with our lights, floor and shadows, and seen as ours is: sky and haze cost most."""
    model = mujoco.MjModel.from_xml_path(str(folder() / "scene7.xml"))
    camera = mujoco.MjvCamera()
    view = np.load(folder() / "camera7.npy")
    camera.lookat[:] = view[:3]
    camera.distance, camera.azimuth, camera.elevation = view[3:]
    return model, mujoco.MjData(model), camera


def first_picture(
    model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera | int = -1
) -> None:
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 480, 640) as renderer:
        renderer.update_scene(data, camera)
        tell_picture(NAME, renderer.render())


def packet_to_pixel() -> None:
    model, data, camera = load_scene()
    took = []
    with (
        mujoco.Renderer(model, 480, 640) as renderer,
        socket.socket(type=socket.SOCK_DGRAM) as sock,
    ):
        sock.bind(("127.0.0.1", 0))
        renderer.update_scene(data, camera)
        renderer.render()
        for k in range(40):
            sent = time.perf_counter()
            sock.sendto(np.full(14, 0.01 * k).tobytes(), sock.getsockname())
            data.qpos[:] = np.frombuffer(sock.recv(256))[:7]
            mujoco.mj_kinematics(model, data)
            renderer.update_scene(data, camera)
            renderer.render()
            took.append(time.perf_counter() - sent)
    tell(NAME, float(np.median(took)))


if __name__ == "__main__":
    main({
        "fk_one": fk_one,
        "fk_many": fk_many,
        "mass_gravity": mass_gravity,
        "control": control,
        "show_window_7": lambda: show_window(7),
        "show_window_51": lambda: show_window(51),
        "first_picture": lambda: first_picture(*load(7)),
        "first_scene": lambda: first_picture(*load_scene()),
        "packet_to_pixel": packet_to_pixel,
    })  # fmt: skip
