"""Sends UDP packets at 200 Hz that make the biped of biped.toml bend its knees and sway.

The packets include the pose of the pelvis, because a viewer that mirrors a robot cannot know which
foot carries the weight. Both soles stay fixed on the floor. The torques are those with which each
leg carries its share of the weight of the trunk. The weight of the legs is neglected.
"""

import argparse
import math
import struct

import numpy as np

from sero_mj import load_scene
from sero_mj.data.send.sender import UdpSink, paced, send

RATE = 200  # packets/s
WEIGHT = 29.0 * 9.81  # N, weight of pelvis and hips
ACROSS = 0.2  # m, distance between the hips


def stand(robots, t):
    """Returns the values of the packet at time t (s).

    They are 14 angles (rad), 14 torques (Nm) and the base frame (column by column).
    """
    left, right = robots.values()
    w = 2 * math.pi / 5.0
    bend = 0.45 - 0.25 * math.cos(2 * w * t)  # hip angle and half of the knee angle, rad
    lean = 0.10 * math.sin(w * t)  # to the left, rad
    # The pitch angles of a leg add up to zero, and so do the roll angles: soles and pelvis stay
    # level. The right leg is mirrored, so its roll angles have the opposite sign.
    angles = [
        np.array([0, side * lean, -bend, 2 * bend, -bend, -side * lean, 0]) for side in (1, -1)
    ]
    sole = left.base_frame @ left.fwd_kin_base_to_flange(
        left.home
    )  # on the floor, in the declared pose
    base = sole @ np.linalg.inv(left.fwd_kin_base_to_flange(angles[0]))
    aside = base[1, 3] - left.base_frame[1, 3]
    torques = [
        carrying(leg, q, (0.5 + side * aside / ACROSS) * WEIGHT)
        for leg, q, side in ((left, angles[0], 1), (right, angles[1], -1))
    ]
    return [*np.concatenate([*angles, *torques]), *base.T.ravel()]


def carrying(leg, angles, force):
    """Returns the joint torques (7,), Nm, of a leg that carries a vertical force (N) at the hip."""
    # Principle of virtual work: force * dz of the ankle, with dz from central differences.
    step, ankle = 1e-6, 5
    rows = [
        (leg.dh.frames(angles + e)[ankle, 2, 3] - leg.dh.frames(angles - e)[ankle, 2, 3])
        for e in step * np.eye(7)
    ]
    return -force * np.array(rows) / (2 * step)


def main():
    """Sends packets for the requested number of seconds, or until Ctrl+C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "seconds", nargs="?", type=float, help="duration in seconds (default: until Ctrl+C)"
    )
    parser.add_argument(
        "port", nargs="?", type=int, help="UDP port (default: the port of the scene)"
    )
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
