"""SHA-256 of a record, by which results.json identifies it."""

import functools
import hashlib
import stat
from pathlib import Path

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


def known_sha256_of_any(path: Path) -> str:
    """The same; of a folder that of the names and hashes of its files, in order. Raises RecordError."""
    if not path.is_dir():
        return known_sha256_of(path)
    lines = [f"{known_sha256_of(each)}  {each.name}\n" for each in sorted(path.iterdir()) if each.is_file()]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces.

    Raises RecordError where any part cannot be read: the hash of anything else would be another file's name.
    """
    digest = hashlib.sha256()
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            # a pipe would wait for a writer
            raise RecordError(f"{path}: is not a file; a folder, pipe or device has no hash")
        with path.open("rb", buffering=0) as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    return digest.hexdigest()
