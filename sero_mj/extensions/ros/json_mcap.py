"""Reads JSON messages of an MCAP file, with the interface of rosbags.

Messages are recognized by their content as joint states in a format of `json_messages`, regardless
of the name of their schema.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel

from ...base.errors import RecordingError, reason_of
from ...base.paths import open_file
from ...data.record.mcap_reader import (
    BROKEN,
    RECORD_HEAD,
    FileIndex,
    read_index,
    read_record,
    records_in,
    unpack_chunk,
    unpack_messages,
)
from .json_messages import joint_state_of
from .messages import JOINT_STATE, TEXT, MalformedMessage

_JSON = "json"
_LATEST_NS = 2**64


@dataclass(frozen=True)
class JsonTopic:
    """A channel of JSON messages.

    Attributes:
        msgtype: ROS type of the messages, or their description if they have no ROS type.
        msgcount: number of messages.
    """

    channel: int
    topic: str
    msgtype: str
    msgcount: int


class JsonMcap:
    """Reads JSON messages. It has the methods of `rosbags.highlevel.AnyReader` that `Bag` uses.

    Attributes:
        start_time: log time of the first message in ns since the epoch.
        end_time: log time after the last message in ns since the epoch.

    Raises:
        OSError: the file cannot be read.
        RecordingError: the file has no JSON messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stack: BinaryIO | None = open_file(path)
        try:
            self._index = _index_of(self.stack)
            self.faults = list(self._index.faults)
            self.connections = self._find_topics()
        except BaseException:
            self.close()
            raise
        chunks = self._index.chunks
        self.start_time = min((chunk.first for chunk in chunks), default=0)
        self.end_time = max((chunk.last for chunk in chunks), default=-1) + 1

    def _find_topics(self) -> list[JsonTopic]:
        found = []
        for number, channel in self._index.channels.items():
            if channel.message_encoding == _JSON:
                first = next((raw for _, raw in self._of(number)), None)
                kind = "JSON without messages" if first is None else _kind_of(first, channel.topic)
                messages = self._index.counts.get(number, 0)
                for chunk in self._index.uncounted:
                    messages += len(self._in_chunk(chunk, number))
                found.append(JsonTopic(number, channel.topic, kind, messages))
        if not found:
            raise RecordingError(self.path, "has no JSON messages")
        return found

    def close(self) -> None:
        if self.stack is not None:
            self.stack.close()
        self.stack = None

    def messages(
        self, connections: Sequence[JsonTopic], start: int | None, stop: int | None
    ) -> Iterator[tuple[JsonTopic, int, bytes]]:
        """Yields the topic, log time and data of messages, ordered by time.

        All times are in ns since the epoch. `start` is inclusive and `stop` is exclusive; None
        stands for no limit.
        """
        first, end = start or 0, _LATEST_NS if stop is None else stop
        # Messages wait until no later chunk can have earlier messages, because chunks overlap.
        waiting: list[tuple[int, int, JsonTopic, bytes]] = []
        number = count()
        for chunk in sorted(self._index.chunks, key=lambda chunk: chunk.first):
            if chunk.last < first or chunk.first >= end:
                continue
            while waiting and waiting[0][0] < chunk.first:
                time, _, topic, raw = heappop(waiting)
                yield topic, time, raw
            for topic in connections:
                for time, raw in self._in_chunk(chunk, topic.channel):
                    if first <= time < end:
                        heappush(waiting, (time, next(number), topic, raw))
        for time, _, topic, raw in sorted(waiting, key=lambda each: each[:2]):
            yield topic, time, raw

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """Decodes a message, whose `kind` is a ROS type that occurs in `connections`."""
        return joint_state_of(raw) if kind == JOINT_STATE else SimpleNamespace(**json.loads(raw))

    def _of(self, channel: int) -> Iterator[tuple[int, bytes]]:
        for chunk in self._index.chunks:
            yield from self._in_chunk(chunk, channel)

    def _in_chunk(self, chunk: Any, channel: int) -> list[tuple[int, bytes]]:
        if self.stack is None or (chunk.channels is not None and channel not in chunk.channels):
            return []
        try:
            record = read_record(self.stack, chunk.offset, chunk.length)
            return unpack_messages(record.getvalue(), channel)
        except BROKEN as error:
            fault = f"the chunk at byte {chunk.offset} is damaged ({reason_of(error)})"
            if fault not in self.faults:
                self.faults.append(fault)
            return []


def _index_of(file: BinaryIO) -> FileIndex:
    index = read_index(file)
    for chunk in [] if index.channels else index.chunks:
        with suppress(*BROKEN):
            _, data = unpack_chunk(read_record(file, chunk.offset, chunk.length).getvalue())
            for opcode, begin, end in records_in(data):
                if opcode == Opcode.CHANNEL:
                    record = io.BytesIO(data[begin + RECORD_HEAD.size : end])
                    channel = Channel.read(ReadDataStream(record))
                    index.channels[channel.id] = channel
    return index


def _kind_of(raw: bytes, topic: str) -> str:
    try:
        joint_state_of(raw)
    except MalformedMessage as error:
        if topic.endswith("/robot_description"):
            with suppress(ValueError, RecursionError, TypeError, KeyError):
                if isinstance(json.loads(raw)["data"], str):
                    return TEXT
        return f"JSON: {error}"
    return JOINT_STATE


def has_json(path: Path) -> bool:
    """Returns whether a file is an MCAP file with JSON messages."""
    with suppress(OSError, RecordingError, *BROKEN), open_file(path) as file:
        channels = _index_of(file).channels.values()
        return any(channel.message_encoding == _JSON for channel in channels)
    return False
