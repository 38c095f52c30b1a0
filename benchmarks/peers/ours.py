"""sero-mj, as a user would use it, on the same robots."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import numpy as np
from common import (
    STIFFNESS,
    best,
    main,
    measure_shown,
    open_page,
    poses,
    tell,
    tell_picture,
    urdf,
)

NAME = "sero-mj"
SHOWN = "() => globalThis.player?.calls > 0"  # the first picture is drawn
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # worlds, many


def robot_of_urdf():  # type: ignore[no-untyped-def]
    from sero_mj.load import load_scene

    (robot,) = load_scene(urdf(7)).robots.values()
    return robot


def fk_one() -> None:
    from sero_mj.robots.assemble.forward_kinematics import ForwardKinematics

    fk, q = ForwardKinematics(robot_of_urdf()), poses(7)[0]
    tell(NAME, best(lambda: fk(q)), fk(q))


def fk_many() -> None:
    from sero_mj.robots.assemble.forward_kinematics import ForwardKinematics

    fk, q = ForwardKinematics(robot_of_urdf()), poses(7)
    tell(NAME, best(lambda: fk(q), 2, 20), fk(q)[-1])


def mass_gravity() -> None:
    from sero_mj.simulate.control.robot_model import RobotModel

    model, q, still = RobotModel.of(robot_of_urdf()), poses(7)[0], np.zeros(7)

    def call() -> None:
        model.update(q, still)
        model.mass()
        model.gravity()

    seconds = best(call)
    M = model.mass() - np.diag(model.motor_inertia)
    tell(NAME, seconds, [*M.ravel(), *model.gravity()])


def control(kind: str = "joint_impedance") -> None:
    from sero_mj.simulate.control.controller import Sensed, Target
    from sero_mj.simulate.control.make_controller import controller_from, make_controller
    from sero_mj.simulate.control.robot_model import RobotModel

    robot = robot_of_urdf()
    model = RobotModel.of(robot)
    fields = {"kind": kind} | ({"stiffness": STIFFNESS} if kind == "joint_impedance" else {})
    controller = make_controller(controller_from(fields), model, 1e-3, np.full(7, np.inf))
    sensed, target, out = Sensed(7), Target(7), np.zeros(7)
    sensed.angles[:], target.angles[:] = poses(7)[0], poses(7)[1]
    target.posture[:] = poses(7)[1]
    model.update(sensed.angles, sensed.velocities)
    target.pose[:] = model.flange()
    tell(NAME, best(lambda: controller.torques(sensed, target, out)), out)


def show(joints: int, web: bool) -> None:
    from worlds import WORLDS, make_world

    import sero_mj

    scene = make_world(WORLDS[joints]).scene
    names = [(robot.name, robot.n) for robot in scene.robots.values()]
    with sero_mj.view(scene, web=web) as viewer:

        def update(angles: np.ndarray, torques: np.ndarray) -> None:
            k = 0
            for name, n in names:
                viewer.set(f"{name}.joint_angles", angles[k : k + n])
                viewer.set(f"{name}.torques", torques[k : k + n])
                k += n
            viewer.sync()

        if web:
            open_page(str(viewer.url), SHOWN)
        else:
            time.sleep(2.0)
        measure_shown(NAME, joints, update)


def first_page() -> None:
    import sero_mj

    with sero_mj.view(urdf(7), web=True) as viewer:
        open_page(str(viewer.url), SHOWN)
        tell(NAME, 0.0, at=time.time())


def first_picture() -> None:
    from sero_mj import HeadlessRenderer, World
    from sero_mj.load import load_scene

    world = World(load_scene(urdf(7)))
    with HeadlessRenderer(world, 640, 480) as renderer:
        tell_picture(NAME, renderer.render(world.make_data()))


def packet_to_pixel() -> None:
    import socket

    from sero_mj import HeadlessRenderer, Mirror, UdpReceiver
    from sero_mj.load import load_scene

    scene = load_scene(urdf(7))
    took = []
    source = UdpReceiver(structure="7F7F")
    scene.sources["udp"] = source
    (name,) = scene.robots
    scene.routes = {f"{name}.joint_angles": "udp.values0"}
    with (
        Mirror(scene) as mirror,
        HeadlessRenderer(mirror.world, 640, 480) as renderer,
        socket.socket(type=socket.SOCK_DGRAM) as sock,
    ):
        renderer.render(mirror.data)
        for k in range(40):
            sent = time.perf_counter()
            sock.sendto(np.full(14, 0.01 * k).tobytes(), ("127.0.0.1", source.port))
            mirror.wait_next(1.0)
            mirror.advance()
            renderer.render(mirror.data)
            took.append(time.perf_counter() - sent)
    tell(NAME, float(np.median(took)))


def packets() -> None:
    """Tells for every receiver the seconds of a packet at the highest rate without loss."""
    import tempfile

    from streams import compile_c, throughput

    with tempfile.TemporaryDirectory() as made:
        for receiver, rate, *_ in throughput(compile_c(Path(made)), 2.0):
            tell(NAME, 1.0 / float(rate.removesuffix("/s").replace(",", "")), who=receiver)


def environment(together: bool) -> None:
    import gymnasium
    from with_gymnasium import ROBOTS, bare_of, rate_of

    import sero_mj.extensions.learning  # registers the environments

    assert sero_mj
    name = "sero_mj/lwr-reach-v0"
    alone = gymnasium.make(name).unwrapped
    alone.reset(seed=1)
    inner = alone.environment
    substeps = round(inner.control_timestep / inner.model.opt.timestep)
    bare = bare_of(inner.model, inner.data, substeps)
    shown = gymnasium.make_vec(name, num_envs=ROBOTS) if together else alone
    tell(NAME, rate_of(shown) / bare)


if __name__ == "__main__":
    main({
        "fk_one": fk_one,
        "fk_many": fk_many,
        "mass_gravity": mass_gravity,
        "control": control,
        "joint_control": control,
        "cartesian_control": lambda: control("cartesian_impedance"),
        "show_page_7": lambda: show(7, True),
        "show_page_51": lambda: show(51, True),
        "show_window_7": lambda: show(7, False),
        "show_window_51": lambda: show(51, False),
        "first_page": first_page,
        "first_picture": first_picture,
        "first_scene": first_picture,
        "packet_to_pixel": packet_to_pixel,
        "packets": packets,
        "environment": lambda: environment(False),
        "environments": lambda: environment(True),
    })  # fmt: skip
