"""A disk that knows no locks, as of some network file systems: every one is refused with ENOLCK."""

import errno
import os

import pytest

NO_LOCKS = os.strerror(errno.ENOLCK)


def without_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on no file can be locked; skips where the system has no such locks."""
    fcntl = pytest.importorskip("fcntl")

    def refused(_file: object, _how: int) -> None:
        raise OSError(errno.ENOLCK, NO_LOCKS)

    monkeypatch.setattr(fcntl, "flock", refused)
