"""Files that are on the disk whole or not at all, also after a power failure: the one way to write a file.

A file is written under a temporary name beside its own, forced to the disk, read again and proved, and only
then takes its name. Who writes one holds a lock on it, or on a claim beside it, which ends with the process:
what a kill leaves is known by that and taken away by the next call (`take_away_leftovers`).
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_fcntl: Any
try:
    import fcntl as _fcntl
except ImportError:
    # Windows: what a kill leaves stays there, because nothing tells it from what is being written
    _fcntl = None

_FLAGS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_LEFTOVER = re.compile(r"\.(.+)\.[0-9a-f]{8}(\.claim)?", re.DOTALL)
_CLAIM = ".claim"


def write_new(path: Path, data: bytes) -> None:
    """Write a file that must not exist yet.

    Raises FileExistsError, or OSError where it cannot be written.
    """
    with _written_beside(path, data, 0o666) as beside:
        _take_free_name(beside, path)
    sync_folder(path.parent)


def replace(path: Path, data: bytes, *, mode: int = 0o666) -> None:
    """Write a file in place of an older one; a symbolic link of this name is replaced, never followed."""
    with _written_beside(path, data, mode) as beside:
        beside.replace(path)
    sync_folder(path.parent)


@contextlib.contextmanager
def being_written(path: Path) -> Iterator[Path]:
    """A name to write a file under that takes its own when the block ends, forced to the disk.

    Nothing is left of it where the block raises; what was left by a process that was killed while it wrote
    the same file is taken away before. Raises FileExistsError, and OSError where it cannot be written.
    """
    _refuse_existing(path)
    with _beside(path) as beside:
        yield beside
        _force(beside)
        _take_free_name(beside, path)
        sync_folder(path.parent)


@contextlib.contextmanager
def folder_being_written(path: Path) -> Iterator[Path]:
    """The same for a folder of plain files, which must not exist: it takes its name with all that is in it.

    Raises FileExistsError, and OSError where it cannot be written.
    """
    _refuse_existing(path)
    with _beside(path) as beside:
        beside.mkdir()
        yield beside
        for place, _, files in os.walk(beside):
            for file in files:
                _force(Path(place) / file)
            sync_folder(Path(place))
        beside.rename(path)
        sync_folder(path.parent)


@contextlib.contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A claimed name beside a path; what has it at the end is taken away."""
    take_away_leftovers(path.parent, path.name)
    beside = _name_beside(path)
    claim = beside.with_name(f"{beside.name}{_CLAIM}")
    number = _claimed(claim)
    try:
        yield beside
    finally:
        # the claim goes last: without it the file would be nobody's
        _take_away(beside)
        os.close(number)
        claim.unlink(missing_ok=True)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def _take_away(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def take_away_leftovers(folder: Path, name: str = "") -> list[Path]:
    """Remove what killed processes left of what was being written in a folder, or of one name; says of which.

    What a living process writes is locked, and stays.
    """
    gone: list[Path] = []
    try:
        entries = [entry.name for entry in os.scandir(folder) if entry.name.startswith(".")]
    except OSError:
        return gone
    for entry in entries:
        found = _LEFTOVER.fullmatch(entry)
        if found is None or (name and found[1] != name):
            continue
        path = folder / entry
        if not found[2] and path.with_name(f"{entry}{_CLAIM}").exists():
            continue
        if _is_nobodys(path):
            with contextlib.suppress(OSError):
                _take_away(path.with_name(entry.removesuffix(_CLAIM)))
                path.unlink(missing_ok=True)
                gone.append(folder / found[1])
    return gone


def sync_folder(folder: Path) -> None:
    """Flush the folder, so that a new file's name survives a power failure; Windows has no such call."""
    if os.name == "posix":
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _name_beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}")


def _take_free_name(beside: Path, path: Path) -> None:
    """Give a file its name, which must be free."""
    try:
        os.link(beside, path)
    except FileExistsError:
        raise
    except OSError:
        # a file system without hard links (exFAT)
        _refuse_existing(path)
        beside.rename(path)


@contextlib.contextmanager
def _written_beside(path: Path, data: bytes, mode: int = 0o666) -> Iterator[Path]:
    """The data in a locked file of a name of its own beside `path`, on the disk and read again."""
    beside = _name_beside(path)
    number = _claimed(beside, mode)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(number, rest) :]
        os.fsync(number)
        os.lseek(number, 0, os.SEEK_SET)
        read = bytearray()
        while block := os.read(number, len(data) + 1 - len(read)):
            read += block
        if read != data:
            raise OSError(errno.EIO, "read again it is not what was written")
        if _fcntl is None:
            # an open file cannot be renamed there
            os.close(number)
            number = -1
        yield beside
    finally:
        # closed first: Windows removes no open file
        if number >= 0:
            os.close(number)
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def _claimed(path: Path, mode: int = 0o666) -> int:
    """A new file, opened and locked; one that somebody takes for left over meanwhile is made again.

    Without locks nobody takes it, and such a system may not know a file again by its number.
    """
    while True:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, mode)
        locked = _locked(number)
        if locked is None:
            return number
        try:
            if locked and os.path.samestat(os.fstat(number), path.stat()):
                return number
        except FileNotFoundError:
            pass
        os.close(number)
        path.unlink(missing_ok=True)
        time.sleep(0)


def _is_nobodys(path: Path) -> bool:
    """Whether no living process has a file locked."""
    try:
        number = os.open(path, os.O_RDWR | _FLAGS)
    except OSError:
        return False
    try:
        return _locked(number) is True
    finally:
        os.close(number)


def _locked(number: int) -> bool | None:
    """Whether the file is now locked by this process; None where the system or its disk knows no locks."""
    if _fcntl is None:
        return None
    try:
        _fcntl.flock(number, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _force(path: Path) -> None:
    """Flush a file to the disk that somebody else has written and closed."""
    number = os.open(path, os.O_RDWR)
    try:
        os.fsync(number)
    finally:
        os.close(number)
