"""Robots that use ROS 2, and their recordings, without an installation of ROS.

Registers sources that receive topics over DDS, foxglove_bridge, zenoh or JSON, recordings (bags),
and the controller kind `ros2`. Start with `joined_packets.py`, which converts messages to packets.
"""
