"""Base class of everything that provides packets, live or recorded."""

from __future__ import annotations

import socket
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import PrivateAttr

from ...base.declaration import file_fields, kind_of
from ...base.errors import PluginError, Problem, mismatch
from ...base.frames import Array, Ints
from ...base.plugins import SOURCES, load_plugin, plugin_name, plugins
from ...robots.kinematics.joint_tree import JointTree
from .receiving_thread import ReceivingThread
from .reception import Reception

# Events of every source: `receiving` is 1 while packets arrive. `receive_trigger` is 1 in a tick in
# which new packets were applied.
SIGNALS: dict[str, tuple[int, ...]] = {"receiving": (1,), "receive_trigger": (1,)}


class RoutedJoint(NamedTuple):
    """A joint that a source moves.

    Attributes:
        angle: declared position in rad or m.
        torque_limit: maximum torque in Nm or N; infinite if unknown.
    """

    name: str
    angle: float = 0.0
    torque_limit: float = np.inf


@dataclass(frozen=True, eq=False)
class RoutedLinks:
    """The links of a robot that a source of transforms moves.

    Attributes:
        joints: indices of the k independent joints, in the order of `Source.set_joints`.
        positions: function that converts the positions of the k independent joints to the
            positions of all n joints.
        home: declared positions of the k independent joints in rad or m.
        poses: mapping from link names in the robot's original file to the index of the body (0 for
            the base) and `T_body_link` (4, 4) in m.
        base: declared `T_world_base` (4, 4) in m.
    """

    tree: JointTree
    joints: Ints
    positions: Callable[[Array], Array]
    home: Array
    poses: Mapping[str, tuple[int, Array]]
    base: Array


class Source(Reception):
    """Base class of sources, which provide packets of one structure.

    In `open`, a subclass calls `reset`, then `start_receiving` with a function that passes packets
    to `accept`. In `close`, it calls `stop_receiving`.
    """

    _thread: ReceivingThread | None = PrivateAttr(None)

    def __reduce__(self) -> tuple[Callable[..., Source], tuple[type[Source], dict[str, Any]]]:
        """Pickles only the declaration, without received packets and open connections."""
        fields = {key: self.__dict__[key] for key in type(self).model_fields}
        return _declared_again, (type(self), fields)

    @property
    def kind(self) -> str:
        """Value of `kind` in scene files, for example `udp`."""
        return plugin_name(SOURCES, type(self))

    @property
    def original(self) -> Source:
        """Source that decodes the packets. For a recording, this is the recorded source."""
        return self

    @property
    def of_messages(self) -> Source | None:
        """Source that converts messages, for example of ROS, to packets; None without messages."""
        return None

    @property
    def about(self) -> str:
        """Displayed kind and address of the source."""
        return self.name

    @property
    def awaited(self) -> str:
        """Displayed description of the expected packets."""
        message = self.layout.message
        return f"{message}s" if message else f"packets of {self.layout.size} bytes"

    @property
    def place(self) -> tuple[str, int] | None:
        """Address and UDP port on which the source listens; None if it listens on no port."""
        return None

    @property
    def memory(self) -> tuple[str, str, int] | None:
        """Name, lock event (or "") and byte offset of the shared memory; None for other sources."""
        return None

    def message_of(self, packet: bytes) -> bytes:
        """Returns the message that a sender sends for a packet; by default, the packet itself."""
        return packet

    @property
    def can_be_played(self) -> bool:
        """Whether `sero-mj send` can send packets to the source."""
        return self.place is not None or self.memory is not None

    @abstractmethod
    def open(self) -> None:
        """Starts receiving packets; raises SourceError."""

    @abstractmethod
    def close(self) -> None:
        """Stops receiving packets. Has no effect if the source is not open."""

    def start_receiving(
        self,
        receive: Callable[[socket.socket], object],
        interrupt: Callable[[], object] | None = None,
        name: str = "",
    ) -> None:
        """Starts the receiving thread, see `ReceivingThread` for the arguments."""
        self._thread = ReceivingThread(self, name or self.name, receive, interrupt)
        self._thread.start()

    def stop_receiving(self) -> None:
        """Sets `closing` and waits until the receiving thread has ended."""
        if self._thread is not None:
            self.closing.set()
            self._thread.end()
        self._thread = None

    def set_joints(self, joints: Sequence[RoutedJoint]) -> None:
        """Called before `events` is read, with the joints that the source moves, in order.

        These are the joints of the first robot or group with routes from the source. Sources of
        messages that name joints override this method.
        """

    def set_links(self, links: RoutedLinks) -> None:
        """Called before `events` is read, with the links of the first robot that the source moves.

        Sources of transforms override this method.
        """

    def needs_joints(self, event: str) -> bool:
        """Returns whether an event does not exist until `set_joints` is called."""
        return False

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _declared_again(kind: type[Source], fields: Mapping[str, Any]) -> Source:
    return kind(**fields)


def make_source(name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Creates the source that a table of a scene declares; raises DeclarationError.

    A `Source` is returned unchanged.
    """
    if not isinstance(declared, Mapping):
        if isinstance(declared, Source):
            return declared
        raise mismatch(declared, "a table with `kind`, or a source")
    if "name" in declared:
        raise Problem("name", "belongs in the header of the table. Remove it").error()
    try:
        kind = load_plugin(SOURCES, kind_of(declared, plugins(SOURCES)), Source)
    except PluginError as error:
        raise Problem("kind", str(error)).error() from error
    fields = {key: value for key, value in declared.items() if key != "kind"}
    for key in file_fields(kind):
        if isinstance(value := fields.get(key), str) and value:
            fields[key] = Path(value)
    source: Source = kind(**fields, name=name)
    return source
