"""The key and the port of a desk, which it stores in a file, and the locks that make it the only desk."""

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

_NAME = "desk.json"


class _DeskFile(BaseModel, extra="ignore"):
    key: str = Field(default_factory=lambda: secrets.token_urlsafe(24))
    port: int = 0


class DeskStore:
    """Stored key and port of the desk of one configuration.

    If the folder of the file cannot be written, they are kept in memory until the desk ends.
    """

    def __init__(self, source: Path) -> None:
        source = source.resolve()
        digest = hashlib.sha256(str(source).encode()).hexdigest()[:12]
        self._folder = state_folder() / "desks" / f"{source.stem}-{digest}"
        self._source = source
        self._locks: list[IO[str]] = []
        self._stored = _DeskFile()

    def hold(self, output: Path) -> None:
        """Lock the configuration and the folder of its sessions, so that this is their only desk.

        Raises ConfigurationError if another desk holds one of them: both would act on one session.
        """
        where = output.resolve()
        digest = hashlib.sha256(str(where).encode()).hexdigest()[:12]
        refusals = {
            self._folder / "lock": f"{self._source}: it already has an open desk: use OTHER, or end it first",
            self._folder.parent / f"sessions-{digest}.lock": (
                f"session.output = {where}: the desk of another configuration has its sessions there: use "
                "OTHER, or end it, or state another folder"
            ),
        }
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # only this user may read the key
            self._folder.chmod(0o700)
            for path, refusal in refusals.items():
                self._locks.append(path.open("a+", encoding="utf-8"))
                if (other := _holder(self._locks[-1])) is not None:
                    self._locks.pop().close()
                    self.close()
                    raise ConfigurationError(refusal.replace("OTHER", other or "that"))
        except OSError:
            self.close()
            return
        with contextlib.suppress(OSError, ValidationError):
            self._stored = _DeskFile.model_validate_json((self._folder / _NAME).read_bytes())

    def opened_at(self, address: str, port: int) -> None:
        """Write the address into the locks, where a second desk reads it, and store the port."""
        self._stored.port = port
        if self._locks:
            with contextlib.suppress(OSError):
                atomic_write.replace(self._folder / _NAME, self._stored.model_dump_json(indent=1).encode())
        for held in self._locks:
            held.truncate(0)
            held.write(address)
            held.flush()

    def close(self) -> None:
        """Release the locks, so that another desk can start."""
        for held in self._locks:
            held.truncate(0)
            held.close()
        self._locks.clear()

    @property
    def key(self) -> str:
        """The key in the desk's address."""
        return self._stored.key

    @property
    def port(self) -> int:
        """The port of the last desk; 0 if there was none."""
        return self._stored.port


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
