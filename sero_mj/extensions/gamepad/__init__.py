"""Gamepad input in windows: sticks move the camera or targets, and buttons press keys.

In: the first gamepad that GLFW recognizes. Out: the tool `gamepad`.
Open first: `gamepad.py`.
"""
