"""Sends UDP packets at 200 Hz that move the parallel robots of five_bar.toml and stewart.toml.

A parallel robot is represented by serial legs that meet at their flanges. The sender must close the
loops, as the controller of a parallel robot does. This script uses the closed-form inverse
kinematics of both robots, and computes the torques and forces of the driven joints from statics.
The base and flange frames of the legs are read from the scene.
"""

import argparse
import math
import struct

import numpy as np

from sero_mj import load_scene
from sero_mj.base.frames import rotation_about, rotation_from_rpy
from sero_mj.data.send.sender import UdpSink, paced, send

RATE = 200  # packets/s
PUSH = 15.0  # N, external force on the five-bar's tool, opposite to its motion
WEIGHT = 25.0 * 9.81  # N, weight of the platform with its load


def five_bar(robots, t):
    """Returns the values of the packet of the five-bar at time t (s).

    They are 5 angles (rad), 2 driving torques (Nm) and the external force on the tool (3,), N.
    """
    left, right = robots["left"], robots["right"]
    u, v = left.dh_params[1][1], left.flange_frame[0, 3]  # link lengths, equal in both legs
    w = 2 * np.pi / 4.0
    tool = np.array([0.09 * math.cos(w * t), 0.36 + 0.05 * math.sin(2 * w * t)])
    velocity = np.array([-0.09 * w * math.sin(w * t), 0.10 * w * math.cos(2 * w * t)])
    push = -PUSH * velocity / np.linalg.norm(velocity)
    angles = []
    for leg, side in ((left, 1.0), (right, -1.0)):
        x, y = tool - leg.base_frame[:2, 3]
        bend = math.acos((x * x + y * y - u * u - v * v) / (2 * u * v))
        elbow = -side * bend  # the elbows point outward
        shoulder = math.atan2(y, x) - math.atan2(v * math.sin(elbow), u + v * math.cos(elbow))
        angles += [shoulder, elbow]
    # Pin joint: aligns the last frame of the right leg with the flange of the left leg.
    angles.append(math.remainder(angles[0] + angles[1] - angles[2] - angles[3], 2 * math.pi))
    # An outer link transmits motion only along its direction e: e . d_tool = u sin(elbow) d_q.
    # Principle of virtual work: the external force and the torques together do no work.
    directions = [[math.cos(a), math.sin(a)] for a in (angles[0] + angles[1], sum(angles[2:4]))]
    levers = [u * math.sin(elbow) for elbow in (angles[1], angles[3])]
    torques = -np.linalg.solve(np.transpose(directions), push) * levers
    return [*angles, *torques, *push, 0.0]


def stewart(robots, t):
    """Returns the values of the packet of the platform at time t (s).

    They are the joint positions of the six legs (36,), rad and m, and the strut forces (6,), N.
    """
    w = 2 * np.pi / 6.0
    tilt = [0.16 * math.sin(w * t), 0.16 * math.sin(w * t + 2.0), 0.25 * math.sin(0.5 * w * t)]
    at = [0.06 * math.cos(w * t), 0.06 * math.sin(w * t), 0.62 + 0.05 * math.sin(2 * w * t)]
    platform = np.eye(4)
    platform[:3, :3] = rotation_from_rpy(tilt)
    platform[:3, 3] = at
    legs = [leg(robot, platform) for robot in robots.values()]
    # Equilibrium: the strut forces and their moments about the center balance the weight.
    wrenches = [np.append(d, np.cross(anchor - at, d)) for _, anchor, d in legs]
    forces = np.linalg.solve(np.transpose(wrenches), [0, 0, WEIGHT, 0, 0, 0])
    return [*(q for joints, _, _ in legs for q in joints), *forces]


def leg(robot, platform):
    """Returns the joint positions (6,) of a leg for a pose of the platform (4, 4).

    Also returns the platform anchor (3,), m, and the strut direction (3,), in the world frame.
    """
    end = platform @ np.linalg.inv(robot.flange_frame)  # T_world_6
    base = robot.base_frame
    x, y, z = base[:3, :3].T @ (end[:3, 3] - base[:3, 3])
    length = math.sqrt(x * x + y * y + z * z)
    universal = [math.atan2(y, x), -math.asin(z / length)]
    strut = base[:3, :3] @ universal_joint(*universal)
    R = strut.T @ end[:3, :3]  # rotation of the spherical joint
    spherical = [
        math.atan2(R[1, 2], R[0, 2]),
        -math.asin(R[2, 2]),
        math.atan2(R[2, 1], -R[2, 0]),
    ]
    retracted = robot.dh_params[2][3]
    return [*universal, length - retracted, *spherical], end[:3, 3], strut[:, 2]


def universal_joint(first, second):
    """Returns the rotation (3, 3) of a universal joint. At zero, z is the x axis of the base."""
    half = math.pi / 2
    crossed = rotation_about(0, -half) @ rotation_about(2, second + half) @ rotation_about(0, half)
    return rotation_about(2, first) @ crossed


def main():
    """Sends packets for the requested number of seconds, or until Ctrl+C."""
    poses = {"five_bar": five_bar, "stewart": stewart}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=poses)
    parser.add_argument(
        "seconds", nargs="?", type=float, help="duration in seconds (default: until Ctrl+C)"
    )
    parser.add_argument(
        "port", nargs="?", type=int, help="UDP port (default: the port of the scene)"
    )
    options = parser.parse_args()
    scene = load_scene(options.scene)
    pose = poses[options.scene]
    (source,) = scene.sources.values()
    port = options.port or source["port"]

    def packet(t):
        values = pose(scene.robots, t)
        return struct.pack(f"<{len(values)}d", *values)

    with UdpSink("127.0.0.1", port) as sink:
        send(paced(packet, RATE, options.seconds), sink)


if __name__ == "__main__":
    main()
