"""Kinematics of robots in numpy: joints to frames, and frames to Denavit-Hartenberg tables.

Open first: `joint_tree.py`.
"""
