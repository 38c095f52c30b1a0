"""A gamepad in windows: it moves the camera and targets, and its buttons press keys.

In: the first gamepad that GLFW knows. Out: the tool `gamepad`.
Open first: `gamepad.py`.
"""
