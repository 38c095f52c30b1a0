"""Recordings for tests."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory

from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recording_writer import RecordingWriter

EVENTS = {"values0": (2,), "vectors0": (1, 3), "matrices0": (1, 4, 4)}
DECLARED = {"port": 32000, "structure": "2F1V1M", "double": True}
LAYOUT = Structure("2F1V1M")
# A scene that replays a recording of `moving` packets. `file` is the path of the recording, and
# `more` contains further declarations.
SCENE = """
[robots.two]
dh_convention = "craig"
dh_params = [[0, 0.3, 0, 0], [0, 0.3, 0, 0]]

[sources.arm]
kind = "replay"
file = "{file}"
{more}

[routes]
"two.joint_angles" = "arm.values0"
"""


def begin(path: Path, *names: str, chunk_bytes: int = 1 << 20) -> RecordingWriter:
    writer = RecordingWriter(
        path, about={"scene": "two arms"}, overwrite=True, chunk_bytes=chunk_bytes
    )
    for name in names:
        writer.add_source(name, kind="udp", declared=DECLARED, events=EVENTS, size=168)
    return writer


def record(
    path: Path, packets: Sequence[bytes], *, chunk_bytes: int = 1 << 20, close: bool = True
) -> list[tuple[float, bytes]]:
    """Records packets 0.1 s apart and returns the expected result of `packets`."""
    live = path.with_suffix(".live")
    writer = begin(live, "arm", chunk_bytes=chunk_bytes)
    start = writer.clock.monotonic_ns
    for i, packet in enumerate(packets):
        writer.write_raw("arm", packet, (start + i * 100_000_000) / 1e9)
    writer.flush()
    if not close:  # as after a kill of the recording process
        copy(live, path)
    writer.close()
    if close:
        live.rename(path)
    log_times = [
        writer.clock.log_time((start + i * 100_000_000) / 1e9) for i in range(len(packets))
    ]
    times = [(log_time - writer.clock.epoch_ns) / 1e9 for log_time in log_times]
    return list(zip(times, packets, strict=True))


def numbered(count: int) -> list[bytes]:
    return [struct.pack("<I", i) * 8 for i in range(count)]


def moving(count: int) -> list[bytes]:
    """Returns packets in which the first joint rotates by 0.1 rad each."""
    return [
        LAYOUT.encode({"values0": [k / 10, 0], "vectors0": [[k, 0, 1]], "matrices0": np.eye(4)})
        for k in range(count)
    ]


def signals_in(path: Path, topic: str) -> tuple[Channel, Schema, dict[int, dict[str, Any]]]:
    """Returns a ROS channel, its schema, and its messages by number, decoded by a ROS package."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages(topics=[topic]))
    schema, channel, *_ = found[0]
    assert schema is not None and (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
    return channel, schema, {each.sequence: _plain(message) for _, _, each, message in found}


def _plain(value: Any) -> Any:
    if hasattr(value, "__slots__"):
        return {name: _plain(getattr(value, name)) for name in value.__slots__}
    return value if isinstance(value, float) else [_plain(each) for each in value]
