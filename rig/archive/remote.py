"""An archive that lies elsewhere (`s3://bucket/name`): a copy of its files here, and what is new sent there.

All files of an archive are written once, whole, and never changed, so that names alone tell what is missing
on which side. Commands read and write the copy, as they would an archive on a disk; it lies in the user's
cache, and a command that was killed leaves in it what the next one sends.
"""

import contextlib
import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError, RigError

_SEEN = ".seen"
"""File of the copy that names what was there when it was last looked at: the rest is new here."""
_AT_ONCE = 256


def is_remote(archive: str) -> bool:
    """Whether an archive is named by a URL and not by a path."""
    return re.match(r"[a-z][a-z0-9+]+://", archive) is not None


@contextlib.contextmanager
def opened(archive: str) -> Iterator[Path]:
    """The folder of an archive named by a path, or a copy of one named by a URL of fsspec.

    What is new in the copy is sent when it is left, also after an error. Raises ConfigurationError without
    the packages that reach it, RecordError where it cannot be reached.
    """
    if not is_remote(archive):
        yield Path(archive)
        return
    copy = _Copy(archive)
    copy.fetch()
    try:
        yield copy.folder
    finally:
        copy.send()


def write_new(archive: str, name: str, data: bytes) -> None:
    """Write one file of a remote archive, whole or not at all; one that is there already stays as it is."""
    with _said_in_a_line(archive):
        system, root = _system(archive)
        with contextlib.suppress(FileExistsError):
            system.pipe_file(f"{root}/{name}", data, mode="create")


class _Copy:
    """The copy in the user's cache of an archive that is named by a URL."""

    def __init__(self, url: str) -> None:
        self._url = url.rstrip("/")
        with _said_in_a_line(url):
            self._system, self._root = _system(self._url)
        self.folder = _cache() / hashlib.sha256(self._url.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)

    def fetch(self) -> None:
        """Bring what is missing here; take away here what was taken away there."""
        with _said_in_a_line(self._url):
            self._system.invalidate_cache()
            there = {path.removeprefix(f"{self._root}/") for path in self._system.find(self._root)}
        here = self._here()
        for name in (here & self._seen()) - there:
            (self.folder / name).unlink(missing_ok=True)
        missing = sorted(there - here)
        for first in range(0, len(missing), _AT_ONCE):
            names = missing[first : first + _AT_ONCE]
            with _said_in_a_line(self._url):
                # one that somebody takes away meanwhile is left out
                found = self._system.cat([f"{self._root}/{name}" for name in names], on_error="omit")
            for path, data in found.items():
                target = self.folder / path.removeprefix(f"{self._root}/")
                target.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    whole_file.write_new(target, data)
        self._remember(there)

    def send(self) -> None:
        """Write there what is new here; of what was taken away here only merged files, which are derived."""
        here, seen = self._here(), self._seen()
        with _said_in_a_line(self._url):
            # what others are built from first
            for name in sorted(here - seen, key=lambda name: (name.startswith("merged/"), name)):
                with contextlib.suppress(FileExistsError):
                    data = (self.folder / name).read_bytes()
                    self._system.pipe_file(f"{self._root}/{name}", data, mode="create")
            for name in seen - here:
                if name.startswith("merged/"):
                    with contextlib.suppress(FileNotFoundError):
                        self._system.rm_file(f"{self._root}/{name}")
        self._remember(here)

    def _here(self) -> set[str]:
        return {
            path.relative_to(self.folder).as_posix()
            for path in self.folder.rglob("*")
            if path.is_file() and not path.name.startswith(".")
        }

    def _seen(self) -> set[str]:
        try:
            return set((self.folder / _SEEN).read_text(encoding="utf-8").splitlines())
        except FileNotFoundError:
            return set()

    def _remember(self, names: set[str]) -> None:
        beside = self.folder / f"{_SEEN}.{secrets.token_hex(4)}"
        beside.write_text("\n".join(sorted(names)), encoding="utf-8")
        beside.replace(self.folder / _SEEN)


def _system(url: str) -> tuple[Any, str]:
    """The file system that fsspec has for a URL, and the path in it."""
    try:
        import fsspec

        system, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise ConfigurationError(
            f"{url}: {str(error).rstrip('.')}: pip install 'optical-pendulum-rig[remote]'"
        ) from None
    return system, root.rstrip("/")


@contextlib.contextmanager
def _said_in_a_line(url: str) -> Iterator[None]:
    try:
        yield
    except RigError:
        raise
    except Exception as error:
        # the libraries behind fsspec have no error in common
        text = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordError(f"{url}: cannot be read or written: {text or type(error).__name__}") from None


def _cache() -> Path:
    stated = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(stated) if stated else Path.home() / ".cache") / "optical-pendulum-rig" / "archives"
