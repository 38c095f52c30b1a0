"""Example code for nodes of ROS 2: `sero-mj new --snippet ros2`."""

from __future__ import annotations

from ...cli.new import Snippet

NODE = Snippet(__package__, "ros2.py")
