"""A plug-in for a made-up protocol over UDP: a receiver, and a simulated robot.

The robot sends a state every cycle, and its client answers with torques:
state `id:1H=0x5101 count:1I time:1d angles:2d torques:2d`, with angles in degrees,
command `id:1H=0x5102 count:1I torques:2d`.
Its pyproject.toml has:

    [project.entry-points."sero_mj.sources"]
    two = "two_protocol:TwoReceiver"
    [project.entry-points."sero_mj.controllers"]
    two = "two_protocol:TwoClient"
"""

from __future__ import annotations

import contextlib
import socket
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from sero_mj.base.errors import Problem, SimulationError
from sero_mj.base.trust import RequestedAction
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.simulate.control.controller import (
    Controller,
    ControllerDeclaration,
    Sensed,
    Target,
)
from sero_mj.simulate.control.robot_model import RobotModel

STATE = "< id:1H=0x5101 count:1I time:1d angles:2d torques:2d"
COMMAND = Structure("< id:1H=0x5102 count:1I torques:2d")


class TwoLayout(Structure):
    """The state, converted to rad and to the sign of sero-mj."""

    def __init__(self) -> None:
        super().__init__(STATE, signs={"torques": -1.0})  # torques act on the drive

    def decode_rows(self, rows: Any, events: Any = None) -> dict[str, np.ndarray]:
        """Converts angles from degrees; `decode_rows` is called for received packets."""
        values = super().decode_rows(rows, events)
        if "angles" in values:
            values["angles"] = np.deg2rad(values["angles"])
        return values


class TwoReceiver(UdpReceiver):
    """Receives the states of a robot."""

    name: str = "two"
    udpport: int = Field(5101, alias="port", ge=0, le=65535)
    structure: str = STATE
    sequence: str = "count"
    time: str = "time"

    _fixed_by: ClassVar[str] = "the protocol Two"

    @cached_property
    def layout(self) -> Structure:
        """The layout of the packets."""
        return TwoLayout()


class TwoClient(ControllerDeclaration):
    """A client that commands torques. `patience` is the maximum time to wait for it, s."""

    may_be_probed: ClassVar[bool] = False
    logged: ClassVar[tuple[str, ...]] = ("answered",)

    kind: Literal["two"] = "two"
    port: int = Field(5101, ge=1, le=65535)
    patience: float = Field(1.0, gt=0.0)

    def actions(self, key: str = "") -> list[RequestedAction]:
        """Asks the user before packets are exchanged."""
        return [RequestedAction(key, f"exchange packets with 127.0.0.1:{self.port}")]

    def make(self, model: RobotModel, timestep: float) -> TwoRobot:
        """Returns the simulated robot."""
        if model.n != 2:
            raise Problem("kind", f"requires 2 joints; {model.name} has {model.n}").error()
        return TwoRobot(self, model)


class TwoRobot(Controller):
    """Sends a state in each step, and waits for the torques that answer it."""

    def __init__(self, declared: TwoClient, model: RobotModel) -> None:
        self._declared, self._name, self._count = declared, model.name, 0
        self._socket: socket.socket | None = None
        self._state = Structure(STATE, signs={"torques": -1.0})
        self.logged = np.zeros(1)

    def torques(self, sensed: Sensed, target: Target, out: np.ndarray) -> None:
        """Exchanges packets in one step."""
        if self._socket is None:
            self._socket = socket.socket(type=socket.SOCK_DGRAM)
            self._socket.connect(("127.0.0.1", self._declared.port))
            self._socket.settimeout(self._declared.patience)
        self._count += 1
        values = {"count": [self._count], "time": [sensed.time], "torques": sensed.torques}
        self._socket.send(self._state.encode({**values, "angles": np.rad2deg(sensed.angles)}))
        with contextlib.suppress(OSError):
            while True:
                packet = self._socket.recv(COMMAND.size + 1)
                if len(packet) == COMMAND.size and packet.startswith(b"\x02\x51"):
                    answer = COMMAND.decode(packet)
                    if answer["count"][0] == self._count and np.isfinite(answer["torques"]).all():
                        out[:] = answer["torques"]
                        self.logged[0] = self._count
                        return
        self.close()
        reason = f"no answer within {self._declared.patience:g} s"
        raise SimulationError(sensed.time, self._name, reason)

    def close(self) -> None:
        """Called at the end of a run."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
