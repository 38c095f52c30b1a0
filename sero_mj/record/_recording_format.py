"""What makes an MCAP file a recording of ours: topics, metadata, and the two clocks.

    metadata `sero-mj`    format, version, started, start_epoch_ns, start_monotonic_ns
    metadata `about`      what the recording is of: scene, robot, ...
    metadata `lost`       source to the number of packets that could not be kept, where there are
    channel /NAME/raw     a source's packets, byte for byte; its metadata says how to decode them
    channel /NAME/signals what the good ones of them mean, as JSON (see `signals_json`); its
                          metadata says of every name where its number comes from
    attachments           the scene file and its robots' files

A message's log time is when the packet arrived, in ns since the epoch. That clock is the monotonic
one, moved once, when the recording began: it never jumps, and differences are exact to the ns.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__

FORMAT = 1
ABOUT, CLOCK, LOST = "about", "sero-mj", "lost"
SOURCE_KEY = "sero-mj"  # in the metadata of a raw channel
RAW_ENCODING = "application/octet-stream"
SIGNALS_ENCODING, SCHEMA_ENCODING = "json", "jsonschema"
_MOST_NS = 2**64 - 1


def raw_topic(name: str) -> str:
    """The topic of a source's packets."""
    return f"/{name}/raw"


def signals_topic(name: str) -> str:
    """The topic of a source's decoded packets."""
    return f"/{name}/signals"


@dataclass(frozen=True)
class RecordingClock:
    """When a recording began, on both clocks.

    Attributes:
        epoch_ns: ns since the epoch, UTC.
        monotonic_ns: ns on the clock of `time.monotonic`.
    """

    epoch_ns: int = field(default_factory=time.time_ns)
    monotonic_ns: int = field(default_factory=time.monotonic_ns)

    def log_time(self, arrival: float) -> int:
        """Returns the log time, ns since the epoch, of an arrival in s on `time.monotonic`.

        Raises:
            ValueError: it is not a time that a file can hold.
        """
        if not math.isfinite(arrival):
            raise ValueError(f"arrival: found {arrival}; expected seconds on time.monotonic")
        log_time = round(arrival * 1e9) - self.monotonic_ns + self.epoch_ns
        if not 0 <= log_time <= _MOST_NS:
            raise ValueError(f"arrival: found {arrival}, which is before 1970 or after 2554")
        return log_time

    def log_times(self, arrivals: NDArray[np.float64]) -> NDArray[np.uint64]:
        """The same for many arrivals, (n,).

        Raises:
            ValueError: one is not a time that a file can hold.
        """
        if len(arrivals):
            for end in (np.min(arrivals), np.max(arrivals)):  # NaN is both
                self.log_time(float(end))
        times = np.rint(arrivals * 1e9).astype(np.int64) - self.monotonic_ns + self.epoch_ns
        return np.asarray(times.astype(np.uint64))

    def to_metadata(self) -> dict[str, str]:
        """As the metadata record that every recording has."""
        started = datetime.fromtimestamp(self.epoch_ns / 1e9, UTC)
        return {
            "format": str(FORMAT),
            "version": __version__,
            "started": started.isoformat(timespec="milliseconds"),
            "start_epoch_ns": str(self.epoch_ns),
            "start_monotonic_ns": str(self.monotonic_ns),
        }

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> RecordingClock:
        """Reads it from the metadata record; raises KeyError or ValueError."""
        return cls(int(metadata["start_epoch_ns"]), int(metadata["start_monotonic_ns"]))


@dataclass(frozen=True)
class SourceDeclaration:
    """How a source's packets are to be decoded, as a raw channel's metadata carries it.

    Attributes:
        name: the source's name in routes.
        kind: its kind, e.g. `udp`.
        declared: its fields in the scene, of JSON's types.
        events: event name to its shape.
        size: bytes of a packet.
    """

    name: str
    kind: str
    declared: Mapping[str, Any]
    events: Mapping[str, tuple[int, ...]]
    size: int

    def to_json(self) -> str:
        """As JSON; raises TypeError for a field that is not of JSON's types."""
        events = {event: list(shape) for event, shape in self.events.items()}
        return json.dumps(
            {
                "name": self.name,
                "kind": self.kind,
                "declared": dict(self.declared),
                "events": events,
                "size": self.size,
            }
        )

    @classmethod
    def from_json(cls, text: str) -> SourceDeclaration:
        """Reads it from JSON; raises KeyError, TypeError, AttributeError or ValueError."""
        found = json.loads(text)
        events = {str(event): tuple(map(int, shape)) for event, shape in found["events"].items()}
        return cls(
            str(found["name"]),
            str(found["kind"]),
            dict(found["declared"]),
            events,
            int(found["size"]),
        )
