"""Where a remote archive lies: names and files there, read, made and written through fsspec."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from processing.errors import ConfigurationError, RecordError, RigError
from rig.archive.manifest import MANIFEST
from rig.presentation import say

DERIVED = ("merged/", "quarantine/")
"""What may be taken away on one side: it follows from the rest, or is taken away to try again."""


class Bucket:
    """What lies at a URL; names are relative to it.

    Every method raises RecordError where the place cannot be reached.
    """

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self._keeps = True
        with _said_in_a_line(url):
            self._system, self._root = _system(self.url)

    def names(self, folder: str = "") -> set[str]:
        """Names of all files there, or of those in a folder there."""
        with _said_in_a_line(self.url):
            self._system.invalidate_cache()
            found = self._system.find(f"{self._root}/{folder}".rstrip("/"))
            return {path.removeprefix(f"{self._root}/") for path in found}

    def read(self, names: Sequence[str]) -> dict[str, bytes]:
        """The content of files there; one that somebody takes away meanwhile is left out if it is derived."""
        with _said_in_a_line(self.url):
            found = self._system.cat([f"{self._root}/{name}" for name in names], on_error="return")
        read: dict[str, bytes] = {}
        for path, data in found.items():
            name = path.removeprefix(f"{self._root}/")
            if isinstance(data, bytes):
                read[name] = data
            elif not (isinstance(data, FileNotFoundError) and name.startswith(DERIVED)):
                raise RecordError(f"{self.url}/{name}: is listed there and cannot be read: {data!r}")
        if missing := {name for name in names if name not in read and not name.startswith(DERIVED)}:
            raise RecordError(f"{self.url}/{min(missing)}: is listed there and cannot be read")
        return read

    def create(self, name: str, data: bytes) -> bool:
        """Write a file there, whole or not at all; False where one has its name, which stays."""
        with _said_in_a_line(self.url):
            try:
                if not self._keeps:
                    self._system.invalidate_cache()
                    if self._system.exists(f"{self._root}/{name}"):
                        raise FileExistsError
                self._system.pipe_file(f"{self._root}/{name}", data, mode="create")
            except FileExistsError:
                return False
        return True

    def overwrite(self, name: str, data: bytes) -> None:
        """Put a sound file in the place of a damaged one there."""
        with _said_in_a_line(self.url):
            self._system.pipe_file(f"{self._root}/{name}", data)

    def take_away(self, name: str) -> None:
        """Remove a file there, if it is there."""
        with _said_in_a_line(self.url), contextlib.suppress(FileNotFoundError):
            self._system.rm_file(f"{self._root}/{name}")

    def try_to_write_over(self, manifest: bytes) -> None:
        """Ask for what the server must refuse; that it does not is said, and each name is looked for first.

        `manifest` is what it has already: where it is written over, it stays as it is.
        """
        with _said_in_a_line(self.url):
            try:
                self._system.pipe_file(f"{self._root}/{MANIFEST}", manifest, mode="create")
            except FileExistsError:
                self._keeps = True
                return
        self._keeps = False
        say(
            f"{self.url}: the server overwrites files although asked not to (If-None-Match): of two "
            "people who write at once, one may lose data; use it one at a time"
        )


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
