"""The verified parts of a record: metadata, attachments, chunks; what is damaged is left out and listed."""

import json
import logging
from collections.abc import Callable, Iterator, Sized
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple, Self, TypeVar

from mcap.opcode import Opcode

from acquisition.record.chunk_reader import ChunkDamage, ChunkPlace, open_chunk
from acquisition.record.contents import Contents, read_contents
from acquisition.record.records import MAGIC, intact_attachment, read_at, read_record
from acquisition.record.topics import METADATA_COPY, SCHEMA_VERSION
from processing.errors import RecordError, require_schema

_log = logging.getLogger(__name__)
_Found = TypeVar("_Found", bound=Sized)


class Damage(NamedTuple):
    """A damaged part of a record: topics and times (UTC) of the chunk, and a description."""

    start_ns: int
    end_ns: int
    topics: tuple[str, ...]
    what: str


class ProvedFile:
    """A record whose structure, metadata, attachments and chunks are verified as they are read; a context
    manager.

    A chunk whose checksum is wrong is left out, listed in `damages` and logged; everything else is read. A
    file without an ending, as after a crash or a power failure, is `truncated`; its complete chunks are read.

    Raises
    ------
    RecordError
        No such file, not an MCAP file, not a record of this program, or a record of a newer version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damages: list[Damage] = []
        self._damaged: set[int] = set()
        self.file = open_mcap(path)
        try:
            self.contents: Contents = read_contents(self.file)
            self._read_metadata()
        except OSError as error:
            self.file.close()
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
        except BaseException:
            self.file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    @property
    def truncated(self) -> bool:
        """Whether the file was cut short, so that it has no ending."""
        return not self.contents.whole

    @property
    def cut_notice(self) -> str:
        """One line for the user about a truncated file, with the remedy; empty if the file is complete."""
        if not self.truncated:
            return ""
        return (
            f"{self.path}: was cut short (it has no ending); its complete part is used, "
            f"rig recover {self.path} makes a complete file of it"
        )

    def doubts(self) -> list[str]:
        """What has to be said with everything that was read so far: cut short, damaged, changed; one line
        each.
        """
        lines = [self.cut_notice] if self.truncated else []
        lines += [f"damaged, not used: {damage.what}" for damage in self.damages]
        return lines + [f"the record's structure: {text}" for text in self.contents.damage]

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata: texts by key, by name (session, camera, environment, versions, record)."""
        return self.contents.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name; one of which no copy is intact is left out, every damaged copy listed in
        `damages`.
        """
        found = {name: self._attached(name) for name in self.contents.attachment_places}
        return {name: data for name, data in found.items() if name != METADATA_COPY and data is not None}

    def _attached(self, name: str) -> bytes | None:
        """The first intact copy of an attachment."""
        for place in self.contents.attachment_places.get(name, ()):
            try:
                return intact_attachment(read_record(self.file, place)[1])
            except ValueError as error:
                self._remember(place, Damage(0, 0, (), f"attachment {name}: {error}"))
        return None

    @property
    def epoch_offset_ns(self) -> int:
        """Offset in ns that is added to the frames' clock to obtain UTC."""
        return int(self.metadata["record"]["epoch_offset_ns"])

    def by_chunk(
        self, take: Callable[[bytes, frozenset[int]], _Found], topic: str, start_ns: int | None = None
    ) -> Iterator[_Found]:
        """What `take` returns for each chunk's bytes and the topic's channels, if not empty.

        Chunks that end before `start_ns` (on the frames' clock) are not read.
        """
        from_ns = 0 if start_ns is None else start_ns + self.epoch_offset_ns
        channels = self.contents.channels.items()
        wanted = frozenset(number for number, channel in channels if channel.topic == topic)
        for place in self.contents.chunks:
            listed = self.contents.indexed and place.channels
            if place.end_ns < from_ns or (listed and not wanted & place.channels):
                continue
            try:
                found = take(open_chunk(self.file, place), wanted)
            except ChunkDamage as damage:
                self.note_damage(place, str(damage))
                continue
            if len(found):
                yield found

    def note_damage(self, place: ChunkPlace, what: str) -> None:
        """Add a damaged chunk to `damages`, once."""
        channels = self.contents.channels
        topics = tuple(sorted(channels[number].topic for number in place.channels if number in channels))
        self._remember(place.offset, Damage(place.start_ns, place.end_ns, topics, what))

    def _remember(self, offset: int, damage: Damage) -> None:
        if offset not in self._damaged:
            self._damaged.add(offset)
            self.damages.append(damage)
            _log.warning("%s: damaged at byte %d, not used: %s", self.path, offset, damage.what)

    def _read_metadata(self) -> None:
        """Take the metadata from their copy, which has a checksum, and see whether the record is ours."""
        path, contents = self.path, self.contents
        copy = self._attached(METADATA_COPY)
        if copy is not None:
            contents.metadata = json.loads(copy)
        head = contents.metadata.get("record", {})
        if not head and METADATA_COPY not in contents.attachments:
            topics = ", ".join(sorted(channel.topic for channel in contents.channels.values()))
            if not topics and not contents.whole:
                raise RecordError(f"{path}: was cut short before anything was recorded")
            raise RecordError(
                f"{path}: is an MCAP file of another program (topics: {topics or 'none'}); "
                "only records of rig run can be read"
            )
        try:
            version = int(head["schema_version"])
            int(head["epoch_offset_ns"])
        except (KeyError, ValueError):
            raise RecordError(f"{path}: its own description is damaged: {head}") from None
        require_schema(str(path), version, SCHEMA_VERSION, RecordError)


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if not path.is_dir() and path.exists() and not path.is_file():
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = path.open("rb")
        head = read_at(file, 0, len(MAGIC) + 1)
    except FileNotFoundError:
        raise RecordError(f"{path}: no such record{_instead_of(path)}") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if not _is_magic(head):
        file.close()
        what = "is empty, or cannot be read from its disk" if not head else "is not an MCAP file"
        raise RecordError(f"{path}: {what}; a record is made by rig run")
    return file


def _instead_of(path: Path) -> str:
    """What the folder of a missing record has."""
    there = sorted(other.name for other in path.parent.glob("*.mcap"))[:5]
    return f"; {path.parent} has {', '.join(there)}" if there else ""


def _is_magic(head: bytes) -> bool:
    """Whether a file begins as MCAP files do, up to one changed byte, with the first record behind it."""
    alike = sum(byte == expected for byte, expected in zip(head, MAGIC, strict=False))
    return head[: len(MAGIC)] == MAGIC or (
        alike >= len(MAGIC) - 1 and head[len(MAGIC) :] == bytes([Opcode.HEADER])
    )
