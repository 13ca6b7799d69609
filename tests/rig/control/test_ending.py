"""If `rig run` is killed or loses its terminal, laser and magnet are off and the record is complete."""

import json
import os
import pty
import select
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from tests.rig.command_line import CONFIGS
from tests.rig.control.wires import FirmwareBoard

pytestmark = pytest.mark.slow

# For a machine that is busy with other tests.
BEGUN_WITHIN_S = 300.0
ENDED_WITHIN_S = 120.0
LOOKED_AT_EVERY_S = 0.5
POWER_W = 0.0005
# An own session whose terminal is standard input, as a login shell has it.
IN_A_TERMINAL = (
    "import fcntl, os, sys, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
)


def command(folder: Path, board: FirmwareBoard, **changes: str) -> list[str]:
    """`rig run` on the simulated camera in real time, with laser and magnet at the real firmware."""
    values = {
        "controller.kind": '"serial"',
        "controller.port": json.dumps(board.port),
        "controller.timeout_s": "0.3",
        "laser.kind": '"controller"',
        "laser.power_w": str(POWER_W),
        "laser.warm_up_max_s": "600",
        "simulation.real_time": "true",
        "simulation.sensor.width_px": "120",
        "simulation.sensor.height_px": "640",
        "camera.frame_rate_hz": "25",
        "preflight.when": '"never"',
        "instrument.kind": '"tomlinson"',
        **{key.replace("__", "."): value for key, value in changes.items()},
    }
    words = [word for key, value in values.items() for word in ("--set", f"{key}={value}")]
    return ["-m", "rig", "run", str(CONFIGS / "demo.toml"), "-o", str(folder), *words]


@contextmanager
def running(words: list[str], log: Path) -> Iterator["subprocess.Popen[bytes]"]:
    with log.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, *words], stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def lit(board: FirmwareBoard) -> bool:
    return board.outputs().get("laser") == [1, POWER_W]


def being_recorded(board: FirmwareBoard, record: Path) -> bool:
    return lit(board) and record.exists() and spots_in(record) > 20


def spots_in(record: Path) -> int:
    """So far: what a record holds beside them is no measure of it."""
    try:
        with RecordReader(record) as reader:
            return len(reader.spots())
    except RecordError:
        return 0


def wait_for(board: FirmwareBoard, condition: Callable[[], bool], log: Path) -> None:
    try:
        board.wait_for(condition, BEGUN_WITHIN_S, LOOKED_AT_EVERY_S)
    except AssertionError as error:
        raise AssertionError(f"{error}; {log.read_text()[-2000:]}") from None


def assert_closed_and_dark(board: FirmwareBoard, folder: Path, reason: str) -> None:
    # at once, not when the watchdog of 5 s would have done it
    assert board.is_safe
    with RecordReader(folder / "run-1.mcap") as reader:
        assert not reader.truncated
        assert len(reader.spots()) > 20
        assert reader.events()[-1].text == reason
    (entry,) = json.loads((folder / "session.json").read_text())["entries"]
    assert (entry["state"], entry["reason"]) == ("stopped", reason)
    # nothing is fitted: who sends SIGTERM may send SIGKILL next
    assert not (folder / "results.json").exists()


def test_terminal_that_is_closed_sends_a_hangup(board: FirmwareBoard, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (24, 80))
    process = subprocess.Popen(
        [sys.executable, "-c", IN_A_TERMINAL, *command(folder, board, controller__watchdog_s="5.0")],
        stdin=slave,
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)
    shown = b""

    def recorded() -> bool:
        nonlocal shown
        while select.select([master], [], [], 0)[0]:
            shown += os.read(master, 65536)
        assert process.poll() is None, shown[-2000:]
        return being_recorded(board, folder / "run-1.mcap")

    try:
        board.wait_for(recorded, BEGUN_WITHIN_S, LOOKED_AT_EVERY_S)
        assert b"half-cycles" in shown
        os.close(master)
        assert process.wait(ENDED_WITHIN_S) == 130
    finally:
        process.kill()
        process.wait()
    assert_closed_and_dark(board, folder, "terminated: the terminal was closed")
