"""The address of a desk with its key, in a file that is also the lock: a folder of sessions has one desk."""

import contextlib
import hashlib
import re
import secrets
from pathlib import Path
from typing import IO

from processing.errors import ConfigurationError
from rig.control import state_folder

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; two desks of a folder are then not prevented
    fcntl = None  # type: ignore[assignment]

_ADDRESS = re.compile(r"http://[^/]*:(\d+)/\?key=([\w-]+)")


class DeskStore:
    """`key` of the address and `port` of the desk of a folder of sessions; port 0 before the first desk.

    If the file cannot be written, they are in memory only, until the desk ends.
    """

    def __init__(self) -> None:
        self._file: IO[str] | None = None
        self.key, self.port = secrets.token_urlsafe(24), 0

    def hold(self, output: Path) -> None:
        """Lock the folder of the sessions, so that this is their only desk, and read the last address.

        Raises ConfigurationError if another desk holds it: both would act on one session.
        """
        folder = state_folder() / "desks"
        name = hashlib.sha256(str(output.resolve()).encode()).hexdigest()[:12]
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            # only this user may read the keys
            folder.chmod(0o700)
            self._file = (folder / f"sessions-{name}").open("a+", encoding="utf-8")
            self._file.seek(0)
            address = self._file.read()
            if not _lock(self._file):
                self.close()
                raise ConfigurationError(
                    f"session.output = {output.resolve()}: it already has an open desk: use "
                    f"{address or 'that'}, or end it, or state another folder"
                )
            if last := _ADDRESS.fullmatch(address):
                self.port, self.key = int(last[1]), last[2]

    def opened_at(self, address: str) -> None:
        """Write the address, which a second desk names and the next desk takes again."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.truncate(0)
                self._file.write(address)
                self._file.flush()

    def close(self) -> None:
        """Release the lock, so that another desk can start."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _lock(file: IO[str]) -> bool:
    """Lock a file; returns whether no other desk has locked it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # the disk knows no locks
        pass
    return True
