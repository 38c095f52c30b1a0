"""Controller kind `ros2`, with which a ROS 2 node commands a robot via topics of ros2_control.

The simulation publishes `sensor_msgs/JointState` and `/clock`. It receives commands as
`std_msgs/Float64MultiArray`, like the forward controllers, or trajectories as
`trajectory_msgs/JointTrajectory`, like joint_trajectory_controller. The simulation is a DDS
participant and does not need a ROS installation.
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
_REPEATED = 0.1  # s between publications of the first state, which discovery may have missed
_SLICE = 0.02  # s; timeout of one wait for messages
_CLOCK = struct.Struct("<4siI")
_HEAD = b"\0\1\0\0"  # plain CDR, little-endian


class Ros2Node(Answering):
    """A ROS 2 node that publishes commands for each joint state.

    Attributes:
        host: location of the node: `localhost` for this machine, `subnet` to find it by multicast
            as ROS 2 does, or the address of a machine.
        domain: ROS_DOMAIN_ID of the node (default: ROS_DOMAIN_ID of the environment, or 0).
        namespace: prefix of topics that do not begin with `/`.
        joint_states: topic on which the joint state is published.
        commands: topic of `std_msgs/Float64MultiArray` with one number per joint, or of
            `trajectory_msgs/JointTrajectory` (default: the topic of the ros2_control controller for
            the interface, for example `forward_effort_controller/commands`).
        joint_names: joint names in messages (default: the robot's joint names).
        interface: meaning of commands: `effort` for torques, `position` for the target angles of a
            joint impedance controller, or `trajectory` for target trajectories of this controller.
            A trajectory begins at the current target of the previous one, or at the robot's
            position. In lockstep, the simulation waits only for the first trajectory.
        stiffness: stiffness of the joint impedance controller in Nm/rad, as one value for all
            joints or one value per joint.
        damping: damping of the joint impedance controller in Nm s/rad, as one value for all joints
            or one value per joint.
        publishes_clock: whether `/clock` is published, for nodes with use_sim_time.
    """

    title: ClassVar[str] = "ROS 2 node"
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
            raise Problem("port", "is not used by ROS 2. Remove it").error()
        return self

    @property
    def peer(self) -> str:
        domain = "" if self.domain is None else f" {self.domain}"
        return f"the nodes in ROS 2 domain{domain}"

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
    """Encodes the state of a robot as `sensor_msgs/JointState`.

    Attributes:
        time: simulation time of the state in seconds.
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
    """Exchanges messages with a ROS 2 node. If a command is declared, `open` starts it."""

    commands: ClassVar[str] = messages.NUMBERS  # type of the command messages

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
        raise TypeError("a DDS participant cannot be pickled")


class TrajectoryLink(RosLink):
    """Exchanges messages with a ROS 2 node that commands trajectories.

    In each step, the current trajectory provides the target angles and feed-forward torques. The
    torques contain damping times target velocity, so that the impedance controller damps the
    velocity error instead of the velocity.

    Args:
        damping: damping of the joint impedance controller in Nm s/rad, shape (n,).
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
                log.warning("%s at %.3f s: ignored a trajectory: %s", self.name, now, error)
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
