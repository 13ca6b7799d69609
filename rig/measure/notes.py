"""What operators note while a session runs: kept on the disk at once, and taken into the run's record."""

import json
import os
import threading
import time
from collections import deque
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from processing.errors import RigError

NOTES_NAME = "notes.jsonl"
_MOST_CHARACTERS = 2000


class Typed(NamedTuple):
    """A note; `host_time_ns` is the computer's monotonic clock."""

    host_time_ns: int
    author: str
    text: str


class Notes:
    """Takes notes from any thread; `take` is called by that of the run.

    Each is in `notes.jsonl` in the session's folder before `write` returns, so that none is lost between
    runs, or with a run that is not recorded. `author` is the session's operator.
    """

    def __init__(self, folder: Path, author: str) -> None:
        self._path, self._author = folder / NOTES_NAME, author
        self._typed: deque[Typed] = deque()
        self._writing = threading.Lock()

    def write(self, text: str) -> str:
        """Note a line; returns what was done. Raises RigError for none, or where it cannot be kept."""
        text, author = " ".join(text.split()), self._author
        if not text:
            raise RigError("an empty note: type some text")
        if len(text) > _MOST_CHARACTERS:
            raise RigError(f"a note of {len(text)} characters: at most {_MOST_CHARACTERS}; split it in two")
        typed = Typed(time.monotonic_ns(), author, text)
        utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"utc": utc, "author": author, "text": text}, ensure_ascii=False)
        with self._writing:
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(f"{line}\n")
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                raise RigError(f"{self._path}: the note cannot be kept: {error.strerror or error}") from None
            self._typed.append(typed)
        return f"noted: {text}"

    def take(self) -> list[Typed]:
        """The notes since the last call, oldest first."""
        found = []
        while self._typed:
            found.append(self._typed.popleft())
        return found
