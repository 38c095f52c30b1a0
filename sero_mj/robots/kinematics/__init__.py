"""Kinematics of robots in NumPy, and conversion of joint frames to Denavit-Hartenberg tables.

The input is a Denavit-Hartenberg table or joint frames, with one or many sets of joint values. The
output is frames, joint axes and Jacobians. Start with `joint_tree.py`, and continue with `dh.py`.
"""
