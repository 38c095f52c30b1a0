"""Sends UDP packets for justin.toml at 200 Hz that move Rollin' Justin with its platform.

The platform moves along a figure of eight and rotates. Each wheel is steered along the velocity of
its contact point and rolls without slip. Arms, torso, head and fingers move as with `sero-mj send`.
"""

import argparse
import math

import numpy as np

from sero_mj import load_scene
from sero_mj.data.send.play import MotionPackets
from sero_mj.data.send.sender import UdpSink, paced, send

RATE = 200  # packets/s
PERIOD = 24.0  # s, duration of one figure of eight
LENGTH, WIDTH = 0.8, 0.5  # half length and half width of the path, m
WHEEL = 0.10  # m, radius


def platform(t):
    """Returns x, y (m) and yaw (rad) of the platform at time t (s)."""
    w = 2 * math.pi * t / PERIOD
    return np.array([LENGTH * math.sin(w), WIDTH * math.sin(2 * w), 0.5 * math.sin(w + 1.0)])


class Platform:
    """Moves the platform along its path, and steers and drives its wheels.

    Args:
        robots: robots of the scene by name. The base frames of the wheels are relative to the
            platform.
    """

    def __init__(self, robots):
        wheels = {name: robot for name, robot in robots.items() if name.endswith("_wheel")}
        self.at = np.array([robot.base_frame[:2, 3] for robot in wheels.values()])
        outwards = [robot.base_frame[:2, 0] for robot in wheels.values()]
        self.outwards = np.array([math.atan2(y, x) for x, y in outwards])
        self.steer = np.array([robot.home[0] for robot in wheels.values()])
        self.drive = np.zeros(len(wheels))

    def go(self, t, dt):
        """Returns T_world_base (4, 4) and wheel angles (n, 2: steer, drive), rad, after dt (s)."""
        x, y, yaw = platform(t)
        vx, vy, turning = (platform(t + 1e-4) - platform(t - 1e-4)) / 2e-4
        c, s = math.cos(yaw), math.sin(yaw)
        # Velocity of each wheel in the platform frame, from translation and rotation.
        velocity = np.array([c * vx + s * vy, c * vy - s * vx])
        velocity = velocity + turning * np.stack([-self.at[:, 1], self.at[:, 0]], axis=1)
        wanted = np.arctan2(velocity[:, 1], velocity[:, 0]) - self.outwards
        # A wheel rolls backwards instead of steering by more than 90 degrees.
        off = np.remainder(wanted - self.steer + math.pi / 2, math.pi) - math.pi / 2
        self.steer = self.steer + off
        heading = self.steer + self.outwards
        forwards = np.sum(velocity * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=1)
        self.drive = self.drive + forwards * dt / WHEEL
        base = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
        return base, np.stack([self.steer, self.drive], axis=1)


def packets(scene):
    """Yields the packets, RATE per second."""
    motion = MotionPackets(scene)
    way = Platform(scene.robots)
    k = 0
    while True:
        values = motion.structure.decode(motion.at(k / RATE))
        base, wheels = way.go(k / RATE, 1 / RATE)
        angles = np.array(values["values0"])
        angles[-wheels.size :] = wheels.ravel()  # the wheels are the last members
        yield motion.structure.encode({**values, "values0": angles, "matrices0": base[None]})
        k += 1


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
    scene = load_scene("justin")
    port = options.port or scene.sources["udp"]["port"]
    stream = packets(scene)
    with UdpSink("127.0.0.1", port) as sink:
        send(paced(lambda t: next(stream), RATE, options.seconds), sink)


if __name__ == "__main__":
    main()
