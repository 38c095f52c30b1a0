"""`Source`: the common base of UDP, shared memory, FRI, recordings and runs.

A source reads outside the render thread.
"""

from __future__ import annotations

import socket
from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr

from ...base.declaration import file_fields, kind_of
from ...base.errors import (
    PluginError,
    Problem,
    mismatch,
)
from ...base.plugins import SOURCES, load_plugin, plugin_name, plugins
from .led_robot import LeadsRobot
from .receiving_thread import ReceivingThread
from .reception import Reception

# Events of every source that are independent of packets: 1 while packets arrive, else 0; and 1 in a
# tick in which new ones were applied, else 0.
SIGNALS: dict[str, tuple[int, ...]] = {"receiving": (1,), "receive_trigger": (1,)}


class Source(Reception, LeadsRobot):
    """A source of packets of one structure; also the base of sources in other packages.

    In `open`, a subclass calls `reset`, then `start_receiving` with a function that passes packets
    to `accept`. In `close`, it calls `stop_receiving`.
    """

    _thread: ReceivingThread | None = PrivateAttr(None)

    def __reduce__(self) -> tuple[Callable[..., Source], tuple[type[Source], dict[str, Any]]]:
        """Pickles the declaration only, not what it has received or opened."""
        fields = {key: self.__dict__[key] for key in type(self).model_fields}
        return _declared_again, (type(self), fields)

    @property
    def kind(self) -> str:
        """The name of its kind in files."""
        return plugin_name(SOURCES, type(self))

    @property
    def original(self) -> Source:
        """The source that receives the packets; for a recording, the recorded source."""
        return self

    @property
    def of_messages(self) -> Source | None:
        """The receiver that makes the same packets of recorded messages; None for packets."""
        return None

    @property
    def about(self) -> str:
        """Kind and address, as shown to the user."""
        return self.name

    @property
    def awaited(self) -> str:
        """What it waits for, as shown to the user."""
        message = self.layout.message
        return f"{message}s" if message else f"packets of {self.layout.size} bytes"

    @property
    def place(self) -> tuple[str, int] | None:
        """Address and port it listens on, which no two sources can share; None for no port."""
        return None

    @property
    def memory(self) -> tuple[str, str, int] | None:
        """Name of the shared memory it reads, event that locks it (or ""), and offset in bytes."""
        return None

    def message_of(self, packet: bytes) -> bytes:
        """What senders send for a packet: the packet itself, or the message that makes it."""
        return packet

    @property
    def can_be_played(self) -> bool:
        """Whether `sero-mj send` can send what it receives."""
        return self.place is not None or self.memory is not None

    @property
    def trouble(self) -> str:
        """Why no packets arrive, as shown to the user; empty when unknown."""
        return self._trouble

    @abstractmethod
    def open(self) -> None:
        """Starts receiving; raises SourceError."""

    @abstractmethod
    def close(self) -> None:
        """Stops receiving; harmless when it is not open."""

    def start_receiving(
        self,
        receive: Callable[[socket.socket], object],
        interrupt: Callable[[], object] | None = None,
        name: str = "",
    ) -> None:
        """Starts the thread that receives, and receives again after every failure.

        Args:
            receive: receives packets until `closing` is set; its argument becomes readable then.
                It may raise `Disconnected`, whose text becomes the source's `trouble`; any other
                exception becomes its `error`.
            interrupt: called by `stop_receiving`, for a `receive` that waits for something else.
            name: of the thread; the source's name when empty.
        """
        self._thread = ReceivingThread(self, name or self.name, receive, interrupt)
        self._thread.start()

    def stop_receiving(self) -> None:
        """Sets `closing`, and waits until the thread has ended; harmless without one."""
        if self._thread is not None:
            self.closing.set()
            self._thread.end()
        self._thread = None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _declared_again(kind: type[Source], fields: Mapping[str, Any]) -> Source:
    return kind(**fields)


def make_source(name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Builds a source from a scene's table; a source object is returned unchanged.

    Args:
        name: the source's name in routes.
        declared: its fields, with `kind`.

    Raises:
        DeclarationError: no such kind, one that cannot be loaded, or wrong fields.
    """
    if not isinstance(declared, Mapping):
        if isinstance(declared, Source):
            return declared
        raise mismatch(declared, "a table with kind, or a source")
    if "name" in declared:
        raise Problem("name", "belongs in the header; leave it out").error()
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
