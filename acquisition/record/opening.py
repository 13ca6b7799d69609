"""Opens a file and judges whether it is a record of this program."""

from pathlib import Path

from mcap.opcode import Opcode

from acquisition.record.contents import Contents
from acquisition.record.descriptions import own_texts
from acquisition.record.disk_faults import FaultTolerantFile
from acquisition.record.records import MAGIC
from acquisition.record.topics import SCHEMA_VERSION, SPOT
from processing.errors import RecordError


def open_mcap(path: Path) -> FaultTolerantFile:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if not path.is_dir() and path.exists() and not path.is_file():
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = FaultTolerantFile(path)
        head = file.read(len(MAGIC) + 1)
    except FileNotFoundError:
        raise RecordError(f"{path}: no such record{_instead_of(path)}") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if not _is_magic(head):
        file.close()
        if file.unreadable_bytes:
            raise RecordError(f"{path}: cannot be read from its disk")
        what = "is empty" if not head else "is not an MCAP file"
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


def check_ours(path: Path, contents: Contents) -> None:
    """Check the metadata "record", of which the channel of spots contains a copy.

    The copy is taken if both exist: it is repeated in the summary, which has a checksum.
    """
    metadata = contents.metadata.get("record", {})
    spots = (c for c in contents.channels.values() if c.topic == SPOT.topic)
    beside = next(map(own_texts, spots), {})
    if metadata and beside and metadata != beside:
        contents.damage.append("metadata record differs from its copy: bytes have changed")
    head = {**metadata, **beside}
    if not head:
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
    if version > SCHEMA_VERSION:
        raise RecordError(
            f"{path}: has schema version {version}, this program reads up to {SCHEMA_VERSION}; "
            "update optical-pendulum-rig"
        )
    contents.metadata["record"] = head
