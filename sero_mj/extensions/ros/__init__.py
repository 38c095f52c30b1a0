"""Robots that speak ROS 2, and their recordings, without ROS.

In: messages of topics, over DDS, foxglove_bridge or zenoh, or from bags. Out: packets of one
structure, as of any source.
Open first: `joined_packets.py` for what becomes of messages, `ros_source.py` for a way by which
they come.
"""
