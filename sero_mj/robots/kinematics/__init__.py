"""Kinematics of robots in NumPy, and conversion of joint frames to Denavit-Hartenberg tables.

In: a Denavit-Hartenberg table or joint frames, and one or many sets of joint values. Out: frames,
joint axes and Jacobians.
Open first: `joint_tree.py`, then `dh.py`.
"""
