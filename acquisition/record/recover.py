"""Recovery of a truncated or damaged record into a new, complete file."""

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.atomic_write import being_written
from acquisition.record import pixels_beside
from acquisition.record.chunk import Damage
from acquisition.record.digest import sha256_of
from acquisition.record.mcap_file import McapFile
from acquisition.record.read_file import ReadFile
from acquisition.record.reader import RecordReader
from acquisition.record.topics import PIXEL_TOPICS, number_topics
from processing.errors import RecordError

RECOVERY = "recovery"
"""Name of the metadata about a recovery by `rig record recover`; those of a second one are "recovery 2"."""
_RESERVE_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of `recover`.

    `messages` are the numbers of recovered messages by topic, `start_ns` and `end_ns` (UTC) the times of the
    first and the last. `lost` are the damaged parts, `lost_bytes` is the number of bytes after the last
    complete entry.
    """

    source: Path
    path: Path
    messages: Mapping[str, int]
    start_ns: int
    end_ns: int
    lost: tuple[Damage, ...]
    lost_bytes: int


def recover(source: Path, path: Path) -> Recovery:
    """Copy every intact message of a record, its metadata and attachments into new files.

    The source is not changed. The metadata `RECOVERY` of the new record state its source and what is missing;
    those of an earlier recovery stay. The new files appear after they were read back and checked.

    Raises
    ------
    RecordError
        The source is not a record of this program; the new file exists already or cannot be written.
    """
    pixels = pixels_beside(path)
    try:
        with contextlib.ExitStack() as stack:
            reader = stack.enter_context(RecordReader(source))
            names = [stack.enter_context(being_written(name)) for name in (path, pixels)[: len(reader.files)]]
            counts: Counter[str] = Counter()
            copies: list[McapFile] = []
            topics = (number_topics(reader.deflection_unit), PIXEL_TOPICS)
            for file, name, file_topics in zip(reader.files, names, topics, strict=False):
                copy = McapFile(name, file_topics, _RESERVE_BYTES)
                # Windows removes only closed files
                stack.callback(copy.abandon)
                counts += _copy_messages(file, copy)
                copies.append(copy)
            found = _copy_metadata(reader, copies, path, counts)
            for copy in copies:
                copy.finish()
                if copy.disk.full is not None:
                    raise copy.disk.full
            _verify(names, counts, path, source)
    except FileExistsError as error:
        raise RecordError(
            f"{error.filename}: exists already and is never overwritten; choose another name"
        ) from None
    except OSError as error:
        why = f"{path}: cannot be written: {error.strerror or error}; {source} is unchanged"
        raise RecordError(why) from error
    return found


def _copy_messages(file: ReadFile, copy: McapFile) -> Counter[str]:
    """Copy all intact messages; returns how many, by topic."""
    counts: Counter[str] = Counter()
    for place in file.chunks:
        for message in file.messages(place):
            copy.add(*message)
            counts[message.topic] += 1
        if copy.disk.full is not None:
            raise copy.disk.full
    return counts


def _copy_metadata(
    reader: RecordReader, copies: Sequence[McapFile], path: Path, counts: Mapping[str, int]
) -> Recovery:
    """Copy attachments and metadata; returns the Recovery."""
    start_ns = reader.numbers.start_ns
    for name, data in reader.attachments.items():
        copies[0].add_attachment(name, "application/octet-stream", data, start_ns)
    lost_bytes = sum(file.size - file.readable_bytes for file in reader.files if not file.whole)
    lost_parts = [lost.description for lost in reader.damages if not lost.start_ns]
    recovery = {
        "source": reader.path.name,
        "source_sha256": _sha256_if_readable(reader.path),
        "source_was_cut": str(reader.truncated).lower(),
        "lost_chunks": str(len(reader.damages) - len(lost_parts)),
        "lost_parts": "; ".join(lost_parts),
        "lost_bytes_at_the_end": str(lost_bytes),
    }
    earlier = sum(name.startswith(RECOVERY) for name in reader.metadata)
    name = f"{RECOVERY} {earlier + 1}" if earlier else RECOVERY
    for copy, metadata in zip(
        copies, ({**reader.metadata, name: recovery}, {"record": reader.metadata["record"]}), strict=False
    ):
        copy.add_metadata(metadata, start_ns)
    return Recovery(
        source=reader.path,
        path=path,
        messages=dict(counts),
        start_ns=start_ns,
        end_ns=max(file.end_ns for file in reader.files),
        lost=tuple(reader.damages),
        lost_bytes=lost_bytes,
    )


def _verify(names: Sequence[Path], counts: Mapping[str, int], path: Path, source: Path) -> None:
    """Read the copies again. Raises RecordError where they do not hold what was written."""
    found: Counter[str] = Counter()
    sound = True
    for name in names:
        with contextlib.closing(ReadFile(name)) as copy:
            sound = sound and copy.is_sound()
            found.update({topic: copy.counts[number] for number, topic in copy.channels.items()})
    if not sound or +found != Counter(counts):
        raise RecordError(f"{path}: does not hold what was written; {source} is unchanged")


def _sha256_if_readable(path: Path) -> str:
    """SHA-256 of the source; empty if the disk cannot read all of it."""
    try:
        return sha256_of(path)
    except RecordError:
        return ""
