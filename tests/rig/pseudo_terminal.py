"""A program at a pseudo-terminal, as a person sits at it; POSIX only."""

import contextlib
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.rig.command_line import Done, rig

LIMIT_S = 180.0


class Terminal:
    """`rig` at a pseudo-terminal: what it writes there, and keys for it.

    Its standard output is kept apart, unless it is to be `on_screen`.
    """

    def __init__(self, *words: str | Path, cwd: Path | None = None, on_screen: bool = False) -> None:
        self.master, slave = pty.openpty()
        self.before = termios.tcgetattr(slave)
        self._slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rig", *map(str, words)],
            stdin=slave,
            stdout=slave if on_screen else subprocess.PIPE,
            stderr=slave,
            text=True,
            cwd=cwd,
            start_new_session=True,
        )
        self.screen = ""

    def press(self, keys: str) -> None:
        """Press keys; what was on the screen before is forgotten."""
        self.screen = ""
        os.write(self.master, keys.encode())

    def wait_for(
        self, pattern: str, accept: Callable[[re.Match[str]], bool] = lambda _: True
    ) -> re.Match[str]:
        """Wait until the screen shows something that is accepted; the last place where it stands."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            found = [match for match in re.finditer(pattern, self.screen) if accept(match)]
            if found:
                return found[-1]
            assert time.monotonic() < deadline_s, f"no {pattern!r} in {self.screen[-500:]!r}"
            assert self.process.poll() is None, f"ended before {pattern!r}: {self.screen[-500:]!r}"
            self._read(0.2)

    def end(self) -> str:
        """Wait for the program's end; what it wrote on its standard output."""
        output, _ = self.process.communicate(timeout=LIMIT_S)
        self._read(0.0)
        return output or ""

    @property
    def settings(self) -> list[object]:
        return termios.tcgetattr(self._slave)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()
        os.close(self.master)
        os.close(self._slave)

    def _read(self, wait_s: float) -> None:
        with contextlib.suppress(OSError):
            if select.select([self.master], [], [], wait_s)[0]:
                self.screen += os.read(self.master, 65536).decode(errors="replace")


def rig_at_terminal(*words: str | Path, cwd: Path, columns: int) -> Done:
    """Run a command in this process, whose standard streams are a terminal meanwhile; all is its output."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    shown: list[bytes] = []

    def read() -> None:
        # the terminal's end is an error
        with contextlib.suppress(OSError):
            while data := os.read(master, 65536):
                shown.append(data)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        with _streams_at(slave):
            status = rig(*words, cwd=cwd, captured=False).returncode
    finally:
        os.close(slave)
        reader.join()
        os.close(master)
    return Done(status, b"".join(shown).decode(errors="replace"), "")


@contextlib.contextmanager
def _streams_at(terminal: int) -> Iterator[None]:
    kept = [os.dup(number) for number in range(3)]
    before = sys.stdin, sys.stdout, sys.stderr
    for number in range(3):
        os.dup2(terminal, number)
    try:
        with (
            open(0, closefd=False) as typed,
            open(1, "w", closefd=False) as said,
            open(2, "w", buffering=1, closefd=False) as errors,
        ):
            sys.stdin, sys.stdout, sys.stderr = typed, said, errors
            yield
    finally:
        sys.stdin, sys.stdout, sys.stderr = before
        for number, copy in enumerate(kept):
            os.dup2(copy, number)
            os.close(copy)
