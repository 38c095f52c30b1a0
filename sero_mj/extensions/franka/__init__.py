"""Franka Robotics: the Franka Control Interface (FCI).

Registers the source `franka`, and the controller kind `franka`, a simulated robot for clients that
use libfranka. Start with `receiver.py`, or with `robot.py` for the simulated robot.
"""
