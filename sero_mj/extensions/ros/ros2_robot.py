"""`kind = "ros2"`: a node of ROS 2 holds the simulated robot, by topics as ros2_control has them.

The simulation publishes `sensor_msgs/JointState` and `/clock`, and takes commands in a
`std_msgs/Float64MultiArray` as forward controllers do, or motions in a
`trajectory_msgs/JointTrajectory` as joint_trajectory_controller does. It is a participant of DDS
itself; no ROS is needed here.
"""

from __future__ import annotations

import logging
import struct
import time as clock
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import DeclarationError, Problem, SourceError
from ...base.frames import Array
from ...data.record.joint_state_messages import JointStateMessages, JointStates
from ...simulate.control.controller import MaybePerJoint, Sensed, Target
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.exchange import Answer, modulus_of
from ...simulate.external_control.program import Program
from ...simulate.external_control.program_controller import Answering, Link, ProgramController
from . import messages
from .dds import LOCALHOST, MAX_DOMAIN, Participant, domain_number
from .joint_trajectory import JointTrajectory
from .messages import MalformedMessage
from .ros_source import topic_problem

log = logging.getLogger(__name__)

_TOPICS = {
    "effort": "forward_effort_controller/commands",
    "position": "forward_position_controller/commands",
    "trajectory": "joint_trajectory_controller/joint_trajectory",
}
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
        commands: topic of `std_msgs/Float64MultiArray` with a number for each joint, or of
            `trajectory_msgs/JointTrajectory`; by default that of ros2_control's controller for the
            interface, `forward_effort_controller/commands` say.
        joint_names: of the messages; those of the robot when empty.
        interface: what commands are: `effort`, torques; `position`, angles for springs and dampers
            of the robot; `trajectory`, a motion for these, which begins where the last one is, or
            the robot. In lockstep only the first motion is waited for.
        stiffness: Nm/rad per joint, of these springs.
        damping: Nm s/rad per joint.
        publishes_clock: whether `/clock` is published, for nodes with use_sim_time.
    """

    title: ClassVar[str] = "node of ROS 2"
    order: ClassVar[int] = 85

    kind: Literal["ros2"] = "ros2"
    host: str = LOCALHOST
    domain: int | None = Field(None, ge=0, le=MAX_DOMAIN)
    namespace: str = ""
    joint_states: str = "joint_states"
    commands: str = ""
    joint_names: list[str] = []
    interface: Literal["effort", "position", "trajectory"] = "effort"
    stiffness: MaybePerJoint = None
    damping: MaybePerJoint = None
    publishes_clock: bool = True

    @model_validator(mode="after")
    def _is_reachable(self) -> Self:
        if self.port:
            raise Problem("port", "is not for ROS 2; leave it out").error()
        return self

    @property
    def peer(self) -> str:
        domain = "" if self.domain is None else f" {self.domain}"
        return f"the nodes of ROS 2 domain{domain}"

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        n = model.n
        names = self.joint_names or list(model.joint_names)
        if len(names) != n:
            found = len(names)
            problem = Problem(
                "joint_names", found=found, of="names", expected=f"{n}, one per joint"
            )
            raise problem.error()
        gains = [
            None if getattr(self, gain) is None else self.per_joint(gain, n)
            for gain in ("stiffness", "damping")
        ]
        state = JointStatePacket(names)
        if self.interface == "trajectory":
            answer = Answer(f"< joint_angles:{n}d feed_forward:{n}d", model, *gains)
            link: RosLink = TrajectoryLink(self, model, state, self.per_joint("damping", n))
        else:
            key = "torques" if self.interface == "effort" else "joint_angles"
            answer = Answer(f"< {key}:{n}d", model, *gains)
            link = RosLink(self, model)
        return ProgramController(self, state, answer, model, timestep, link)

    def full(self, topic: str) -> str:
        before = self.namespace.strip("/")
        return topic if topic.startswith("/") else f"/{before}/{topic}" if before else f"/{topic}"


class JointStatePacket:
    """The state of a robot as a message of ROS.

    Attributes:
        time: s since the start.
    """

    modulus = modulus_of(None)

    def __init__(self, names: list[str]) -> None:
        self.names, self.time = names, 0.0
        shapes = dict.fromkeys(_SHAPES, (len(names),))
        self._messages = JointStateMessages(JointStates(names, *_SHAPES), shapes)
        self._table: Array = np.zeros((1, 3 * len(names)))
        self.packet = b""

    def fill(self, step: int, sensed: Sensed, target: Target) -> None:
        self._table[0] = sensed.values.ravel()
        self.time = sensed.time
        (self.packet,) = self._messages.encode(self._table, [round(sensed.time * 1e9)])

    @property
    def angles(self) -> Array:
        return self._table[0, : len(self.names)]


class RosLink(Link):
    """Topics to a node and from it, which is started where that is declared."""

    commands: ClassVar[str] = messages.NUMBERS  # type of messages that command

    def __init__(self, declared: Ros2Node, model: RobotModel) -> None:
        super().__init__(declared, model.name, 8 * model.n)
        self._topics, self._count = declared, model.n
        self._participant: Participant | None = None

    @property
    def name(self) -> str:
        declared = self._topics
        return declared.full(declared.commands or _TOPICS[declared.interface])

    @property
    def is_open(self) -> bool:
        return self._participant is not None

    def open(self, time: float) -> None:
        declared = self._topics
        try:
            self._participant = participant = Participant(
                declared.host, declared.domain, declared.kind
            )
        except SourceError as error:
            raise DeclarationError([Problem("kind", str(error))]) from None
        self._reader = participant.reader(self.name, self.commands)
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
        assert self._participant is not None
        deadline = clock.monotonic() + self._patience(patience)
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
        wrong = topic_problem(self.name, self.commands, published)
        return f": {wrong}" if wrong else ""

    def _take_any(self, take: Callable[[int], object]) -> bool:
        return any([take(self._numbers(raw)) for raw, _ in self._reader.take()])

    def _numbers(self, raw: bytes) -> int:
        try:
            message = messages.decode(raw, messages.NUMBERS)
        except MalformedMessage as error:
            self.why_wrong = str(error)
            return 0
        numbers = np.asarray(message.data, "<f8").tobytes()
        if len(numbers) == 8 * self._count:
            self.buffer[: len(numbers)] = numbers
        else:
            self.why_wrong = f"found {len(message.data)} numbers; expected {self._count}"
        return len(numbers)

    def send(self, packet: bytes | bytearray) -> bool:
        if self._topics.publishes_clock:
            self._clock.write(_CLOCK.pack(_HEAD, *struct.unpack_from("<iI", packet, 4)))
        self._states.write(bytes(packet))
        return True

    def drain(self) -> int:
        return len([*self._reader.take()])

    def receive(self, take: Callable[[int], object]) -> None:
        self._take_any(take)

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        assert self._participant is not None
        due = self._due(time, step)
        while self.answered != step and (left := due - clock.monotonic()) > 0.0:
            self._participant.wait(left)
            self.receive(take)

    def __getstate__(self) -> Any:
        raise TypeError("a participant of a domain is of this process")


class TrajectoryLink(RosLink):
    """Topics to a node that commands motions; each step is answered by the motion in use.

    An answer has the motion's angles, and torques that damp the difference from its velocities
    together with the robot's own dampers.

    Args:
        damping: (n,), Nm s/rad, of the robot's dampers.
    """

    commands: ClassVar[str] = messages.TRAJECTORY

    def __init__(
        self, declared: Ros2Node, model: RobotModel, state: JointStatePacket, damping: Array
    ) -> None:
        super().__init__(declared, model)
        self._state, self._damping = state, damping
        self._motion: JointTrajectory | None = None

    def ask(
        self,
        packet: bytes | bytearray,
        step: int,
        time: float,
        take: Callable[[int], bool],
        patience: float | None = None,
    ) -> bool:
        if self._motion is None:
            return super().ask(packet, step, time, take, patience)
        self.send(packet)
        self._take_any(take)
        self.check(time)
        self.answered = step
        return True

    def _take_any(self, take: Callable[[int], object]) -> bool:
        for raw, _ in self._reader.take():
            self._begin(raw, take)
        if self._motion is None:
            return False
        angles, velocities, efforts = self._motion.at(self._state.time)
        answer = np.concatenate((angles, efforts + self._damping * velocities)).tobytes()
        self.buffer[: len(answer)] = answer
        take(len(answer))
        return True

    def _begin(self, raw: bytes, take: Callable[[int], object]) -> None:
        now = self._state.time
        entry = np.array([self._state.angles, np.zeros(self._count)])
        if self._motion is not None:
            entry = np.array(self._motion.at(now)[:2])
        try:
            message = messages.decode(raw, self.commands)
            self._motion = JointTrajectory(message, self._state.names, now, entry)
        except MalformedMessage as error:
            if self.why_wrong != str(error):
                log.warning("%s at %.3f s: not taken: %s", self.name, now, error)
            self.why_wrong = str(error)
            take(0)

    def drain(self) -> int:
        return 0

    def receive(self, take: Callable[[int], object]) -> None:
        if not self.answered:
            self._take_any(take)

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        if self.answered != step and not self._take_any(take):
            super().receive_until(time, step, take)
