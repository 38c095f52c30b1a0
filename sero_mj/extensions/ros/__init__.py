"""Support of ROS 2 robots and recordings without a ROS installation.

In: messages over DDS, foxglove_bridge, zenoh or JSON, or from bags. Out: sources and recordings
with packets of one structure, and the controller kind `ros2`.
Open first: `joined_packets.py`, which converts messages to packets; `ros_source.py` is the base of
the sources.
"""
