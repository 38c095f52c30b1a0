"""Kinematics of robots in numpy: joints to frames, and frames to Denavit-Hartenberg tables.

In: Denavit-Hartenberg tables or frames of joints, and joint values. Out: frames, joint axes and
Jacobians, for one pose or many.
Open first: `joint_tree.py`; then `dh.py`.
"""
