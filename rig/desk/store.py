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


class _Stored(BaseModel, extra="ignore"):
    key: str = Field(default_factory=lambda: secrets.token_urlsafe(24))
    port: int = 0


class DeskStore:
    """Stored `key` of the address and `port` of the desk of one configuration; 0 before the first desk.

    If the folder of the file cannot be written, they are in memory only, until the desk ends.
    """

    def __init__(self, source: Path) -> None:
        self._folder = state_folder() / "desks"
        self._path = self._folder / f"{source.stem}-{_digest(source)}.json"
        self._lock: IO[str] | None = None
        self.key, self.port = _Stored().key, 0

    def hold(self, output: Path) -> None:
        """Lock the folder of the sessions, so that this is their only desk, and read what is stored.

        Raises ConfigurationError if another desk holds it: both would act on one session.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # only this user may read the keys
            self._folder.chmod(0o700)
            self._lock = (self._folder / f"sessions-{_digest(output)}.lock").open("a+", encoding="utf-8")
            if (address := _address_of_holder(self._lock)) is not None:
                self._lock.close()
                self._lock = None
                raise ConfigurationError(
                    f"session.output = {output.resolve()}: it already has an open desk: use "
                    f"{address or 'that'}, or end it, or state another folder"
                )
            stored = _Stored.model_validate_json(self._path.read_bytes())
            self.key, self.port = stored.key, stored.port
        except (OSError, ValidationError):
            return

    def opened_at(self, address: str, port: int) -> None:
        """Write the address into the lock, where a second desk reads it, and store the port."""
        self.port = port
        if self._lock is not None:
            stored = _Stored(key=self.key, port=port)
            with contextlib.suppress(OSError):
                atomic_write.replace(self._path, stored.model_dump_json(indent=1).encode())
            self._lock.truncate(0)
            self._lock.write(address)
            self._lock.flush()

    def close(self) -> None:
        """Release the lock, so that another desk can start."""
        if self._lock is not None:
            self._lock.truncate(0)
            self._lock.close()
            self._lock = None


def _digest(path: Path) -> str:
    return hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]


def _address_of_holder(lock: IO[str]) -> str | None:
    """Lock a file; returns its content, the address, if another desk holds the lock, else None."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        return lock.read().strip()
    except OSError:
        # the disk knows no locks
        pass
    return None
