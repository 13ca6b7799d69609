"""What of a record is proved by a checksum and what is not, and which measurement it is of."""

import zlib
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import IO

from acquisition.record.contents import Contents
from acquisition.record.digest import known_sha256_of, sha256_of
from acquisition.record.proved_file import ProvedFile
from processing.errors import RecordError

_BLOCK_BYTES = 256 * 1024


def data_crc_matches(file: IO[bytes], contents: Contents) -> bool:
    """Whether the data section is as it was written; True where no checksum of it exists."""
    if not contents.whole or contents.data_crc == 0:
        return True
    crc, rest = 0, contents.data_end
    file.seek(0)
    while rest > 0:
        block = file.read(min(_BLOCK_BYTES, rest))
        if not block:
            return False
        crc = zlib.crc32(block, crc)
        rest -= len(block)
    return crc == contents.data_crc


def unproved_parts(file: IO[bytes], contents: Contents) -> tuple[str, ...]:
    """Metadata and descriptions that are believed unread: without a checksum of their own, in a file that
    was cut or has changed.
    """
    proved = contents.whole and contents.data_crc != 0 and data_crc_matches(file, contents)
    return () if proved else tuple(contents.unproved)


def is_sound(file: IO[bytes], contents: Contents) -> bool:
    """Whether every byte is proved to be as it was written, by the sums of index and data section."""
    whole = contents.whole and contents.indexed and contents.data_crc != 0
    return whole and not contents.damage and data_crc_matches(file, contents)


class Thinning(StrEnum):
    """What became of the windows of pixels of a thinned record."""

    DROPPED = "dropped"
    RECOMPRESSED = "recompressed"


RECOVERY = "recovery"
"""Name of the metadata of a record that `rig recover` made; of a second recovery "recovery 2"."""

THINNED = "thinned"
"""Name of the metadata of a thinned record; thinned once more, "thinned 2"."""


def thinning_of(record: ProvedFile) -> Mapping[str, str] | None:
    """What a thinned record says of its thinning; None of any other.

    What `rig recover` made of a thinned record is another record, for it may lack some of it: its last
    metadata are those of the recovery.
    """
    name = next(reversed(record.metadata), "")
    return record.metadata[name] if name.startswith(THINNED) else None


def identity_of(record: ProvedFile) -> str | None:
    """What a thinned record states as the SHA-256 of the one that was measured; None of any other.

    None also where any of its bytes have changed since: it then is not what it says.
    """
    said = thinning_of(record)
    return said.get("measured_sha256") if said and is_sound(record.file, record.contents) else None


def measured_sha256_of(path: Path, *, known: bool = False) -> str:
    """SHA-256 of a record as it was measured, by which results know it: its own, unless it was thinned.

    With `known` a file that this process has read is not read again. Raises RecordError where it cannot be
    read.
    """
    try:
        with ProvedFile(path) as record:
            measured = identity_of(record)
    except RecordError:
        measured = None
    return measured or (known_sha256_of(path) if known else sha256_of(path))
