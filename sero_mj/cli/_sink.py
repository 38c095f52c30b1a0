"""Where `sero-mj send` and `simulate --send` put packets."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import UsageError

if TYPE_CHECKING:
    from ..receive.source import Source
    from ..receive.structure import Structure
    from ..send.sender import ShmWriter, UdpSink


def goes_to_shm(options: argparse.Namespace, source: Source) -> bool:
    """Whether packets go to shared memory: by `--shm`, or for a source that reads it."""
    from ..receive.shm import ShmReader

    return options.shm is not None or (isinstance(source, ShmReader) and options.port is None)


def make_sink(
    options: argparse.Namespace, source: Source, structure: Structure
) -> UdpSink | ShmWriter:
    """Where the packets go: what the command line says, else where the source receives.

    Args:
        options: `host`, `port` and `shm`.
        source: that receives the packets.
        structure: of the packets.

    Raises:
        UsageError: neither says where.
        SourceError: the address cannot be resolved, or the memory not be written.
    """
    from ..receive.shm import ShmReader
    from ..receive.udp import UdpReceiver
    from ..send.sender import ShmWriter, UdpSink

    if goes_to_shm(options, source):
        if not isinstance(source, ShmReader):
            return ShmWriter(options.shm, structure)
        if options.host is not None:
            raise UsageError(f"source '{source.name}' is {source.about}; --host needs --port")
        lock = source.lock if source.lock in structure.events else ""
        return ShmWriter(options.shm or source.block, structure, lock, source.offset)
    port = options.port or (source.udpport if isinstance(source, UdpReceiver) else 0)
    if not port and not source.is_live:
        reason = "is a recording, to which nothing can be sent; give --port, and --host"
        raise UsageError(f"source '{source.name}' of the scene {reason}")
    if not port:
        raise UsageError(f"source '{source.name}' of the scene has no port; give --port")
    return UdpSink(options.host or "127.0.0.1", port)
