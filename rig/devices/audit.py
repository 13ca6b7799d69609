"""The audit log: who lit, forced, acknowledged and turned what; a line of JSON each, only ever added to."""

import datetime
import getpass
import json
import os
import socket
from pathlib import Path

from rig.presentation import say

AUDIT_NAME = "audit.jsonl"


def append(folder: Path, what: str, **details: object) -> None:
    """Add a line to the log of a folder; a log that cannot be written is said, and stops nothing."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    line = {"utc": now, "user": _user(), "host": socket.gethostname(), "what": what, **details}
    path = folder / AUDIT_NAME
    # never through a symbolic link, which could name any file
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(path, flags, 0o644), "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
    except OSError as error:
        say(f"{path}: the audit log cannot be written: {error.strerror or error}", error=True)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, ImportError, OSError):
        # a number without a name, as in a container
        return str(os.getuid()) if hasattr(os, "getuid") else ""
