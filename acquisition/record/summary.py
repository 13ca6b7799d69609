"""The ending of a finished MCAP file: copies of its descriptions, where its parts are, and statistics.

It is collected while the file is written. The mcap library serialises the small records.
"""

import struct
import zlib
from collections import Counter
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.records import MAGIC

_UINT32 = 0xFFFFFFFF


class Summary:
    """What was written to a file so far, and where.

    `chunk_index` holds the entries of the chunks already serialised: about 100 bytes per chunk, a tenth of
    the memory of objects, which matters for records of days. `end_ns` is the latest log time of all chunks.
    """

    def __init__(self) -> None:
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self.chunk_index = bytearray()
        self.end_ns = 0
        self._start_ns = 0
        self._chunks = 0
        self._counts: Counter[int] = Counter()
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []

    def add_metadata(self, place: int, length: int, name: str) -> None:
        """Note a record of metadata at a place of the file, both in bytes."""
        self._metadata.append(MetadataIndex(place, length, name))

    def add_attachment(self, place: int, length: int, attachment: Attachment) -> None:
        """Note an attachment, whose record has this length in bytes."""
        self._attachments.append(
            AttachmentIndex(
                place,
                length,
                attachment.create_time,
                attachment.log_time,
                len(attachment.data),
                attachment.name,
                attachment.media_type,
            )
        )

    def add_chunk(
        self,
        builder: ChunkBuilder,
        place: int,
        length: int,
        compressed_bytes: int,
        indexes: dict[int, int],
        index_bytes: int,
    ) -> None:
        """Note a chunk of this length, and the places of the message indexes behind it by channel."""
        self._start_ns = min(self._start_ns, builder.start_ns) if self._chunks else builder.start_ns
        self.end_ns = max(self.end_ns, builder.end_ns)
        self._chunks += 1
        self._counts.update(builder.counts)
        self.chunk_index += serialised(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=place,
                compression="zstd",
                compressed_size=compressed_bytes,
                message_end_time=builder.end_ns,
                message_index_length=index_bytes,
                message_index_offsets=indexes,
                message_start_time=builder.start_ns,
                uncompressed_size=len(builder.data),
            )
        )

    def ending(self, place: int, crc: int) -> bytes:
        """DataEnd, summary, footer and magic of a file that is `place` bytes long and has this checksum."""
        data_end = serialised(DataEnd(crc))
        start = place + len(data_end)
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, b"".join(serialised(schema) for schema in self.schemas)),
            (Opcode.CHANNEL, b"".join(serialised(channel) for channel in self.channels)),
            (Opcode.STATISTICS, serialised(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self.chunk_index)),
            (Opcode.ATTACHMENT_INDEX, b"".join(serialised(entry) for entry in self._attachments)),
            (Opcode.METADATA_INDEX, b"".join(serialised(entry) for entry in self._metadata)),
        ]
        place = start
        offsets: list[SummaryOffset] = []
        for opcode, group in groups:
            if group:
                offsets.append(SummaryOffset(opcode, place, len(group)))
                place += len(group)
        summary = b"".join([*(group for _, group in groups), *(serialised(offset) for offset in offsets)])
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, place)
        footer = Footer(start, place, zlib.crc32(head, zlib.crc32(summary)) & _UINT32)
        return data_end + summary + serialised(footer) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=self.end_ns,
            message_start_time=self._start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self.schemas),
        )


def shortest_ending(crc: int) -> bytes:
    """DataEnd, an empty footer and magic, for a disk without space for more."""
    return serialised(DataEnd(crc)) + serialised(Footer(0, 0, 0)) + MAGIC


def serialised(record: Any) -> bytes:
    """Bytes of a record of the mcap library."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
