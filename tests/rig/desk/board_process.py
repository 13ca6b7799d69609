"""The controller's board in a process of its own, behind a pseudo-terminal, with an interlock to open.

Prints the port, then a line for each change of the laser: its power in W and the time in ns (monotonic, one
for all processes). Lines on standard input: `open`, `close` (the interlock). Killed, it is gone.
"""

import contextlib
import os
import pty
import select
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

from rig.control.simulated import SimulatedBoard
from tests.rig.known_rig import known


class BoardProcess:
    """A started board; `changes` are (time in ns, power in W) of its laser."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.rig.desk.board_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).resolve().parents[3],
        )
        assert self._process.stdout is not None
        self.port = self._process.stdout.readline().strip()
        known(self.port)
        self.changes: list[tuple[int, float]] = []
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def lit(self) -> bool:
        return bool(self.changes) and self.changes[-1][1] > 0

    def interlock(self, closed: bool) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("close\n" if closed else "open\n")
        self._process.stdin.flush()

    def wait_lit(self, lit: bool, limit_s: float = 60.0) -> int:
        """Until the laser is lit, or dark; the time of the change in ns."""
        deadline_s = time.monotonic() + limit_s
        while self.lit is not lit:
            assert time.monotonic() < deadline_s, f"never {'lit' if lit else 'dark'}: {self.changes}"
            time.sleep(0.005)
        return self.changes[-1][0]

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with contextlib.suppress(ValueError):
            for line in self._process.stdout:
                power, at_ns = line.split()
                self.changes.append((int(at_ns), float(power)))


@contextlib.contextmanager
def board_process() -> Iterator[BoardProcess]:
    """A board until the context ends."""
    board = BoardProcess()
    try:
        yield board
    finally:
        board.close()


def main() -> None:
    """Be the board."""
    closed = threading.Event()
    closed.set()
    last = 0.0

    def laser(power_w: float) -> None:
        nonlocal last
        if power_w != last:
            last = power_w
            print(power_w, time.monotonic_ns(), flush=True)

    def listen() -> None:
        for line in sys.stdin:
            closed.clear() if line.strip() == "open" else closed.set()

    master, slave = pty.openpty()
    tty.setraw(slave)
    board = SimulatedBoard(None, laser, closed.is_set)
    line = board.open_line()
    print(os.ttyname(slave), flush=True)
    threading.Thread(target=listen, daemon=True).start()

    def answer() -> None:
        while True:
            data = line.read(1.0)
            # a host that does not read loses what the board says, as over USB
            if data and select.select([], [master], [], 0)[1]:
                os.write(master, data)

    threading.Thread(target=answer, daemon=True).start()
    while True:
        line.write(os.read(master, 4096))


if __name__ == "__main__":
    main()
