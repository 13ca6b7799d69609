"""The commands that the desk starts: processes that speak JSON lines, or go on without it."""

import json
import subprocess
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.terminal import start_python

_LAST_LINES = 200
_OBJECTS = 2000
"""A measured balance has its whole way in them."""
MESSAGES_NAME = "messages.txt"


def start_session(words: list[str], folder: Path) -> "subprocess.Popen[bytes]":
    """Start a command that goes on when the desk ends; what it prints goes into a file in `folder`.

    The file is added to, never written over.
    """
    with (folder / MESSAGES_NAME).open("ab") as messages:
        return start_python("-m", "rig", *words, stdin=subprocess.DEVNULL, stdout=messages, stderr=messages)


class Job:
    """A command that ends with the desk, because its pipes do; it answers in JSON lines.

    `lines` are the last objects it has printed, `said` its other words; `count` numbers the objects.
    `ending`: it was asked to end, and will in a moment.
    """

    def __init__(self, words: list[str]) -> None:
        pipe = subprocess.PIPE
        self._process = start_python(
            "-m", "rig", *words, stdin=pipe, stdout=pipe, stderr=pipe, text=True, encoding="utf-8"
        )
        self.name = words[0]
        self.ending = False
        self.lines: deque[dict[str, Any]] = deque(maxlen=_OBJECTS)
        self.newest: dict[str, dict[str, Any]] = {}
        self.said: deque[str] = deque(maxlen=_LAST_LINES)
        self.count = 0
        for target in (self._read, self._listen):
            threading.Thread(target=target, name=f"job-{self.name}", daemon=True).start()

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def status(self) -> int | None:
        """Its exit status; None while it runs."""
        return self._process.poll()

    def wait(self, limit_s: float) -> bool:
        """Whether it ends within the limit."""
        try:
            self._process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def answer(self, text: str) -> None:
        """A line to its standard input; what has ended hears nothing."""
        with suppress(OSError, ValueError):
            if self._process.stdin is not None:
                self._process.stdin.write(f"{text}\n")
                self._process.stdin.flush()

    def end(self) -> None:
        """As Ctrl-C: it switches off what it has switched on."""
        self.ending = True
        with suppress(OSError):
            self._process.terminate()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                try:
                    found = json.loads(line)
                except ValueError:
                    self.said.append(line.rstrip())
                    continue
                if isinstance(found, dict):
                    self.lines.append(found)
                    self.newest[str(found.get("kind"))] = found
                    self.count += 1
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()

    def _listen(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self.said.append(line.rstrip())
