"""Moves the biped of biped.toml, by UDP at 200 Hz: it bends its knees and sways, feet on the floor.

Who sends the angles of legs that stand also says where the pelvis is: a viewer that mirrors cannot
know which foot carries. Here both soles stay where they are. Torques are those with which the legs
carry the weight of the trunk, each its share; their own weight is left out.
"""

import argparse
import math
import struct

import numpy as np

from sero_mj import load_scene
from sero_mj.data.send.sender import UdpSink, paced, send

RATE = 200  # packets/s
WEIGHT = 29.0 * 9.81  # N, of pelvis and hips
ACROSS = 0.2  # m, from hip to hip


def stand(robots, t):
    """Returns the packet at time t, s: angles (14,), rad, torques (14,), Nm, the base's frame."""
    left, right = robots.values()
    w = 2 * math.pi / 5.0
    bend = 0.45 - 0.25 * math.cos(2 * w * t)  # of the hip, half of the knee's, rad
    lean = 0.10 * math.sin(w * t)  # to the left, rad
    # Pitches add up to zero, and so do rolls: soles and pelvis are level. Equal values of the
    # mirrored leg would lean the other way.
    angles = [
        np.array([0, side * lean, -bend, 2 * bend, -bend, -side * lean, 0]) for side in (1, -1)
    ]
    sole = left.base_frame @ left.fwd_kin_base_to_flange(left.home)  # on the floor, as declared
    base = sole @ np.linalg.inv(left.fwd_kin_base_to_flange(angles[0]))
    aside = base[1, 3] - left.base_frame[1, 3]
    torques = [
        carrying(leg, q, (0.5 + side * aside / ACROSS) * WEIGHT)
        for leg, q, side in ((left, angles[0], 1), (right, angles[1], -1))
    ]
    return [*np.concatenate([*angles, *torques]), *base.T.ravel()]


def carrying(leg, angles, force):
    """Returns the torques (7,), Nm, that carry a force, N, from the ankle's joints to the hip."""
    # By the work of the floor's push on the foot, at the ankle: force * dz, by differences.
    step, ankle = 1e-6, 5
    rows = [
        (leg.dh.frames(angles + e)[ankle, 2, 3] - leg.dh.frames(angles - e)[ankle, 2, 3])
        for e in step * np.eye(7)
    ]
    return -force * np.array(rows) / (2 * step)


def main():
    """Sends packets until Ctrl-C, or for so many seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seconds", nargs="?", type=float, help="without an end when left out")
    parser.add_argument("port", nargs="?", type=int, help="the scene's when left out")
    options = parser.parse_args()
    scene = load_scene("biped")
    (source,) = scene.sources.values()
    port = options.port or source["port"]

    def packet(t):
        values = stand(scene.robots, t)
        return struct.pack(f"<{len(values)}d", *values)

    with UdpSink("127.0.0.1", port) as sink:
        send(paced(packet, RATE, options.seconds), sink)


if __name__ == "__main__":
    main()
