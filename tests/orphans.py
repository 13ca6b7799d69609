"""Ends whatever was started from a process that has ended, however it ended; the tests' own guard on Linux.

A test that is killed cannot end its helpers, a desk, a browser or a session in a session of its own. Each
process started from here inherits a mark in its environment, and so do those that it starts; a guard waits
until the process that set the mark is gone and kills all that still carry it.
"""

import os
import select
import signal
import subprocess
import sys
import time
import uuid
from contextlib import suppress
from pathlib import Path

_MARK = "RIG_STARTED_FROM"


def leave_no_orphans() -> None:
    """From here on, what this process starts ends with it. Does nothing where there is no /proc."""
    if not sys.platform.startswith("linux"):
        return
    before = {key: value for key, value in os.environ.items() if key != _MARK}
    os.environ[_MARK] = uuid.uuid4().hex
    subprocess.Popen(
        [sys.executable, "-I", "-S", __file__, str(os.getpid()), os.environ[_MARK]],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # neither Ctrl-C nor the end of the one that it guards may end it before
        start_new_session=True,
        env=before,
    ).returncode = 0  # nobody waits for it, which is no warning


def marked(mark: str) -> list[int]:
    """Processes that carry a mark."""
    found, wanted = [], f"{_MARK}={mark}".encode()
    for place in Path("/proc").iterdir():
        # one that has just ended, or somebody else's
        with suppress(OSError):
            if place.name.isdigit() and wanted in (place / "environ").read_bytes().split(b"\0"):
                found.append(int(place.name))
    return found


def main(guarded: int, mark: str) -> None:
    """Wait for the end of the guarded process, then end what it has left."""
    with suppress(OSError):
        ended = os.pidfd_open(guarded)
        # gone before, and its number may be another's
        if os.getppid() == guarded:
            select.select([ended], [], [])
    while left := marked(mark):
        for process in left:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.05)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
