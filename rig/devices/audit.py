"""The audit log of light, acknowledgements, forced starts, turned weights and brakes: chained lines of JSON.

Each line holds the digest of the line before, so that a missing or altered line is detected.
"""

import datetime
import getpass
import hashlib
import json
import os
import queue
import socket
import threading
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO

from processing.errors import DeviceError, RecordError
from rig.control import SafetyState
from rig.terminal import say

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system, where one program writes at a time
    fcntl = None  # type: ignore[assignment]

AUDIT_NAME = "audit.jsonl"
_MAX_NAMED_FOLDERS = 5
"""Largest number of other folders with a log that a message names."""
_IDLE_S = 1.0
_PATIENCE_S = 5.0
"""Longest wait for the log to be written, so that a hanging disk does not block for longer."""


class AuditEntry(StrEnum):
    """Kinds of entries in the log."""

    LIT = "lit"
    DARK = "dark"
    UNKNOWN = "unknown"
    """Nothing confirms any more that the light is on, or that it is off."""
    TRIP = "trip"
    """A trip has occurred now; a latch without this entry was found when the devices were opened."""
    LATCH = "latch"
    ACKNOWLEDGE = "acknowledge"
    FORCE = "force"
    REFUSED = "refused"
    WEIGHT = "weight turned"
    BRAKE = "brake switched"


class AuditLog:
    """Adds lines to the log of a folder (None: no log), in their order, for a program with this task.

    A thread of its own writes them. A log that cannot be written is reported, and stops nothing.
    """

    def __init__(self, folder: Path | None, operator: str, task: str, state: SafetyState) -> None:
        self._path = None if folder is None else folder.absolute() / AUDIT_NAME
        self._session = {"operator": operator, "task": task}
        self._state = state
        self._queue: queue.Queue[dict[str, object]] = queue.Queue()
        self._starting = threading.Lock()
        self._thread: threading.Thread | None = None

    def append(self, kind: AuditEntry, reason: str, **details: object) -> None:
        """Queue a line for writing; returns at once, in any thread."""
        if self._path is None:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        author = {"user": _user(), "host": socket.gethostname(), **self._session}
        with self._starting:
            self._queue.put({"utc": now, **author, "what": kind, "why": reason, **details})
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="audit", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Wait until everything is written, for at most 5 s."""
        with self._queue.all_tasks_done:
            done = self._queue.all_tasks_done.wait_for(lambda: not self._queue.unfinished_tasks, _PATIENCE_S)
        if not done:
            say(f"{self._path}: the audit log is not written: its disk does not answer", error=True)

    def _write(self) -> None:
        while True:
            try:
                line = self._queue.get(timeout=_IDLE_S)
            except queue.Empty:
                with self._starting:
                    if self._queue.empty():
                        self._thread = None
                        return
                continue
            try:
                self._add(line)
            except (OSError, DeviceError) as error:
                reason = error.strerror if isinstance(error, OSError) else error
                # the terminal may have been closed
                with suppress(OSError):
                    say(f"{self._path}: the audit log cannot be written: {reason or error}", error=True)
            finally:
                self._queue.task_done()

    def _add(self, line: dict[str, object]) -> None:
        path = self._path
        assert path is not None
        path.parent.mkdir(parents=True, exist_ok=True)
        # never through a symbolic link, which could name any file
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        with os.fdopen(os.open(path, flags, 0o644), "r+b") as file:
            if fcntl is not None:
                # where the disk supports no locks, a line that may break the chain is better than no line
                with suppress(OSError):
                    fcntl.flock(file, fcntl.LOCK_EX)
            previous, number = _last_digest_and_count(file)
            text = json.dumps({**line, "before": previous}).encode()
            file.write(text + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._state.note_log(path, number + 1, _digest(text))


def check_log(folder: Path, state: SafetyState) -> list[str]:
    """Faults of the log of a folder: altered or missing lines; empty without faults.

    `state` holds the noted end of the log. Raises RecordError if the log cannot be read.
    """
    path = folder.absolute() / AUDIT_NAME
    try:
        lines = path.read_bytes().splitlines()
    except FileNotFoundError:
        folders = ", ".join(
            sorted(str(log.parent) for log in path.parent.glob(f"*/{AUDIT_NAME}"))[:_MAX_NAMED_FOLDERS]
        )
        raise RecordError(
            f"{path}: there is no log: no program that controls a laser wrote into this folder; "
            + (f"there is one in {folders}" if folders else "name the folder of a session")
        ) from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    faults, chained, digest = [], False, ""
    for number, line in enumerate(lines, start=1):
        try:
            previous = json.loads(line).get("before")
        except (ValueError, AttributeError):
            faults.append(f"line {number} is incomplete")
        else:
            chained = chained or previous is not None
            if chained and previous != digest:
                faults.append(f"before line {number} something is missing, or line {number - 1} was altered")
        digest = _digest(line)
    noted = state.end_of_log(path)
    if noted is not None and noted != (len(lines), digest):
        faults.append(f"it had {noted[0]} lines, and its last line was another one")
    return faults


def _last_digest_and_count(file: BinaryIO) -> tuple[str, int]:
    """Digest of the last line, and the number of lines; an incomplete line is ended."""
    file.seek(0)
    data = file.read()
    if data and not data.endswith(b"\n"):
        file.write(b"\n")
    lines = data.splitlines()
    return (_digest(lines[-1]) if lines else ""), len(lines)


def _digest(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, ImportError, OSError):
        # in a container a user may have a number and no name
        return str(os.getuid()) if hasattr(os, "getuid") else ""
