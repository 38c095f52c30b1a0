"""Record packets to a file, then replay the file."""

import socket
import struct
import time
from pathlib import Path

import numpy as np
from sero_mj import (
    Mirror,
    Replay,
    Scene,
    SerialRobot,
    UdpReceiver,
    record_sources,
    render_image,
)

robot = SerialRobot.from_model("fr3", show_arrows=True)
routes = {"fr3.joint_angles": "udp.values0", "fr3.torques": "udp.values1"}
receiver = UdpReceiver(structure="7F7F", udpport=32124)
live = Scene(robots=[robot], sources={"udp": receiver}, routes=routes)

with (
    socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    Mirror(live) as mirror,
    record_sources(mirror.sources, "run.mcap", scene=live, overwrite=True),
):
    for t in np.arange(0.0, 1.0, 0.005):  # s
        angles = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.8]) + 0.4 * np.sin(3 * t)
        torques = [40, 40, 30, 30, 8, 8, 4] * np.cos(3 * t + np.arange(7))
        sender.sendto(struct.pack("<14d", *angles, *torques), ("127.0.0.1", 32124))
        time.sleep(0.005)
    time.sleep(0.2)

recorded = Replay(file=Path("run.mcap"))
print(f"{recorded.duration:.2f} s recorded")
replayed = Scene(robots=[robot], sources={"udp": recorded}, routes=routes)
render_image(replayed, "07_record_replay.webp", at=0.5, size=(640, 400))
