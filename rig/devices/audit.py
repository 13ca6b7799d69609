"""The audit log: lines of JSON on light, acknowledgements, forced starts, turned weights and brakes."""

import datetime
import getpass
import json
import os
import queue
import socket
import threading
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from rig.control import run_in_thread
from rig.terminal import say

AUDIT_NAME = "audit.jsonl"
_MAX_WRITE_S = 5.0
"""Longest wait for the log to be written, so that a hanging disk does not block for longer."""


class AuditEntry(StrEnum):
    """Kinds of entries in the log."""

    LIT = "lit"
    DARK = "dark"
    UNKNOWN = "unknown"
    """Nothing confirms any more that the light is on, or that it is off."""
    TRIP = "trip"
    """A trip has occurred now; a latch without this entry was there when the devices were opened."""
    LATCH = "latch"
    ACKNOWLEDGE = "acknowledge"
    FORCE = "force"
    REFUSED = "refused"
    WEIGHT = "weight turned"
    BRAKE = "brake switched"


class AuditLog:
    """Adds lines to the log of a folder (None: no log), in their order, for a program with this task.

    Threads of their own write them. A log that cannot be written is reported, and stops nothing.
    """

    def __init__(self, folder: Path | None, operator: str, task: str) -> None:
        self._path = None if folder is None else folder.absolute() / AUDIT_NAME
        self._session = {"operator": operator, "task": task}
        self._queue: queue.Queue[dict[str, object]] = queue.Queue()
        self._write_lock = threading.Lock()

    def append(self, kind: AuditEntry, reason: str, **details: object) -> None:
        """Queue a line for writing; returns at once, in any thread."""
        if self._path is None:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        author = {"user": _user(), "host": socket.gethostname(), **self._session}
        self._queue.put({"utc": now, **author, "what": kind, "why": reason, **details})
        run_in_thread(self._write)

    def wait(self) -> None:
        """Wait until everything is written, for at most 5 s."""
        done = self._queue.all_tasks_done
        with done:
            written = done.wait_for(lambda: not self._queue.unfinished_tasks, _MAX_WRITE_S)
        if not written:
            say(f"{self._path}: the audit log is not written: its disk does not answer", error=True)

    def _write(self) -> None:
        # one thread for each line that was queued, which writes the oldest
        with self._write_lock:
            line = self._queue.get()
            try:
                self._add(line)
            except OSError as error:
                # the terminal may have been closed
                with suppress(OSError):
                    reason = error.strerror or error
                    say(f"{self._path}: the audit log cannot be written: {reason}", error=True)
            finally:
                self._queue.task_done()

    def _add(self, line: dict[str, object]) -> None:
        path = self._path
        assert path is not None
        path.parent.mkdir(parents=True, exist_ok=True)
        # never through a symbolic link, which could name any file
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        with os.fdopen(os.open(path, flags, 0o644), "r+b") as file:
            line_bytes = json.dumps(line).encode() + b"\n"
            # a line that was cut, by a full disk or a power cut, is ended
            if end := file.seek(0, os.SEEK_END):
                file.seek(end - 1)
                line_bytes = line_bytes if file.read(1) == b"\n" else b"\n" + line_bytes
            # one write, so that two programs do not mix their lines
            file.write(line_bytes)
            file.flush()
            os.fsync(file.fileno())


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, ImportError, OSError):
        # in a container a user may have a number and no name
        return str(os.getuid()) if hasattr(os, "getuid") else ""
