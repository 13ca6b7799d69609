"""What a desk keeps on disk: its key and port; and its lock."""

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
    """Of one configuration. Where its folder cannot be written it is in memory, as long as the desk lives."""

    def __init__(self, source: Path) -> None:
        source = source.resolve()
        digest = hashlib.sha256(str(source).encode()).hexdigest()[:12]
        self._folder = state_folder() / "desks" / f"{source.stem}-{digest}"
        self._source = source
        self._lock: IO[str] | None = None
        self._of_output: IO[str] | None = None
        self._stored = _DeskFile()

    def hold(self, output: Path) -> None:
        """Be the only desk of this configuration, and of the folder where its sessions are.

        Raises ConfigurationError where another one is: two would both act on one session.
        """
        where = output.resolve()
        digest = hashlib.sha256(str(where).encode()).hexdigest()[:12]
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # nobody else reads what is in it
            self._folder.chmod(0o700)
            held = (self._folder / "lock").open("a+", encoding="utf-8")
            of_output = (self._folder.parent / f"sessions-{digest}.lock").open("a+", encoding="utf-8")
        except OSError:
            return
        if (other := _locked(held)) is not None:
            of_output.close()
            raise ConfigurationError(
                f"{self._source}: it already has an open desk: use {other or 'that'}, or end it first"
            )
        if (other := _locked(of_output)) is not None:
            held.close()
            raise ConfigurationError(
                f"session.output = {where}: the desk of another configuration has its sessions there: use "
                f"{other or 'that'}, or end it, or state another folder"
            )
        self._lock, self._of_output = held, of_output
        with contextlib.suppress(OSError, ValidationError):
            self._stored = _DeskFile.model_validate_json((self._folder / _NAME).read_bytes())

    def opened_at(self, address: str, port: int) -> None:
        """Tell the next desk where this one is, and take its port again the next time."""
        self._stored.port = port
        if self._lock is not None:
            with contextlib.suppress(OSError):
                atomic_write.replace(self._folder / _NAME, self._stored.model_dump_json(indent=1).encode())
        for held in (self._lock, self._of_output):
            if held is not None:
                held.truncate(0)
                held.write(address)
                held.flush()

    def close(self) -> None:
        """Let another desk in."""
        for held in (self._lock, self._of_output):
            if held is not None:
                held.truncate(0)
                held.close()
        self._lock = self._of_output = None

    @property
    def key(self) -> str:
        """The key in the desk's address."""
        return self._stored.key

    @property
    def port(self) -> int:
        """The port of the last desk; 0 if there was none."""
        return self._stored.port


def _locked(held: IO[str]) -> str | None:
    """Lock the file; what stands in it, and closes it, where another program has. None, too, where the disk
    knows no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        held.seek(0)
        said = held.read().strip()
        held.close()
        return said
    except OSError:
        return None
    return None
