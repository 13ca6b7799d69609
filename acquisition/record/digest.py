"""SHA-256 of a record, by which results.json identifies it."""

import functools
import hashlib
from pathlib import Path

from acquisition.record.disk_faults import FaultTolerantFile
from processing.errors import RecordError

_BLOCK_BYTES = 1024 * 1024


@functools.lru_cache(maxsize=256)
def _known(path: Path, identity: tuple[int, ...]) -> str:
    return sha256_of(path)


def known_sha256_of(path: Path) -> str:
    """The same; of a file that this process has read and that is still the same one, without reading."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return sha256_of(path)
    return _known(path.resolve(), (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns))


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces, with zeros where the disk cannot give them."""
    digest = hashlib.sha256()
    try:
        with FaultTolerantFile(path) as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    return digest.hexdigest()
