"""viser with yourdfpy, as its example of a URDF does it."""

from __future__ import annotations

import threading
import time

import numpy as np
import viser
import yourdfpy
from common import main, measure_shown, open_page, tell_picture, urdf
from viser.extras import ViserUrdf

NAME = "viser"


def serve(joints: int) -> tuple[viser.ViserServer, yourdfpy.URDF, ViserUrdf]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    robot = yourdfpy.URDF.load(urdf(joints))
    return server, robot, ViserUrdf(server, robot)


def show(joints: int) -> None:
    server, robot, shown = serve(joints)
    names = robot.actuated_joint_names
    arrows = [
        server.scene.add_cylinder(f"/torques/{name}", radius=0.01, height=1.0) for name in names
    ]
    child = [robot.joint_map[name].child for name in names]

    def update(angles: np.ndarray, torques: np.ndarray) -> None:
        shown.update_cfg(angles)
        with server.atomic():
            for arrow, link, torque in zip(arrows, child, torques, strict=True):
                frame = robot.get_transform(link)
                arrow.position = frame[:3, 3]
                arrow.wxyz = viser.transforms.SO3.from_matrix(frame[:3, :3]).wxyz
                arrow.scale = (1.0, 1.0, 0.01 * abs(torque) + 1e-3)

    open_page(f"http://localhost:{server.get_port()}")
    measure_shown(NAME, joints, update)


def first_page() -> None:
    server, _, shown = serve(7)
    shown.update_cfg(np.zeros(7))
    came, clients = threading.Event(), []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        clients.append(client)
        came.set()

    open_page(f"http://localhost:{server.get_port()}")
    came.wait()
    pixels = np.zeros((1, 1, 3))
    until = time.monotonic() + 60.0
    while np.ptp(pixels) < 20 and time.monotonic() < until:  # its meshes come after its page
        pixels = clients[0].get_render(height=320, width=480)
    tell_picture(NAME, pixels)


if __name__ == "__main__":
    main({
        "show_page_7": lambda: show(7),
        "show_page_51": lambda: show(51),
        "first_page": first_page,
    })  # fmt: skip
