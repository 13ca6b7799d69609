"""The key and the port of a desk, which it stores in a file, and the lock that makes it the only desk."""

import contextlib
import hashlib
import secrets
from pathlib import Path
from typing import IO

from pydantic import BaseModel, Field, ValidationError

from acquisition import atomic_write
from processing.errors import ConfigurationError
from rig.control import state_folder

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; two desks of a configuration are then not prevented
    fcntl = None  # type: ignore[assignment]


class _DeskFile(BaseModel, extra="ignore"):
    key: str = Field(default_factory=lambda: secrets.token_urlsafe(24))
    port: int = 0


class DeskStore:
    """Stored key and port of the desk of one configuration.

    If the folder of the file cannot be written, they are kept in memory until the desk ends.
    """

    def __init__(self, source: Path) -> None:
        self._desks = state_folder() / "desks"
        self._path = self._desks / f"{source.stem}-{_digest(source)}.json"
        self._held: IO[str] | None = None
        self._stored = _DeskFile()

    def hold(self, output: Path) -> None:
        """Lock the folder of the sessions, so that this is their only desk, and read what is stored.

        Raises ConfigurationError if another desk holds it: both would act on one session.
        """
        try:
            self._desks.mkdir(parents=True, exist_ok=True)
            # only this user may read the keys
            self._desks.chmod(0o700)
            self._held = (self._desks / f"sessions-{_digest(output)}.lock").open("a+", encoding="utf-8")
            if (other := _holder(self._held)) is not None:
                self._held.close()
                self._held = None
                raise ConfigurationError(
                    f"session.output = {output.resolve()}: it already has an open desk: use "
                    f"{other or 'that'}, or end it, or state another folder"
                )
            self._stored = _DeskFile.model_validate_json(self._path.read_bytes())
        except (OSError, ValidationError):
            return

    def opened_at(self, address: str, port: int) -> None:
        """Write the address into the lock, where a second desk reads it, and store the port."""
        self._stored.port = port
        if self._held is not None:
            with contextlib.suppress(OSError):
                atomic_write.replace(self._path, self._stored.model_dump_json(indent=1).encode())
            self._held.truncate(0)
            self._held.write(address)
            self._held.flush()

    def close(self) -> None:
        """Release the lock, so that another desk can start."""
        if self._held is not None:
            self._held.truncate(0)
            self._held.close()
            self._held = None

    @property
    def key(self) -> str:
        """The key in the desk's address."""
        return self._stored.key

    @property
    def port(self) -> int:
        """The port of the last desk; 0 if there was none."""
        return self._stored.port


def _digest(path: Path) -> str:
    return hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]


def _holder(held: IO[str]) -> str | None:
    """Lock a file; if another program holds the lock, its content, the other desk's address.

    None if the lock is ours, or if the disk knows no locks.
    """
    if fcntl is None:
        return None
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        held.seek(0)
        return held.read().strip()
    except OSError:
        return None
    return None
