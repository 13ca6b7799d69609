"""A FUSE file system that passes everything on to a folder, hangs while a file is there, and can be spoilt.

As a program it takes the source, the place to mount and the name of that file: while the file exists, nothing
that writes, forces data to the disk or asks for its space returns, as on a disk that does not answer. A file
of the same name with the suffix .spoilt states bytes that cannot be read.
"""

import contextlib
import errno
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.waiting import until

mfusepy: Any
try:
    import mfusepy
except (ImportError, OSError):  # OSError: the package is there, the library is not
    mfusepy = None


class NoFuse(Exception):
    """Why no such file system can be mounted here."""


@dataclass(frozen=True)
class Mounted:
    """A mounted file system; `folder` hangs as `hang` says."""

    folder: Path
    hangs: Path

    def hang(self) -> None:
        """From now on it does not answer."""
        self.hangs.touch()

    def go_on(self) -> None:
        """It answers again."""
        self.hangs.unlink(missing_ok=True)

    def spoil(self, first: int, last: int, name: str) -> None:
        """From now on these bytes of a file cannot be read."""
        self.hangs.with_suffix(".spoilt").write_text(f"{first} {last} {name}")

    def wait_for_hanging(self) -> None:
        """Return when somebody waits for an answer."""
        until(self.hangs.with_suffix(".waiting").exists)


@contextlib.contextmanager
def mounted(base: Path) -> Iterator[Mounted]:
    """Mount one within `base`. Raises NoFuse."""
    if mfusepy is None or not os.access("/dev/fuse", os.W_OK):
        raise NoFuse("needs /dev/fuse, the library fuse3 and the package mfusepy")
    source, folder, hangs = base / "source", base / "disk", base / "hangs"
    source.mkdir()
    folder.mkdir()
    words = [sys.executable, "-m", "tests.acquisition.record.hanging_disk", source, folder, hangs]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    disk = Mounted(folder, hangs)
    try:
        until(lambda: os.path.ismount(folder) or process.poll() is not None)
        if process.poll() is not None:
            said = process.communicate()[1].decode(errors="replace").strip()
            raise NoFuse(said.splitlines()[-1] if said else "mounting failed")
        yield disk
    finally:
        disk.go_on()
        for command in (["fusermount3", "-u"], ["umount"]):
            with contextlib.suppress(OSError):
                subprocess.run([*command, folder], capture_output=True, check=False)
        process.terminate()
        process.communicate()


Operations: Any = object if mfusepy is None else mfusepy.Operations


class HangingDisk(Operations):
    """The files of `source`."""

    use_ns = True

    def __init__(self, source: Path, hangs: Path) -> None:
        self._source = source
        self._hangs = hangs

    def _path(self, path: str) -> str:
        return f"{self._source}{path}"

    def _answer(self) -> None:
        while self._hangs.exists():
            self._hangs.with_suffix(".waiting").touch()
            time.sleep(0.01)

    def getattr(self, path: str, fh: int | None = None) -> dict[str, int]:
        found = os.lstat(self._path(path))
        names = ("st_mode", "st_nlink", "st_size", "st_uid", "st_gid")
        times = {f"st_{name}time": getattr(found, f"st_{name}time_ns") for name in "amc"}
        return {**{name: getattr(found, name) for name in names}, **times}

    def readdir(self, path: str, fh: int) -> list[str]:
        return [".", "..", *os.listdir(self._path(path))]

    def mkdir(self, path: str, mode: int) -> int:
        os.mkdir(self._path(path), mode)
        return 0

    def create(self, path: str, mode: int, fi: object = None) -> int:
        return os.open(self._path(path), os.O_RDWR | os.O_CREAT | os.O_EXCL, mode)

    def open(self, path: str, flags: int) -> int:
        return os.open(self._path(path), flags)

    def read(self, path: str, size: int, offset: int, fh: int) -> bytes:
        with contextlib.suppress(FileNotFoundError):
            first, last, name = self._hangs.with_suffix(".spoilt").read_text().split()
            if path.endswith(f"/{name}") and offset < int(last) and offset + size > int(first):
                raise OSError(errno.EIO, "unreadable")
        return os.pread(fh, size, offset)

    def write(self, path: str, data: bytes, offset: int, fh: int) -> int:
        self._answer()
        return os.pwrite(fh, data, offset)

    def truncate(self, path: str, length: int, fh: int | None = None) -> int:
        self._answer()
        os.truncate(self._path(path), length)
        return 0

    def fsync(self, path: str, datasync: int, fh: int) -> int:
        self._answer()
        os.fsync(fh)
        return 0

    def release(self, path: str, fh: int) -> int:
        os.close(fh)
        return 0

    def rename(self, old: str, new: str) -> int:
        os.rename(self._path(old), self._path(new))
        return 0

    def unlink(self, path: str) -> int:
        os.unlink(self._path(path))
        return 0

    def statfs(self, path: str) -> dict[str, int]:
        self._answer()
        found = os.statvfs(self._source)
        names = ("f_bsize", "f_frsize", "f_blocks", "f_bfree", "f_bavail", "f_namemax")
        return {name: getattr(found, name) for name in names}


if __name__ == "__main__":
    source, folder, hangs = map(Path, sys.argv[1:])
    mfusepy.FUSE(HangingDisk(source, hangs), str(folder), foreground=True)
