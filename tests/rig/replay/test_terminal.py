"""`rig replay` controlled by keys on a pseudo-terminal, and without a terminal."""

import contextlib
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.rig.replay.replay_record import make_record
from tests.rig.view.rrd_contents import measured, scalars

if os.name != "posix":
    pytest.skip("pseudo-terminals are those of POSIX", allow_module_level=True)

import pty
import termios

pytestmark = pytest.mark.timeout(300)

LIMIT_S = 180.0
SECONDS = 60.0


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_record(tmp_path_factory.mktemp("terminal") / "run-1.mcap", SECONDS)


class Terminal:
    """A program at a pseudo-terminal: what it writes there, and keys for it."""

    def __init__(self, *words: str | Path) -> None:
        self.master, slave = pty.openpty()
        self.before = termios.tcgetattr(slave)
        self._slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rig", *map(str, words)],
            stdin=slave,
            stdout=subprocess.PIPE,
            stderr=slave,
            text=True,
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
        return output

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


@pytest.fixture
def terminal(record: Path) -> Iterator[Terminal]:
    started = Terminal("replay", record, "--speed", "0.5")
    yield started
    started.close()


PAUSED = r"paused  (\d+\.\d\d) of 60\.0 s .*? (\d+) frames  (\d+) half-cycles"


def test_pause_step_seek_and_end_by_keys(terminal: Terminal) -> None:
    terminal.wait_for("keys: space pause")
    terminal.wait_for(r"replaying  \d")
    terminal.press(" ")
    frames = int(terminal.wait_for(PAUSED)[2])
    terminal.press("n")
    terminal.wait_for(PAUSED, lambda match: int(match[2]) == frames + 1)
    terminal.press("\x1b[C")
    stepped = terminal.wait_for(PAUSED, lambda match: int(match[2]) == frames + 2)
    terminal.press("+")
    there_s = float(stepped[1]) + 10.0
    forwards = terminal.wait_for(PAUSED, lambda match: abs(float(match[1]) - there_s) < 0.03)
    # nothing was left out on the way; one frame is missing in the record
    assert 499 <= int(forwards[2]) - (frames + 2) <= 500
    terminal.press("h")
    terminal.wait_for(PAUSED, lambda match: int(match[3]) > int(forwards[3]))
    terminal.press("g50")
    terminal.wait_for(r"go to \(seconds from the start, Enter\): 50")
    terminal.press("\r")
    terminal.wait_for(r"paused  50\.00 of ")
    terminal.press("-")
    terminal.wait_for(PAUSED, lambda match: match[1] == "40.00" and match[2] == match[3] == "0")
    terminal.press(" ")
    terminal.wait_for(r"replaying  4\d\.\d\d of ")
    terminal.press("q")
    output = terminal.end()
    assert terminal.process.returncode == 0, terminal.screen
    assert "restarted at 40.00 s by going back: the results are not compared" in output
    assert terminal.settings == terminal.before


def test_ctrl_c_leaves_the_terminal_as_it_was(terminal: Terminal) -> None:
    terminal.wait_for(r"replaying  \d")
    assert terminal.settings != terminal.before
    # the terminal itself sends no signal, since it is nobody's controlling one here
    terminal.process.send_signal(2)
    terminal.end()
    assert terminal.process.returncode == 130
    assert terminal.settings == terminal.before


@pytest.mark.slow
def test_without_a_terminal_there_are_no_keys(record: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "replay.rrd"
    done = subprocess.run(
        [sys.executable, "-m", "rig", "replay", str(record), "--rrd", str(rrd)],
        input="q g 5 \n",
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "equal bit for bit" in done.stdout
    assert "keys:" not in done.stderr
    # and what the live view was told is all of it, though it went as fast as it could
    times_s, values = scalars(rrd, "/deflection/y")
    assert len(times_s) == round(SECONDS * 50) - 1
    assert abs(values[0]) > 100.0
    assert len(measured(rrd, "/amplitude")[0]) >= 25
    assert len(measured(rrd, "/balance/line_angle")[0]) >= 10
