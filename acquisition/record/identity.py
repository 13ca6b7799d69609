"""Which measurement a record is of: the SHA-256 by which results know it, also after it was thinned."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path

from acquisition.record.digest import known_sha256_of, sha256_of
from acquisition.record.proof import is_sound
from acquisition.record.proved_file import ProvedFile
from processing.errors import RecordError


class Thinning(StrEnum):
    """What became of the windows of pixels of a thinned record."""

    DROPPED = "dropped"
    RECOMPRESSED = "recompressed"


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
