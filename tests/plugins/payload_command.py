"""A plug-in: a command that prints the payload of a robot with a stretched arm.

Its pyproject.toml has:

    [project.entry-points."sero_mj.commands"]
    carry = "payload_command:Carry"
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from sero_mj import SerialRobot


class Carry:
    """`sero-mj carry lwr`: the payload that the strongest joint can hold."""

    GROUP, ORDER = "analyze", 100

    @staticmethod
    def add_to(commands: Any) -> None:
        """Adds the command."""
        parser = commands.add_parser("carry", help="print the payload of a stretched arm")
        parser.add_argument("robot", metavar="ROBOT")
        parser.set_defaults(run=Carry.run)

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Prints the payload in kg; returns 0."""
        robot = SerialRobot.from_model(options.robot)
        strongest = float(np.max(robot.torque_bounds))
        print(f"{robot.name}: at most {strongest / (9.81 * robot.reach):.1f} kg")
        return 0
