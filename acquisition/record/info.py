"""What is in a record, without reading the messages: within a second however large the file is."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition.frame_losses import FrameLosses
from acquisition.record.contents import Contents
from acquisition.record.reader import RecordReader


@dataclass(frozen=True, slots=True)
class RecordInfo:
    """A record as its index describes it. Times are UTC in ns, 0 without messages.

    `messages` counts by topic, `losses` are the frames that are missing by who lost them (None where an
    older record does not say), `attachments` are sizes in bytes by name. `whole` is false for a file that
    was cut short; `readable_bytes` then is how far its complete records go.
    """

    path: Path
    size_bytes: int
    readable_bytes: int
    whole: bool
    library: str
    schema_version: int
    start_ns: int
    end_ns: int
    chunks: int
    messages: Mapping[str, int]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, int]
    losses: FrameLosses | None
    problems: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """From the first message to the last."""
        return (self.end_ns - self.start_ns) * 1e-9


def record_info(path: Path) -> RecordInfo:
    """List a record from its summary; a cut file from the heads of its chunks.

    Raises RecordError where the file is no record of ours (see `RecordReader`).
    """
    with RecordReader(path) as reader:
        contents: Contents = reader.contents
        return RecordInfo(
            path=path,
            size_bytes=contents.size,
            readable_bytes=contents.readable_bytes,
            whole=contents.whole,
            library=contents.library,
            schema_version=int(reader.metadata["record"]["schema_version"]),
            start_ns=contents.start_ns,
            end_ns=contents.end_ns,
            chunks=contents.chunk_count,
            messages=reader.counts,
            metadata=reader.metadata,
            attachments=dict(contents.attachments),
            losses=reader.losses(),
            problems=tuple(contents.damage),
        )
