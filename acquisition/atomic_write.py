"""The one way to write a file: it is on the disk whole or not at all, also after a power failure.

A file is written under a temporary name in its folder, flushed to the disk, and only then gets its own name.
Files that a kill leaves have such a name, and are removed when they are a day old (`remove_leftovers`).
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_LEFTOVER = re.compile(r"\.(.+)\.[0-9a-f]{8}", re.DOTALL)
_LEFTOVER_AGE_S = 24 * 3600.0
"""Minimum age of a temporary file whose writer must have been killed; no file takes so long to write."""


def write_new(path: Path, data: bytes) -> None:
    """Write a new file. Raises FileExistsError where it exists, OSError where it cannot be written."""
    with atomic_file(path) as temporary:
        _write(temporary, data)


def replace(path: Path, data: bytes, *, mode: int = 0o666) -> None:
    """Write a file in place of an older one; a symbolic link of this name is replaced, never followed."""
    with _temporary_name(path) as temporary:
        _write(temporary, data, mode)
        _flush(temporary)
        temporary.replace(path)
    sync_folder(path.parent)


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary name for a new file, which is flushed and gets its own name when the block ends.

    The file is removed where the block raises. Exceptions are those of `write_new`.
    """
    _refuse_existing(path)
    with _temporary_name(path) as temporary:
        yield temporary
        _flush(temporary)
        _rename_to_free(temporary, path)
        sync_folder(path.parent)


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A temporary name for a new folder of plain files, as `atomic_file` for a file."""
    _refuse_existing(path)
    with _temporary_name(path) as temporary:
        temporary.mkdir()
        yield temporary
        for folder, _, files in os.walk(temporary):
            for file in files:
                _flush(Path(folder) / file)
            sync_folder(Path(folder))
        temporary.rename(path)
        sync_folder(path.parent)


def remove_leftovers(folder: Path, name: str = "") -> list[Path]:
    """Remove files (all, or of one name) that killed processes left a day ago; returns their own paths."""
    targets: list[Path] = []
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(folder)):
            match = _LEFTOVER.fullmatch(entry.name)
            if match is None or (name and match[1] != name):
                continue
            if time.time() - entry.stat(follow_symlinks=False).st_mtime > _LEFTOVER_AGE_S:
                _remove(Path(entry.path))
                targets.append(folder / match[1])
    return targets


def sync_file(descriptor: int) -> None:
    """Flush an open file to the disk; on macOS fsync alone leaves data in the drive's cache."""
    if sys.platform == "darwin":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
    else:
        os.fsync(descriptor)


def sync_folder(folder: Path) -> None:
    """Flush the folder, so that a new file's name survives a power failure; Windows has no such call."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def _temporary_name(path: Path) -> Iterator[Path]:
    """A temporary name in the folder of a path; a file or folder that still has it at the end is removed."""
    remove_leftovers(path.parent, path.name)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        yield temporary
    finally:
        _remove(temporary)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _rename_to_free(temporary: Path, path: Path) -> None:
    """Give a file its name, which must be free."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise
    except OSError:
        # a file system without hard links (exFAT)
        _refuse_existing(path)
        temporary.rename(path)


def _write(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Create a file with these bytes."""
    with open(os.open(path, _FLAGS, mode), "wb") as file:
        file.write(data)


def _flush(path: Path) -> None:
    """Flush a file that was written and closed to the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        sync_file(descriptor)
    finally:
        os.close(descriptor)
