"""Recovery of a truncated or damaged record into a new, complete file."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.chunk_reader import ChunkDamage, messages_in, open_chunk
from acquisition.record.container import McapFile
from acquisition.record.digest import sha256_of
from acquisition.record.proved_file import Damage
from acquisition.record.reader import RecordReader
from acquisition.record.whole_file import being_written
from processing.errors import RecordError

RECOVERY = "recovery"
"""Name of the metadata of a record that `rig recover` made; of a second recovery "recovery 2"."""
_RESERVE_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of `recover`.

    `messages` are the numbers of recovered messages by topic, `start_ns` and `end_ns` (UTC) the times of the
    first and the last. `lost` are damaged chunks and attachments, `damage` describes other parts that were
    not as written, `lost_bytes` is the number of bytes after the last complete record.
    """

    source: Path
    path: Path
    messages: Mapping[str, int]
    start_ns: int
    end_ns: int
    lost: tuple[Damage, ...]
    damage: tuple[str, ...]
    lost_bytes: int


def recover(source: Path, path: Path) -> Recovery:
    """Copy every intact message of a record, its metadata and attachments into a new file.

    The source is not changed. The metadata `RECOVERY` of the new file state its source and what is missing;
    those of an earlier recovery stay. The new file appears when it has been read again and proved.

    Raises
    ------
    RecordError
        The source is not a record of this program; the new file exists already or cannot be written.
    """
    try:
        with RecordReader(source) as reader, being_written(path) as beside:
            file = McapFile(beside, _RESERVE_BYTES)
            try:
                found = _copy(reader, file, path)
                file.finish()
                if file.full is not None:
                    raise file.full
            finally:
                # before it is removed, for which it must be closed on Windows
                file.abandon()
            with RecordReader(beside) as copy:
                same = {topic: count for topic, count in copy.counts.items() if count} == found.messages
                if not same or not copy.contents.is_sound(copy.file):
                    raise RecordError(f"{path}: does not hold what was written; {source} is unchanged")
    except FileExistsError:
        raise RecordError(f"{path}: exists already and is never overwritten; choose another name") from None
    except OSError as error:
        why = f"{path}: cannot be written: {error.strerror or error}; {source} is unchanged"
        raise RecordError(why) from error
    return found


def _copy(reader: RecordReader, file: McapFile, path: Path) -> Recovery:
    contents = reader.contents
    for name, data in reader.attachments.items():
        file.add_attachment(name, "application/octet-stream", data, contents.start_ns)
    numbers: dict[int, int] = {}
    for number, channel in sorted(contents.channels.items()):
        schema = contents.schemas.get(channel.schema_id)
        if schema is not None:
            numbers[number] = file.add_channel(channel.topic, schema.name, schema.data)
    counts: Counter[str] = Counter()
    for place in contents.chunks:
        builder = ChunkBuilder()
        try:
            for message in messages_in(open_chunk(reader.file, place)):
                copied = numbers.get(message.channel)
                if copied is None:
                    reader.note_damage(place, "messages of a topic without a description")
                    continue
                builder.add(copied, message.sequence, message.log_time_ns, message.data)
                counts[contents.channels[message.channel].topic] += 1
        except ChunkDamage as damage:
            reader.note_damage(place, str(damage))
            continue
        file.add_chunk(builder)
        if file.full is not None:
            raise file.full
    lost_bytes = 0 if contents.whole else contents.size - contents.readable_bytes
    lost_parts = [damage.what for damage in reader.damages if not damage.start_ns]
    recovery = {
        "source": reader.path.name,
        "source_sha256": _sha256_if_readable(reader.path),
        "source_was_cut": str(reader.truncated).lower(),
        "lost_chunks": str(len(reader.damages) - len(lost_parts)),
        "lost_parts": "; ".join([*lost_parts, *contents.damage]),
        "lost_bytes_at_the_end": str(lost_bytes),
    }
    earlier = sum(name.startswith(RECOVERY) for name in contents.metadata)
    name = f"{RECOVERY} {earlier + 1}" if earlier else RECOVERY
    file.add_metadata({**contents.metadata, name: recovery}, contents.start_ns)
    return Recovery(
        source=reader.path,
        path=path,
        messages=dict(counts),
        start_ns=contents.start_ns,
        end_ns=file.end_ns,
        lost=tuple(reader.damages),
        damage=tuple(contents.damage),
        lost_bytes=lost_bytes,
    )


def _sha256_if_readable(path: Path) -> str:
    """By which the source is known; nothing where its disk cannot give all of it."""
    try:
        return sha256_of(path)
    except RecordError:
        return ""
