"""Overview of a record without reading its messages; takes less than a second for a file of any size."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition.frame_losses import FrameLosses
from acquisition.record.contents import Contents
from acquisition.record.reader import RecordReader
from processing.ticks import seconds


@dataclass(frozen=True, slots=True)
class RecordInfo:
    """Overview of a record. Times are UTC in ns, 0 without messages.

    `messages` are numbers by topic, `losses` the numbers of lost frames by cause (None if an older record
    does not contain them), `attachments` sizes in bytes by name. `whole` is False for a truncated file;
    `readable_bytes` is then the end of its last complete record. `problems` are parts of the structure that
    cannot be read.
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
        """Time from the first message to the last."""
        return seconds(self.end_ns - self.start_ns)


def record_info(path: Path) -> RecordInfo:
    """Overview of a record, from its summary, or from the headers of its chunks if it is truncated.

    Raises RecordError if the file is not a record of this program (see `RecordReader`).
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
