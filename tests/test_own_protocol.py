"""The protocol of docs/own_protocol.md: received packets are converted, and a client commands."""

from __future__ import annotations

import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.robot_model import RobotModel

sys.path.insert(0, str(Path(__file__).parent / "plugins"))
import two_protocol as two


class Model:
    """What the simulated robot needs of a `RobotModel`."""

    name, n = "two", 2


def answer(sock: socket.socket) -> None:
    packet, address = sock.recvfrom(100)
    state = two.Structure(two.STATE).decode(packet)
    values = {"count": state["count"], "torques": [1.0, 2.0]}
    sock.sendto(two.COMMAND.encode(values), address)


def test_states_are_converted_to_our_units_and_signs() -> None:
    layout = two.TwoReceiver(port=0).layout
    packet = two.Structure(two.STATE).encode(
        {"count": [1], "time": [0.0], "angles": [90.0, -180.0], "torques": [1.0, -2.0]}
    )
    values = layout.decode_rows(np.frombuffer(packet, np.uint8)[None])
    np.testing.assert_allclose(values["angles"][0], [np.pi / 2, -np.pi])
    np.testing.assert_allclose(values["torques"][0], [-1.0, 2.0])


def test_structure_cannot_be_declared() -> None:
    with pytest.raises(ValueError, match="the protocol Two determines this field"):
        two.TwoReceiver(structure="angles:2d")


def test_client_commands_torques_and_a_missing_answer_ends_the_run() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        declared = two.TwoClient(port=sock.getsockname()[1], patience=0.5)
        robot = two.TwoRobot(declared, Model())
        sensed, target, out = Sensed(2), Target(2), np.zeros(2)
        client = threading.Thread(target=answer, args=(sock,))
        client.start()
        robot.torques(sensed, target, out)
        client.join()
        assert out.tolist() == [1.0, 2.0]
        with pytest.raises(SimulationError):
            robot.torques(sensed, target, out)


def test_another_number_of_joints_is_rejected() -> None:
    with pytest.raises(DeclarationError):
        two.TwoClient().make(RobotModel.of(SerialRobot.from_model("ur5e")), 1e-3)
