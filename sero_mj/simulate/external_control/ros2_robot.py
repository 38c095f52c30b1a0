"""`kind = "ros2"`: a node of ROS 2 holds the simulated robot, by topics as ros2_control has them.

The simulation publishes `sensor_msgs/JointState` and `/clock`, and takes commands in a
`std_msgs/Float64MultiArray` as forward controllers do. It is a participant of DDS itself; no ROS is
needed here.
"""

from __future__ import annotations

import struct
import time as clock
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import DeclarationError, Problem, SourceError
from ...base.frames import Array
from ...data.record.joint_state_messages import JointStateMessages, JointStates
from ...data.ros import messages
from ...data.ros.dds import LOCALHOST, MOST_DOMAIN, Participant, domain_number
from ...data.ros.messages import MalformedMessage
from ...data.ros.ros_source import wrong_with
from ..control.controller import MaybePerJoint, Sensed, Target
from ..control.robot_model import RobotModel
from .datagrams import Answering, Link, ProgramController
from .exchange import Answer, modulus_of
from .program import Program

_SHAPES = ("angles", "velocities", "torques")
_REPEATED = 0.1  # s, until a first state is published again: its reader may just be found
_SLICE = 0.02  # s
_CLOCK = struct.Struct("<4siI")
_HEAD = b"\0\1\0\0"  # plain CDR, little-endian


class Ros2Node(Answering):
    """A node of ROS 2 that publishes commands for each state of the joints.

    Attributes:
        host: where it is: `localhost`, this machine alone; `subnet`; or a machine's address.
        domain: ROS_DOMAIN_ID; None for that of the environment, else 0.
        namespace: stands before topics that do not begin with `/`.
        joint_states: topic that the state is published to.
        commands: topic of `std_msgs/Float64MultiArray` with a number for each joint.
        joint_names: of the messages; those of the robot when empty.
        interface: what the numbers are: `effort`, torques; or `position`, angles for springs and
            dampers of the robot.
        stiffness: Nm/rad per joint, of these springs.
        damping: Nm s/rad per joint.
        publishes_clock: whether `/clock` is published, for nodes with use_sim_time.
    """

    title: ClassVar[str] = "node of ROS 2"
    order: ClassVar[int] = 85

    kind: Literal["ros2"] = "ros2"
    host: str = LOCALHOST
    domain: int | None = Field(None, ge=0, le=MOST_DOMAIN)
    namespace: str = ""
    joint_states: str = "joint_states"
    commands: str = "forward_effort_controller/commands"
    joint_names: list[str] = []
    interface: Literal["effort", "position"] = "effort"
    stiffness: MaybePerJoint = None
    damping: MaybePerJoint = None
    publishes_clock: bool = True

    @model_validator(mode="after")
    def _is_reachable(self) -> Self:
        if self.port:
            raise Problem("port", "is not for ROS 2; leave it out").error()
        return self

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        """The controller; it joins the domain with its first step."""
        n = model.n
        names = self.joint_names or list(model.joint_names)
        if len(names) != n:
            found = len(names)
            problem = Problem(
                "joint_names", found=found, of="names", expected=f"{n}, one per joint"
            )
            raise problem.error()
        key = "torques" if self.interface == "effort" else "joint_angles"
        gains = [
            None if getattr(self, gain) is None else self.per_joint(gain, n)
            for gain in ("stiffness", "damping")
        ]
        answer = Answer(f"< {key}:{n}d", model, *gains)
        state = JointStatePacket(names)
        return ProgramController(self, state, answer, model, timestep, RosLink(self, model, n))

    def full(self, topic: str) -> str:
        """A topic's full name."""
        before = self.namespace.strip("/")
        return topic if topic.startswith("/") else f"/{before}/{topic}" if before else f"/{topic}"


class JointStatePacket:
    """The state of a robot as a message of ROS.

    Args:
        names: of its joints.

    Attributes:
        packet: the message, in CDR.
        modulus: of a counter, which it has not.
    """

    modulus = modulus_of(None)

    def __init__(self, names: list[str]) -> None:
        shapes = dict.fromkeys(_SHAPES, (len(names),))
        self._messages = JointStateMessages(JointStates(names, *_SHAPES), shapes)
        self._table: Array = np.zeros((1, 3 * len(names)))
        self.packet = b""

    def fill(self, step: int, sensed: Sensed, target: Target) -> None:
        """Writes the state of a step."""
        self._table[0] = sensed.values.ravel()
        (self.packet,) = self._messages.encode(self._table, [round(sensed.time * 1e9)])


