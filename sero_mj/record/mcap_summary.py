"""What stands behind the data of an MCAP file: the summary with its index, and the ending."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from struct import pack

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, Statistics, SummaryOffset
from mcap.writer import MCAP0_MAGIC

from .mcap_chunk import SealedChunk

# The groups of the summary, in the order in which they are written.
_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


def pack_record(record: McapRecord) -> bytes:
    """Returns a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def summary_crc(summary: bytes | bytearray, footer: Footer) -> int:
    """Returns the check sum of a summary, which goes over the footer's first fields as well."""
    head = pack("<BQQQ", Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
    return zlib.crc32(head, zlib.crc32(summary))


# The ending of a file without a summary.
SHORT_ENDING = pack_record(DataEnd(0)) + pack_record(Footer(0, 0, 0)) + MCAP0_MAGIC


@dataclass(frozen=True)
class Totals:
    """What the chunks in the file hold together.

    Attributes:
        chunks: how many there are.
        index_bytes: how long their index records are.
        first: log time of the earliest message, ns.
        last: log time of the latest message, ns.
        counts: channel to its number of messages.
    """

    chunks: int = 0
    index_bytes: int = 0
    first: int = 0
    last: int = 0
    counts: Mapping[int, int] = field(default_factory=dict)

    @property
    def messages(self) -> int:
        """Messages of all channels."""
        return sum(self.counts.values())

    def plus(self, chunk: SealedChunk) -> Totals:
        """These and one more chunk."""
        channels = sorted({*self.counts, *chunk.counts})
        return Totals(
            self.chunks + 1,
            self.index_bytes + len(chunk.index),
            min(chunk.first, self.first) if self.chunks else chunk.first,
            max(chunk.last, self.last),
            {c: self.counts.get(c, 0) + chunk.counts.get(c, 0) for c in channels},
        )


class Summary:
    """The summary of a file that grows.

    Attributes:
        totals: what the chunks hold together.
    """

    def __init__(self) -> None:
        self.totals = Totals()
        # Packed at once: a day of chunks is 20 MB so, and ten times as much as objects.
        self._records = {group: bytearray() for group in _GROUPS}
        self._counts = dict.fromkeys(_GROUPS, 0)

    def count(self, group: Opcode) -> int:
        """How many records a group has."""
        return self._counts[group]

    def add(self, group: Opcode, record: bytes) -> None:
        """Adds a record to a group."""
        self._records[group] += record
        self._counts[group] += 1

    def add_chunk(self, chunk: SealedChunk) -> None:
        """Counts a chunk that is in the file."""
        self._records[Opcode.CHUNK_INDEX] += chunk.index
        self.totals = self.totals.plus(chunk)

    def drop_last_chunk(self, before: Totals) -> None:
        """Forgets the last chunk; `before` are the totals before it was added."""
        del self._records[Opcode.CHUNK_INDEX][before.index_bytes :]
        self.totals = before

    def ending(self, offset: int) -> bytes:
        """Returns all that stands behind the last record of the data section.

        Args:
            offset: where in the file it will stand.
        """
        totals = self.totals
        self._records[Opcode.STATISTICS][:] = pack_record(
            Statistics(
                attachment_count=self.count(Opcode.ATTACHMENT_INDEX),
                channel_count=self.count(Opcode.CHANNEL),
                channel_message_counts=dict(totals.counts),
                chunk_count=totals.chunks,
                message_count=totals.messages,
                message_end_time=totals.last,
                message_start_time=totals.first,
                metadata_count=self.count(Opcode.METADATA_INDEX),
                schema_count=self.count(Opcode.SCHEMA),
            )
        )
        data_end = pack_record(DataEnd(0))
        start = offset + len(data_end)
        summary = bytearray()
        offsets = b""
        for group, records in self._records.items():
            if records:
                place = start + len(summary)
                offsets += pack_record(SummaryOffset(group, place, len(records)))
                summary += records
        footer = Footer(start, start + len(summary), 0)
        summary += offsets
        footer = replace(footer, summary_crc=summary_crc(summary, footer))
        return data_end + summary + pack_record(footer) + MCAP0_MAGIC
