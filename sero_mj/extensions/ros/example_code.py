"""Example code for ROS 2 nodes: `sero-mj new --snippet ros2`."""

from __future__ import annotations

from ...cli.new import Snippet

NODE = Snippet(__package__, "ros2.py")