class RosLink(Link):
    """Topics to a node and from it, which is started where that is declared.

    Args:
        declared: the topics.
        model: of the robot.
        count: of numbers in a command.
    """

    def __init__(self, declared: Ros2Node, model: RobotModel, count: int) -> None:
        super().__init__(declared, model.name, 8 * count)
        self._topics, self._count = declared, count
        self._participant: Participant | None = None

    @property
    def name(self) -> str:
        """Of the topic, for messages."""
        return self._topics.full(self._topics.commands)

    @property
    def is_open(self) -> bool:
        """Whether it is."""
        return self._participant is not None

    def open(self, time: float) -> None:
        """Joins the domain, and starts the program, if it is to be."""
        declared = self._topics
        try:
            self._participant = participant = Participant(
                declared.host, declared.domain, declared.kind
            )
        except SourceError as error:
            raise DeclarationError([Problem("kind", str(error))]) from None
        self._reader = participant.reader(declared.full(declared.commands), messages.NUMBERS)
        self._states = participant.writer(
            declared.full(declared.joint_states), messages.JOINT_STATE
        )
        self._clock = participant.writer("/clock", messages.CLOCK)
        if declared.command:
            domain = str(domain_number(declared.domain))
            environment = {"ROS_DOMAIN_ID": domain}
            self._program = Program(declared.command, declared.folder, environment)
        self._given_up = clock.monotonic() + declared.first_patience
        self._began = clock.monotonic() - time

    def close(self) -> None:
        """Leaves the domain, and ends the program; harmless when that is done."""
        if self._participant is not None:
            self._participant.close()
        self._participant = None
        super().close()

    def ask(
        self,
        packet: bytes | bytearray,
        step: int,
        time: float,
        take: Callable[[int], bool],
        patience: float | None = None,
    ) -> bool:
        """Publishes a state, and waits for the command that follows; see `Link.ask`."""
        assert self._participant is not None
        if patience is None:
            patience = self._declared.patience if self.answered else self._declared.first_patience
        deadline = clock.monotonic() + (_SLICE if self.is_silent else patience)
        self.send(packet)
        again = clock.monotonic() + _REPEATED
        while True:
            self._participant.wait(_SLICE)
            if self._take_any(take):
                self.answered = step
                return True
            self.check(time)
            now = clock.monotonic()
            if now > deadline:
                self.why_silent = self._why_nothing_comes()
                return False
            if not self.answered and now > again:
                self.send(packet)
                again = now + _REPEATED

    def _why_nothing_comes(self) -> str:
        assert self._participant is not None
        published = [(each.topic, each.kind) for each in self._participant.published()]
        wrong = wrong_with(self.name, messages.NUMBERS, published)
        return f": {wrong}" if wrong else ""

    def _take_any(self, take: Callable[[int], object]) -> bool:
        """Passes on what has come, until something is taken."""
        return any([take(self._numbers(raw)) for raw, _ in self._reader.take()])

    def _numbers(self, raw: bytes) -> int:
        """Writes the numbers of a command into the buffer; returns their bytes, 0 for none."""
        try:
            message = messages.decode(raw, messages.NUMBERS)
        except MalformedMessage:
            return 0
        numbers = np.asarray(message.data, "<f8").tobytes()
        if len(numbers) == 8 * self._count:
            self.buffer[: len(numbers)] = numbers
        return len(numbers)

    def send(self, packet: bytes | bytearray) -> bool:
        """Publishes a state, and the time in it."""
        if self._topics.publishes_clock:
            self._clock.write(_CLOCK.pack(_HEAD, *struct.unpack_from("<iI", packet, 4)))
        self._states.write(bytes(packet))
        return True

    def drain(self) -> int:
        """Discards commands that came before; returns how many."""
        return len([*self._reader.take()])

    def receive(self, take: Callable[[int], object]) -> None:
        """Passes on all commands that have come."""
        self._take_any(take)

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        """Likewise until it is a time, s since the start, or a step has been answered."""
        assert self._participant is not None
        due = self._due(time, step)
        while self.answered != step and (left := due - clock.monotonic()) > 0.0:
            self._participant.wait(left)
            self.receive(take)

    def __getstate__(self) -> Any:
        raise TypeError("a participant of a domain is of this process")
