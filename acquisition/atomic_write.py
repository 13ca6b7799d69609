"""Files that are on the disk whole or not at all, also after a power failure: the one way to write a file.

A file is written under a temporary name beside its own, forced to the disk, and only then takes its name.
What a kill leaves is known by such a name and taken away when it is a day old (`take_away_leftovers`).
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

_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_LEFTOVER = re.compile(r"\.(.+)\.[0-9a-f]{8}", re.DOTALL)
_LEFT_S = 24 * 3600.0
"""Nothing takes so long to write: what is older was left by a process that was killed."""


def write_new(path: Path, data: bytes) -> None:
    """Write a file that must not exist yet.

    Raises FileExistsError, or OSError where it cannot be written.
    """
    with being_written(path) as beside:
        _write(beside, data)


def replace(path: Path, data: bytes, *, mode: int = 0o666) -> None:
    """Write a file in place of an older one; a symbolic link of this name is replaced, never followed."""
    with _beside(path) as beside:
        _write(beside, data, mode)
        _force(beside)
        beside.replace(path)
    sync_folder(path.parent)


@contextlib.contextmanager
def being_written(path: Path) -> Iterator[Path]:
    """A name to write a file under that takes its own when the block ends, forced to the disk.

    Nothing is left of it where the block raises. Raises FileExistsError, and OSError where it cannot be
    written.
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


def take_away_leftovers(folder: Path, name: str = "") -> list[Path]:
    """Remove what killed processes left a day ago of files in a folder, or of one name; says of which."""
    gone: list[Path] = []
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(folder)):
            found = _LEFTOVER.fullmatch(entry.name)
            if found is None or (name and found[1] != name):
                continue
            if time.time() - entry.stat(follow_symlinks=False).st_mtime > _LEFT_S:
                _take_away(Path(entry.path))
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


@contextlib.contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A name beside a path; what has it at the end is taken away."""
    take_away_leftovers(path.parent, path.name)
    beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        yield beside
    finally:
        _take_away(beside)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def _take_away(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


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


def _write(path: Path, data: bytes, mode: int = 0o666) -> None:
    """A new file with these bytes."""
    with open(os.open(path, _FLAGS, mode), "wb") as file:
        file.write(data)


def _force(path: Path) -> None:
    """Flush a file to the disk that was written and closed."""
    number = os.open(path, os.O_RDWR)
    try:
        os.fsync(number)
    finally:
        os.close(number)
