"""The kinds of sources that receive from outside, and what a recording must know of them."""

from __future__ import annotations

from typing import Any

from .fri import FriReceiver
from .receiver import Receiver
from .shm import ShmReader
from .udp import UdpReceiver

LIVE: dict[str, type[Receiver]] = {"udp": UdpReceiver, "shm": ShmReader, "fri": FriReceiver}

# The fields that decide what packets mean; those that say where they come from do not matter.
_DECODING = (
    "is_double", "column_major", "alignment", "scale", "structure", "sequence", "time",
    "time_scale",
)  # fmt: skip


def kind_of(source: Receiver) -> str:
    """The name of the source's kind in files."""
    return next(kind for kind, built in LIVE.items() if type(source) is built)


def decoding_fields(source: Receiver) -> dict[str, Any]:
    """The fields of a source that a replay needs to decode its packets, of JSON's types."""
    fields = source.model_dump(mode="json", include=set(_DECODING), exclude_defaults=True)
    return {key: value for key, value in fields.items() if value != ""}
