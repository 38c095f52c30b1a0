"""Source that plays a recording and reproduces the received packets exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import PrivateAttr, ValidationInfo, field_validator

from ...base.errors import DeclarationError, PluginError, RecordingError, did_you_mean, mismatch
from ...base.plugins import SOURCES, load_plugin, plugins
from ..receive.source import RoutedJoint, RoutedLinks, Source
from .csv_files import is_table
from .file_source import FileSource
from .formats import look_into, open_recording
from .recording import PacketFile, RecordedSource

_FILE_KINDS = ("replay", "table")  # kinds that play files, which recordings must not declare


class Replay(FileSource):
    """Plays the packets of one source in a recording, and decodes them like the recorded source.

    Attributes:
        source: name of the recorded source (default: the source with the same name as this source,
            or the only source).
        topics: topics to read from a ROS recording, with the keys of a source of kind `ros2`
            (`joint_states`, `joints`, `commands`, `wrench`, `frames`, ...).
    """

    name: str = "replay"
    topics: dict[str, Any] = {}
    source: str = ""

    _structure_is: ClassVar[str] = "declared in the recording"

    _of_messages: Source | None = PrivateAttr(None)

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: Path) -> Path:
        if is_table(file):
            raise ValueError(f'{file} is a table; expected a recording. Set kind = "table"')
        try:
            look_into(file)
        except RecordingError as error:
            raise ValueError(str(error)) from None
        return file

    @field_validator("topics")
    @classmethod
    def _check_topics(cls, topics: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if topics and "file" in info.data:
            wanted = _message_source(info.data["file"], topics)
            if wanted is None:
                raise ValueError("topics are only for recordings of messages. Remove them")
            if not look_into(info.data["file"], {"": wanted}).sources:
                raise ValueError(f"{info.data['file']} has none of these topics")
        return topics

    @field_validator("source")
    @classmethod
    def _check_source(cls, source: str, info: ValidationInfo) -> str:
        if "file" not in info.data or "topics" not in info.data:
            return source
        topics, name = info.data["topics"], str(info.data.get("name"))
        receiver = _message_source(info.data["file"], topics) if topics else None
        wanted = None if receiver is None else {source or name: receiver}
        recording = look_into(info.data["file"], wanted)
        chosen = recording.choose_source(source, name, 'source = "NAME"')
        try:
            receiver_of(recording.path, recording.sources[chosen], chosen)
        except RecordingError as error:
            raise ValueError(str(error)) from None
        return chosen

    @field_validator("start")
    @classmethod
    def _check_start(cls, start: float | None, info: ValidationInfo) -> float | None:
        if start is not None and "file" in info.data:
            check_start(start, look_into(info.data["file"]))
        return start

    @field_validator("stop")
    @classmethod
    def _check_stop(cls, stop: float | None, info: ValidationInfo) -> float | None:
        if stop is None or "file" not in info.data or "start" not in info.data:
            return stop
        if info.data["start"] is not None:
            begin, word = info.data["start"], "start"
        else:
            begin, word = _first_of(look_into(info.data["file"])), "the time of its first packet"
        if not begin < stop < np.inf:
            raise mismatch(stop, f"more than {begin:g} s, {word}")
        return stop

    def set_joints(self, joints: Sequence[RoutedJoint]) -> None:
        if joints and (source := self._messages_of_source(by_joints=True)) is not None:
            self._of_messages = source
            source.set_joints(joints)
            self._forget_original()

    def set_links(self, links: RoutedLinks) -> None:
        source = self._of_messages or self._messages_of_source(by_joints=False)
        if source is not None:
            self._of_messages = source
            source.set_links(links)
            self._forget_original()

    def _messages_of_source(self, *, by_joints: bool) -> Source | None:
        recording = look_into(self.file, self._wanted)
        declared = {**recording.sources[self.source].declared}
        if by_joints and "joints" not in self.topics:
            declared.pop("joints", None)
        return recording.message_source({**declared, **self.topics})

    def _forget_original(self) -> None:
        for key in ("recorded", "original", "layout"):
            self.__dict__.pop(key, None)

    @property
    def of_messages(self) -> Source | None:
        return self._of_messages

    @property
    def _wanted(self) -> Mapping[str, Source] | None:
        if self._of_messages is None and self.topics:
            self._of_messages = _message_source(self.file, self.topics)
        return None if self._of_messages is None else {self.source: self._of_messages}

    @cached_property
    def recorded(self) -> RecordedSource:
        return look_into(self.file, self._wanted).sources[self.source]

    @cached_property
    def original(self) -> Source:
        receiver = receiver_of(self.file, self.recorded, self.name)
        receiver.only_latest_packet = self.only_latest_packet
        return receiver

    @cached_property
    def _begin(self) -> float:
        if self.start is not None:
            return self.start
        return _first_of(look_into(self.file, self._wanted))

    def open_recording(self) -> PacketFile:
        return open_recording(self.file, self._wanted, self.log_once)


def _message_source(file: Path, topics: Mapping[str, Any]) -> Source | None:
    return look_into(file).message_source(topics)


def receiver_of(file: Path, recorded: RecordedSource, name: str) -> Source:
    """Creates the source that a recording declares for decoding; raises RecordingError."""
    kind, of = recorded.kind, f"source '{recorded.name}'"
    kinds = [known for known in plugins(SOURCES) if known not in _FILE_KINDS]
    if kind not in kinds:
        raise RecordingError(file, f"{of}: no kind '{kind}'{did_you_mean(kind, kinds)}")
    try:
        receiver: Source = load_plugin(SOURCES, kind)(**{**recorded.declared, "name": name})
    except PluginError as error:
        raise RecordingError(file, str(error)) from error
    except DeclarationError as error:
        wrong = "; ".join(f"{problem.key}: {problem.message}" for problem in error.problems)
        raise RecordingError(file, f"declaration of {of}: {wrong}") from error
    for event, shape in recorded.events.items():
        if receiver.events.get(event) != shape:
            expected = receiver.events.get(event, "no event of this name")
            reason = f"events of {of}: found {event} with shape {shape}; expected {expected}"
            raise RecordingError(file, reason)
    return receiver


def _first_of(recording: PacketFile) -> float:
    firsts = [each.first for each in recording.sources.values()]
    return min((first for first in firsts if not np.isnan(first)), default=0.0)


def check_start(start: float, recording: PacketFile) -> None:
    """Raises ValueError if a recording ends before the time `start` in seconds."""
    if not start <= recording.duration:
        raise ValueError(f"found {start:g}; the recording ends at {recording.duration:.2f} s")
