"""Sends `joint_states` of ROS 2 to sero-mj. Run `python ros2.py` in a ROS environment."""

import itertools
import socket
import struct

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

JOINTS = 7
HOST, PORT = "127.0.0.1", 32000  # where sero-mj runs
NAMES = []  # joint names in the robot's order (default: the names in the first message)

counts = itertools.count(1)
to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def send(message):
    """Sends a JointState with position in rad and effort in Nm, without commanded torques."""
    if not NAMES:
        NAMES.extend(message.name[:JOINTS])
    if not set(NAMES) <= set(message.name):
        return  # the message is for other joints
    order = [message.name.index(name) for name in NAMES]
    nan = [float("nan")] * JOINTS
    effort = [message.effort[k] for k in order] if len(message.effort) else nan
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    values = (*(message.position[k] for k in order), *effort, *nan)
    to.sendto(struct.pack(f"<Id{3 * JOINTS}d", next(counts), stamp, *values), (HOST, PORT))


rclpy.init()
node = Node("sero_mj_sender")
node.create_subscription(JointState, "joint_states", send, qos_profile_sensor_data)
rclpy.spin(node)
