"""Mirror a robot: UDP packets move it and its arrows."""

import socket
import struct
import threading
import time

import sero_mj

scene = sero_mj.Scene(
    robots=[
        sero_mj.SerialRobot.from_model("lwr", show_arrows=True, show_billboards=True)
    ],
    sources={"udp": sero_mj.UdpReceiver(structure="7F7F", udpport=32123)},
    routes={"lwr.joint_angles": "udp.values0", "lwr.torques": "udp.values1"},
)


def send() -> None:
    """Your control loop: 7 joint angles (rad) and 7 torques (Nm) per cycle."""
    packet = struct.pack("<14d", 0, 0.6, 0, -1.2, 0, 1.2, 0, 0, -60, 5, 35, 0, -8, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while True:
            sender.sendto(packet, ("127.0.0.1", 32123))
            time.sleep(0.01)


threading.Thread(target=send, daemon=True).start()
silent = sero_mj.render_image(scene, "00_mirror.webp", size=(640, 400))
print("sources without data:", silent)
