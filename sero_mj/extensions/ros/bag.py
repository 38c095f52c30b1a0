"""Reads ROS recordings in the formats rosbag2 (MCAP or SQLite) and ROS 1 bag.

Messages of several topics are joined to packets of one source, in the same way as live messages.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

from mcap.writer import MCAP0_MAGIC

from ...base.errors import Problem, RecordingError, UnknownName, first_of
from ...base.paths import BAG_ENDINGS, bag_file_in, bag_files_in, open_file
from ...data.receive.source import RoutedJoint, Source
from ...data.record.formats import mcap_header, open_recording
from ...data.record.mcap_reader import NOT_CLOSED
from ...data.record.recording import PacketFile, RecordedSource
from ...robots.declared.scene import Scene
from .bag_scenes import led_by
from .dds import Ros2
from .described_scene import DESCRIPTION, described_scene, scenes_of_bag, shipped_robots_of
from .joined_packets import FRAMES, TF, JoinedPackets
from .json_mcap import JsonMcap, has_json
from .messages import JOINT_STATE, ODOMETRY, TEXT, MalformedMessage, type_store
from .repaired_bags import RepairedMcap, log_of, with_log
from .ros_source import MAX_REJECTED_BYTES, TYPES, RosSource, is_tf

_ENDINGS = (".bag", ".active", ".db3")  # a bag of ROS 1 is named .bag.active until it is closed
_METADATA = "metadata.yaml"  # file in the folder of a rosbag2
_FILES = ", ".join(f"NAME{ending}" for ending in BAG_ENDINGS)
_SQLITE, _SQLITE_HEAD = b"SQLite format 3\0", 100  # bytes
_ROS1 = b"#ROSBAG V2.0"
_LOOKBACK = 0.5  # s; values at a time are searched for in this interval before it
_DEVICE_PERIOD = 2.0  # s; every device should publish within this time
_LOOKBACK_FACTOR = 8.0  # factor by which the interval grows until values are found
_FIELDS = frozenset(RosSource.model_fields) - {"name", "structure", "only_latest_packet"}
_NEXT = 1e-9  # s, the resolution of times
_MAX_LISTED = 10  # topics in an error message
_MAX_JOINTS = 3  # joints of a topic in an error message
_FIRST_TRANSFORMS = 200  # messages that should include a transform of each publisher


def is_bag(path: Path) -> bool:
    """Returns whether a path has the name of a ROS recording. MCAP files are excluded."""
    return path.suffix.lower() in _ENDINGS or (path / _METADATA).is_file()


def open_bag(
    path: Path,
    topics: Mapping[str, Source] | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> PacketFile | None:
    """Opens a ROS recording, or returns None for other files; see `formats.open_recording`."""
    chosen = {name: each for name, each in (topics or {}).items() if isinstance(each, RosSource)}
    if path.is_dir() and not is_bag(path):
        files = bag_files_in(path)
        if not files:
            raise RecordingError(path, _why_no_bag(path))
        if len(files) == 1:
            return open_recording(files[0], topics, report)
        return Bag(path, chosen, report)
    if is_bag(path) or mcap_header(path)[0] == "ros2":
        return Bag(path, chosen, report)
    return Bag(path, chosen, report, is_json=True) if has_json(path) else None


def _why_no_bag(folder: Path) -> str:
    found = sorted(each for each in folder.iterdir() if each.suffix.lower() in BAG_ENDINGS)
    if not found:
        return f"is a folder without {_METADATA} and without recordings ({_FILES})"
    names = ", ".join(each.name for each in found[:_MAX_LISTED])
    return (
        f"is a folder without {_METADATA}, and its files are not parts of one recording. Open one "
        f"of them: {names}"
    )


def _reader_of_ros(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError as error:
        reason = f"is a ROS recording, which requires rosbags ({error}): "
        raise RecordingError(path, f"{reason}pip install 'sero-mj[ros2]'") from error
    return AnyReader


def _lacks_its_end(file: Path) -> bool:
    if file.suffix.lower() != ".mcap":
        return False
    with open_file(file) as opened:
        magic = opened.read(len(MCAP0_MAGIC))
        opened.seek(-min(file.stat().st_size, len(MCAP0_MAGIC)), os.SEEK_END)
        return magic == MCAP0_MAGIC != opened.read()


def _why_unreadable(path: Path, error: Exception) -> str:
    reason = f"cannot be read: {error or type(error).__name__}"
    with suppress(OSError):
        file = (bag_file_in(path) if path.is_dir() else path) or path
        with open_file(file) as opened:
            begin = opened.read(_SQLITE_HEAD)
        size = file.stat().st_size
        if not begin:
            return f"{file.name} is empty ({NOT_CLOSED})"
        if file.suffix.lower() == ".db3" and begin.startswith(_SQLITE):
            page, pages = int.from_bytes(begin[16:18]), int.from_bytes(begin[28:32])
            whole = (page if page > 1 else 1 << 16) * pages
            hint = "the command .recover of sqlite3 may restore the rest"
            if size < whole:
                missing = f"{whole - size} of {whole} bytes are missing"
                return f"is truncated ({NOT_CLOSED}): {missing}; {hint}"
            return f"{reason}; {hint}" if "malformed" in reason else reason
        is_open = file.suffix.lower() == ".active" or "not indexed" in reason
        if begin.startswith(_ROS1) and is_open:
            hint = f"create it with `rosbag reindex {file}` of ROS 1"
            return f"was not closed ({NOT_CLOSED}), so it has no index; {hint}"
        if begin.startswith(_ROS1) and "damaged" in reason:
            hint = "`rosbag reindex` of ROS 1 may restore the rest"
            return f"is truncated or damaged ({NOT_CLOSED}), so its index cannot be read; {hint}"
    return reason


class Bag(PacketFile):
    """A ROS recording. Times are in seconds since the first message of any topic.

    Args:
        path: file, or folder of a rosbag2.
        topics: mapping from source names to sources with the topics to read. Sources without a
            recorded topic are ignored. By default, each topic of joint states becomes a source
            (`/arm/joint_states` becomes `arm_joint_states`) with the joints in its first messages.

    Raises:
        RecordingError: the recording cannot be read or has no joint states, or a package is
            missing.

    Attributes:
        nameless: topics whose messages contain no joint names. They become sources only if
            `topics` contains them.
    """

    names_joints: ClassVar[bool] = True
    _why_unreadable: ClassVar[str] = "no message has the required joints"

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, RosSource] | None = None,
        report: Callable[[str], None] = lambda _: None,
        *,
        is_json: bool = False,
    ) -> None:
        self.path, self._report, self._is_json = path, report, is_json
        self.about, self.lost, self.faults = {}, {}, []
        self.nameless: list[str] = []
        self._skip_reasons: set[str] = set()  # entries of `faults` about skipped messages
        self._reader: Any = None
        try:
            if is_json:
                self._reader = JsonMcap(path)
                self.faults = self._reader.faults  # grows while messages are read
            else:
                self._open(_reader_of_ros(path))
            self._read_all_but_messages(topics)
        except RecordingError:
            self.close()
            raise
        except Exception as error:  # rosbags, its parsers and decompressors raise many exceptions
            self.close()
            raise RecordingError(path, _why_unreadable(path, error)) from error

    def _open(self, reader: Any) -> None:
        file = bag_file_in(self.path) if self.path.is_dir() else self.path
        if file is None and not is_bag(self.path):
            self._open_parts(reader, bag_files_in(self.path))
            return
        if file is not None and (log := log_of(file)) is not None:
            self._reader = reader([with_log(file, log)], default_typestore=type_store())
            self._reader.open()
            self._report_cut(f"was not closed ({NOT_CLOSED}); messages in {log.name} are included")
            return
        try:
            self._reader = reader([self.path], default_typestore=type_store())
            self._reader.open()
        except Exception:
            if file is None or not _lacks_its_end(file):
                raise
            repaired = RepairedMcap(file)
            *others, cut = repaired.faults
            if not repaired.has_topics:
                reason = f"{cut}; no message before that can be read"
                raise RecordingError(self.path, reason) from None
            self._reader = reader([repaired], default_typestore=type_store())
            self._reader.open()
            self.faults += others
            self._report_cut(cut)

    def _open_parts(self, reader: Any, files: list[Path]) -> None:
        parts: list[Path | RepairedMcap] = []
        cut = ""
        for file in files:
            part = RepairedMcap(file) if _lacks_its_end(file) else file
            if isinstance(part, RepairedMcap):
                *others, cut = (f"{file.name}: {fault}" for fault in part.faults)
                self.faults += others
            if isinstance(part, Path) or part.has_topics:
                parts.append(part)
        self._reader = reader(parts, default_typestore=type_store())
        self._reader.open()
        if cut:
            self._report_cut(cut)

    def _report_cut(self, fault: str) -> None:
        count = self._reader.message_count
        seconds = max(self._reader.duration, 0) * 1e-9 if count else 0.0
        messages = f"{count} message{'' if count == 1 else 's'}"
        self.faults.append(f"{fault}; {messages} of {seconds:.1f} s can be read")

    def _read_all_but_messages(self, topics: Mapping[str, RosSource] | None) -> None:
        reader = self._reader
        self._begin = min(reader.start_time, reader.end_time)
        self.start = datetime.fromtimestamp(self._begin / 1e9, UTC)
        states = [each.topic for each in reader.connections if each.msgtype == JOINT_STATE]
        self._states = list(dict.fromkeys(states))
        self._topics = self._found(topics) if topics else self._named_by_topic()
        self.sources = {name: self._declared(name) for name in self._topics}
        ends = [each.last for each in self.sources.values() if not math.isnan(each.last)]
        self.duration = max(ends, default=0.0)

    def _found(self, topics: Mapping[str, RosSource]) -> dict[str, RosSource]:
        there = {each.topic for each in self._reader.connections}
        found: dict[str, RosSource] = {}
        for name, declared in topics.items():
            source = declared
            wanted = [topic for topic, content in source.topics if content != FRAMES]
            if not there.intersection(wanted or [topic for topic, _ in source.topics]):
                if len(self._states) != 1 or not source.is_default("joint_states"):
                    continue
                source = source.with_fields(joint_states=self._states[0])
            if source.joint_states and not source.joint_names and not is_tf(source.joint_states):
                source = source.with_fields(joints=self._joints_of(source.topics[0][0]))
            found[name] = source
        return found

    def _joints_of(self, topic: str) -> list[str]:
        names: dict[str, None] = {}
        ambiguous: dict[str, None] = {}
        end = math.inf
        for time, connection, raw in self._raw([topic]):
            if time > end:
                break
            with suppress(MalformedMessage):
                found = list(getattr(self._decoded(connection, raw), "name", []))
                is_unique = len(set(found)) == len(found)
                (names if is_unique else ambiguous).update(dict.fromkeys(found))
            if names:
                end = min(end, time + _DEVICE_PERIOD)
        # Messages that name a joint twice are used only if there are no other messages.
        return list(names or ambiguous)

    def _named_by_topic(self) -> dict[str, RosSource]:
        odometry = list(
            dict.fromkeys(e.topic for e in self._reader.connections if e.msgtype == ODOMETRY)
        )
        base = odometry[0] if len(odometry) == 1 else ""
        moves = [(each.topic, each.msgtype) for each in self._reader.connections]
        if not self._states and ("/tf", TYPES[FRAMES]) in moves:
            return {TF: Ros2(name=TF, joint_states=TF, odometry=base or TF)}
        if not self._states and base:
            name = base.strip("/").replace("/", "_")
            return {name: Ros2(name=name, joint_states="", odometry=base)}
        if not self._states:
            kinds = {each.topic: each.msgtype for each in self._reader.connections}
            listed = ", ".join(f"{topic} ({kinds[topic]})" for topic in sorted(kinds)[:_MAX_LISTED])
            expected = f"one of {JOINT_STATE} or {ODOMETRY}, or /tf"
            problem = Problem("", f"has the topics {listed}", expected=expected)
            raise RecordingError(self.path, problem)
        found: dict[str, RosSource] = {}
        for topic in self._states:
            name, names = topic.strip("/").replace("/", "_"), self._joints_of(topic)
            if names:
                source = Ros2(name=name, joint_states=topic, joints=names, odometry=base)
                source.set_joints([RoutedJoint(joint, math.nan) for joint in names])
                found[name] = source
            else:
                self.nameless.append(topic)
        return found

    def _declared(self, name: str) -> RecordedSource:
        source = self._topics[name]
        leading = source.topics[0][0]
        count = sum(each.msgcount for each in self._reader.connections if each.topic == leading)
        first = next(self.packets(name), None) if count else None
        last = self.last_before(name, math.inf) if first else None
        return RecordedSource(
            name,
            source.kind,
            source.decoding_fields(),
            source.events,
            source.size,
            count,
            first[0] if first else math.nan,
            last[0] if last else math.nan,
        )

    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        source = self._source(name)
        joined, contents = source.joined(self._report), dict(source.topics)
        if math.isfinite(start) and start > 0.0:
            self._take_static_transforms(joined, source, start)
        for time, connection, raw in self._raw(list(contents), start - _LOOKBACK, stop):
            packet = self._join(joined, contents[connection.topic], connection, raw, time)
            if packet is not None and time >= start:
                yield time, packet

    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        self._source(name)
        end = (self._reader.end_time - self._begin) * 1e-9
        t, back = min(t, end), _LOOKBACK
        while True:
            newest = deque(self.packets(name, t - back, t + _NEXT), maxlen=1)
            if newest or t - back < 0.0:
                return newest[0] if newest else None
            back *= _LOOKBACK_FACTOR

    def why_no_source(self) -> str:
        if not self.nameless:
            return super().why_no_source()
        return (
            f"the messages of {', '.join(self.nameless)} do not name their joints. Choose a scene "
            "with one robot that has the same number of joints (--replay or --scene)"
        )

    def about_sources(self) -> str:
        found = []
        for name, source in self.sources.items():
            topic = self._topics[name].topics[0][0]
            joints = first_of(source.declared.get("joints") or ["unknown"], _MAX_JOINTS)
            found.append(f"{name} (topic {topic}, {source.count} messages, joints {joints})")
        return "; ".join(found)

    @property
    def attachments(self) -> tuple[str, ...]:
        return (DESCRIPTION,) if self._descriptions() else ()

    def read_attachment(self, name: str) -> bytes:
        topics = self._descriptions()
        if name != DESCRIPTION or not topics:
            raise UnknownName("file in the recording", name, self.attachments)
        for _, message in self._messages(topics):
            return str(message.data).encode()
        raise RecordingError(self.path, f"{topics[0]} has no message")

    def parent_frames(self) -> dict[str, tuple[str, bool]]:
        """Returns a mapping from frames in the first transforms to their parent frames.

        Each value is the name of the parent frame, and whether the transform is from `/tf` and can
        therefore change. Frame names have no prefix.
        """
        found = {}
        for topic in ("/tf_static", "/tf"):
            for _, message in islice(self._messages([topic]), _FIRST_TRANSFORMS):
                for each in message.transforms:
                    names = (each.child_frame_id, each.header.frame_id)
                    child, parent = (name.rpartition("/")[2] for name in names)
                    found[child] = parent, topic == "/tf"
        return found

    def message_source(self, fields: Mapping[str, Any]) -> Ros2:
        return Ros2(**fields)

    def replay_table(self, name: str, source: Source | None) -> dict[str, Any]:
        table = super().replay_table(name, source)
        if isinstance(source, RosSource):
            fields = source.model_dump(include=_FIELDS, exclude_unset=True)
            table["topics"] = {"joint_states": source.joint_states, **fields}
        return table

    def move_robot(self, scene: Scene, source: str | None = None) -> Scene:
        return led_by(scene, self, self.nameless, self._read_parent_frames, source)

    def _read_parent_frames(self) -> dict[str, tuple[str, bool]]:
        with Bag(self.path, is_json=self._is_json) as opened:  # `self` may be closed
            return opened.parent_frames()

    def scenes(
        self, choose: str, source: str | None = None, wanted: Collection[str] = ()
    ) -> Iterator[str]:
        return scenes_of_bag(self, choose, source, wanted)

    def described_scene(self) -> Path | None:
        if DESCRIPTION not in self.attachments:
            return None
        return described_scene(self.read_attachment(DESCRIPTION).decode())

    def shipped_robots(self, source: str | None = None) -> list[str]:
        return shipped_robots_of(self, source)

    def close(self) -> None:
        if self._reader is not None and self._reader.stack is not None:
            self._reader.close()

    def _descriptions(self) -> list[str]:
        return [
            each.topic
            for each in self._reader.connections
            if each.msgtype == TEXT and each.topic.endswith("/robot_description")
        ]

    def _source(self, name: str) -> RosSource:
        if name not in self._topics:
            raise UnknownName("source", name, self._topics)
        return self._topics[name]

    def _raw(
        self, topics: list[str], start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, Any, bytes]]:
        chosen = [each for each in self._reader.connections if each.topic in topics]
        if not chosen:
            return
        first = max(self._begin, self._nanoseconds(start)) if math.isfinite(start) else None
        end = self._nanoseconds(stop) if stop is not None and math.isfinite(stop) else None
        try:
            for connection, when, raw in self._reader.messages(chosen, first, end):
                yield (when - self._begin) * 1e-9, connection, raw
        except Exception as error:  # as in the constructor
            if (fault := f"ends early: {error or type(error).__name__}") not in self.faults:
                self.faults.append(fault)

    def _nanoseconds(self, seconds: float) -> int:
        return int(self._begin + round(seconds * 1e9))

    def _messages(self, topics: list[str]) -> Iterator[tuple[str, Any]]:
        for _, connection, raw in self._raw(topics):
            try:
                yield connection.topic, self._decoded(connection, raw)
            except MalformedMessage as error:
                if (fault := str(error)) not in self.faults:
                    self.faults.append(fault)

    def _decoded(self, connection: Any, raw: bytes) -> Any:
        try:
            return self._reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # as in the constructor
            raise MalformedMessage(f"the message is not a {connection.msgtype}: {error}") from error

    def _take_static_transforms(
        self, joined: JoinedPackets, source: RosSource, until: float
    ) -> None:
        if source.reads_transforms:
            for time, connection, raw in self._raw(["/tf_static"], stop=until):
                self._join(joined, FRAMES, connection, raw, time)

    def _join(
        self, joined: JoinedPackets, content: str, connection: Any, raw: bytes, time: float
    ) -> bytes | None:
        try:
            if connection.msgtype != TYPES[content]:
                raise MalformedMessage(f"{connection.topic} is of type {connection.msgtype}")
            arrival = self._begin * 1e-9 + time
            return joined.take(content, self._decoded(connection, raw), arrival)
        except MalformedMessage as error:
            self.malformed = str(error)
            reason = f"a message of {connection.topic} was skipped: {error}"
            if reason not in self.faults and len(self._skip_reasons) < _MAX_LISTED:
                self._skip_reasons.add(reason)
                self.faults.append(reason)
            return joined.layout.never(raw[:MAX_REJECTED_BYTES])
