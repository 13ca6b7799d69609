"""Whether a record is being written: its writer holds a lock on it, which ends with the process."""

import os
import time
from pathlib import Path
from typing import Any

fcntl: Any
try:
    import fcntl
except ImportError:
    # Windows has no such locks
    fcntl = None

_STILL_S = 30.0
"""Without locks, a file that has not changed for so long is written by nobody."""


def lock_for_writing(number: int) -> None:
    """Hold the lock of an open file, as long as it is open; nothing where the system or its disk has none."""
    if fcntl is not None:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return


def is_being_written(path: Path) -> bool:
    """Whether a living process writes this file."""
    try:
        number = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        if fcntl is not None:
            fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return False
    except BlockingIOError:
        return True
    except OSError:
        pass
    finally:
        os.close(number)
    return time.time() - path.stat().st_mtime < _STILL_S
