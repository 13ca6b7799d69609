"""Recovery of a truncated or damaged record into a new, complete file."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition.record.chunk_builder import MESSAGE_HEAD, ChunkBuilder
from acquisition.record.chunk_order import arranged
from acquisition.record.chunk_reader import ChunkDamage, message_heads
from acquisition.record.container import McapFile, new_record
from acquisition.record.descriptions import own_texts
from acquisition.record.digest import sha256_of
from acquisition.record.proof import RECOVERY, is_sound, unproved_parts
from acquisition.record.proved_file import Damage
from acquisition.record.reader import RecordReader
from acquisition.record.records import HEAD
from processing.errors import RecordError

_RESERVE_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of `recover`.

    `messages` are the numbers of recovered messages by topic, `start_ns` and `end_ns` (UTC) the times of the
    first and the last. `lost` are damaged chunks and attachments, `damage` describes other parts that were
    not as written, `doubles` and `foreign` name chunks that were left out because they stood there already or
    are another run's, `moved` is how many were put where their frames belong, `unproved` names what was
    copied although nothing in the source proves it, `lost_bytes` is the number of bytes after the last
    complete record.
    """

    source: Path
    path: Path
    messages: Mapping[str, int]
    start_ns: int
    end_ns: int
    lost: tuple[Damage, ...]
    damage: tuple[str, ...]
    doubles: tuple[str, ...]
    foreign: tuple[str, ...]
    moved: int
    unproved: tuple[str, ...]
    lost_bytes: int


def recover(source: Path, path: Path) -> Recovery:
    """Copy every intact message of a record, its metadata and attachments into a new file.

    Chunks are put into the order of their frames; those that stand twice or are another run's are left out.
    The source is not changed. The metadata `RECOVERY` of the new file state its source and what is missing;
    those of an earlier recovery stay. The new file appears when it has been read again and proved.

    Raises
    ------
    RecordError
        The source is not a record of this program; the new file exists already or cannot be written.
    """
    found: list[Recovery] = []

    def prove(beside: Path) -> None:
        with RecordReader(beside) as reader:
            same = {topic: count for topic, count in reader.counts.items() if count} == found[0].messages
            if not same or not is_sound(reader.file, reader.contents):
                raise RecordError(f"{path}: does not hold what was written; {source} is unchanged")

    with RecordReader(source) as reader, new_record(path, source, _RESERVE_BYTES, prove=prove) as file:
        found.append(_copy(reader, file, path))
        file.finish()
    return found[0]


def copy_head(reader: RecordReader, file: McapFile) -> dict[int, int]:
    """Copy attachments and descriptions of topics; returns the new file's channels by the old one's."""
    contents = reader.contents
    for name, data in reader.attachments.items():
        file.add_attachment(name, "application/octet-stream", data, contents.start_ns)
    numbers: dict[int, int] = {}
    for number, channel in sorted(contents.channels.items()):
        schema = contents.schemas.get(channel.schema_id)
        if schema is not None:
            numbers[number] = file.add_channel(channel.topic, schema.name, schema.data, own_texts(channel))
    return numbers


def _copy(reader: RecordReader, file: McapFile, path: Path) -> Recovery:
    contents = reader.contents
    numbers = copy_head(reader, file)
    counts: Counter[str] = Counter()
    order = arranged(reader, reader.chunk_opener())
    opened = reader.chunk_opener()
    for place in order.places:
        builder = ChunkBuilder()
        try:
            chunk = opened(place)
            starts, heads = message_heads(chunk)
            # a message may fill its chunk: it is copied once, into the builder
            bytes_of = memoryview(chunk.data)
            for start, head in zip(starts.tolist(), heads.tolist(), strict=True):
                _, length, channel, sequence, log_time_ns, _ = head
                copied = numbers.get(channel)
                if copied is None:
                    reader.note_damage(place, "messages of a topic without a description")
                    continue
                content = bytes_of[start + MESSAGE_HEAD.size : start + HEAD.size + length]
                builder.add(copied, sequence, log_time_ns, content)
                counts[contents.channels[channel].topic] += 1
        except ChunkDamage as damage:
            reader.note_damage(place, str(damage))
            continue
        file.add_chunk(builder)
        if file.full is not None:
            raise file.full
    lost_bytes = 0 if contents.whole else contents.size - contents.readable_bytes
    unproved = unproved_parts(reader.file, contents)
    source_sha256 = _sha256_if_readable(reader.path)
    if reader.disk_notice:
        contents.damage.append(reader.disk_notice)
    lost_parts = [damage.what for damage in reader.damages if not damage.start_ns]
    recovery = {
        "source": reader.path.name,
        "source_sha256": source_sha256,
        "source_was_cut": str(reader.truncated).lower(),
        "lost_chunks": str(len(reader.damages) - len(lost_parts)),
        "lost_parts": "; ".join([*lost_parts, *contents.damage]),
        "lost_bytes_at_the_end": str(lost_bytes),
        "doubles_left_out": "; ".join(order.doubles),
        "foreign_left_out": "; ".join(order.foreign),
        "chunks_moved": str(order.moved),
        "unproved": ", ".join(unproved),
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
        doubles=tuple(order.doubles),
        foreign=tuple(order.foreign),
        moved=order.moved,
        unproved=unproved,
        lost_bytes=lost_bytes,
    )


def _sha256_if_readable(path: Path) -> str:
    """By which the source is known; nothing where its disk cannot give all of it."""
    try:
        return sha256_of(path)
    except RecordError:
        return ""
