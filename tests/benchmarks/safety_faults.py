"""One fault on one path to light, with the firmware on MicroPython and the program in its own process."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.safety_program import PLACES
from tests.rig.command_line import CONFIGS
from tests.rig.control.wires import FirmwareBoard

LIT_WITHIN_S, DARK_WITHIN_S, ENDED_WITHIN_S = 300.0, 45.0, 300.0
"""What begins and ends may take long on a machine that is busy otherwise; to be dark may not."""
LOOKED_AT_FOR_S = 3.0
"""So long after a fault has gone is waited for a light that nobody asked for."""

CONFIG = """extends = "{demo}"
[session]
output = "{folder}/runs"
max_duration_s = 600
[controller]
kind = "serial"
port = "{port}"
timeout_s = 0.3
watchdog_s = 1.5
[laser]
kind = "controller"
power_w = 0.0005
when_dark = "{when_dark}"
[camera]
frame_rate_hz = 50
[preflight]
when = "never"
[start]
way = "at once"
[simulation]
real_time = true
[simulation.sensor]
width_px = 120
height_px = 640
[simulation.release]
way = "let go"
"""
SIGNALS = {
    "killed": signal.SIGKILL,
    "stopped (SIGSTOP), and goes on": signal.SIGSTOP,
    "told to end (SIGTERM)": signal.SIGTERM,
    "Ctrl-C": signal.SIGINT,
    "terminal closed (SIGHUP)": signal.SIGHUP,
}
KEYS = {
    "interlock opened for 1.5 s": b"mo",
    "interlock opened for 20 ms": b"mb",
    "interlock opened for 20 ms, TRIP line lost": b"mb",
    "interlock opened and left open": b"mo",
    "relay does not close": b"mp",
    "relay stuck closed, then told to end": b"mu",
    "board reset": b"mr",
    "board hangs 2.8 s": b"mhhhh",
}
CABLE = {
    "cable pulled": b"m",
    "cable pulled, put in again": b"m",
    "cable pulled, interlock opened meanwhile, put in again": b"m",
}
PEOPLE_END_IT = ("told to end (SIGTERM)", "Ctrl-C", "terminal closed (SIGHUP)")
"""After these a person need only ask for light again."""


@dataclass(frozen=True)
class Row:
    """What came of a fault.

    `dark_s` is from the fault to the dark on the board's clock, None where there is nothing to measure,
    `relit` how often light came that nobody asked for, `needed` what light took afterwards.
    """

    path: str
    fault: str
    dark_s: float | None
    relit: int
    needed: str
    violation: str = ""

    @property
    def line(self) -> str:
        """Of a table in Markdown."""
        dark = "–" if self.dark_s is None else f"{self.dark_s:.2f}"
        wrong = f" **{self.violation}**" if self.violation else ""
        return f"| {self.path} | {self.fault} | {dark} | {self.needed}{wrong} |"


class Trial:
    """A board, a configuration, and the program that is started on its path."""

    def __init__(self, package: Path, folder: Path, path: str, fault: str, when_dark: str) -> None:
        self.path, self.fault, self.folder = path, fault, folder
        self.board = FirmwareBoard(package, folder, through_wire=True, states=folder / "state")
        self.config = folder / "rig.toml"
        text = CONFIG.format(
            demo=(CONFIGS / "demo.toml").as_posix(), folder=folder, port=self.board.port, when_dark=when_dark
        )
        self.config.write_text(text, encoding="utf-8")
        self.out = folder / "out"
        self.log = folder / "said"

    def start(self, path: str) -> "subprocess.Popen[bytes]":
        """The program on its path, in a place of its own for the state of rigs."""
        words = ["-m", "tests.benchmarks.safety_program", path, str(self.config), str(self.out)]
        words += [self.fault] if self.fault in PLACES else []
        env = {**os.environ, "XDG_STATE_HOME": str(self.folder / "state"), "COLUMNS": "200"}
        with self.log.open("ab") as said:
            return subprocess.Popen(
                [sys.executable, *words], stdin=subprocess.DEVNULL, stdout=said, stderr=said, env=env
            )

    def said(self, since: int = 0) -> str:
        """What the programs have printed after so many bytes."""
        return self.log.read_bytes()[since:].decode(errors="replace")

    @property
    def lit(self) -> bool:
        return bool(self.board.outputs().get("laser", [0.0])[0])

    def lightings(self, since: int) -> int:
        """How often the laser has come on after so many lines of the board's log."""
        states = [values[0] for _, name, values in self.board.events() if name == "laser"]
        before = sum(name == "laser" for _, name, _ in self.board.events()[:since])
        return sum(
            bool(now) and not was for was, now in zip([0.0, *states][before:], states[before:], strict=False)
        )

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            if condition():
                return True
            time.sleep(0.01)
        return condition()


def measured(package: Path, folder: Path, path: str, fault: str, when_dark: str = "wait") -> Row:
    """Do it: light, fault, dark, the fault gone, time, then somebody who asks for light."""
    folder.mkdir(parents=True)
    trial = Trial(package, folder, path, fault, when_dark)
    process = trial.start(path)
    try:
        return _measured(trial, process)
    finally:
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()
        trial.board.close()


def _measured(trial: Trial, process: "subprocess.Popen[bytes]") -> Row:
    board, fault = trial.board, trial.fault
    if trial.path == "doctor":
        process.wait(ENDED_WITHIN_S)
        relit = trial.lightings(0)
        return Row("doctor", fault, None, relit, "–", "lit" * bool(relit))
    if not trial.wait(lambda: trial.lit or process.poll() is not None, LIT_WITHIN_S) or not trial.lit:
        return Row(trial.path, fault, None, 0, "", f"was not lit at all: {trial.said()[-200:]}")
    record = trial.out / "run-1.mcap"
    if trial.path == "run":
        trial.wait(lambda: record.exists() and record.stat().st_size > 60_000, 30.0)
    time.sleep(1.0)
    _begin(trial, process)
    trial.wait(lambda: any(name == "mark" for _, name, _ in board.events()), 2.0)
    if not trial.wait(lambda: not trial.lit or _off_after_mark(board) is not None, DARK_WITHIN_S):
        return Row(trial.path, fault, None, 0, "", f"lit after {DARK_WITHIN_S:g} s")
    dark_s = _off_after_mark(board)
    time.sleep(1.5)
    seen = len(board.events())
    _end(trial, process)
    time.sleep(LOOKED_AT_FOR_S)
    relit = trial.lightings(seen)
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(20.0)
        process.kill()
        process.wait()
    needed, violation = _asked(trial)
    violation = violation or "lit again by itself" * bool(relit)
    if fault not in PEOPLE_END_IT and fault not in PLACES and "acknowledged" not in needed:
        violation = violation or "nobody had to acknowledge"
    return Row(trial.path, fault, dark_s, relit, needed, violation)


def _begin(trial: Trial, process: "subprocess.Popen[bytes]") -> None:
    board, fault = trial.board, trial.fault
    if "TRIP line lost" in fault:
        board.wire.to_host = lambda data: re.sub(rb"![^\n]*TRIP[^\n]*\n", b"", data)
    if fault in KEYS:
        board.press(KEYS[fault])
        if fault.endswith("told to end"):
            time.sleep(0.5)
            process.send_signal(signal.SIGTERM)
        return
    board.press(b"m")
    trial.wait(lambda: any(name == "mark" for _, name, _ in board.events()), 2.0)
    if fault in CABLE:
        board.wire.connected = False
    else:
        process.send_signal(SIGNALS.get(fault, signal.SIGUSR1))


def _end(trial: Trial, process: "subprocess.Popen[bytes]") -> None:
    """The fault goes, as far as it can."""
    board, fault = trial.board, trial.fault
    if fault == "interlock opened for 1.5 s":
        board.press(b"c")
    if "interlock opened meanwhile" in fault:
        board.press(b"o")
        time.sleep(0.3)
        board.press(b"c")
        time.sleep(0.2)
    if "put in again" in fault:
        board.wire.connected = True
    if fault.startswith("stopped"):
        process.send_signal(signal.SIGCONT)


def _asked(trial: Trial) -> tuple[str, str]:
    """What another program needs to light afterwards; a fault that is still there is taken away first."""
    trial.board.wire.connected = True
    if trial.fault == "interlock opened and left open":
        trial.board.press(b"c")
    trial.board.press(b"f")
    heard, seen = trial.log.stat().st_size, len(trial.board.events())
    asking = trial.start("ask")
    try:
        asking.wait(ENDED_WITHIN_S)
    except subprocess.TimeoutExpired:
        asking.kill()
        asking.wait()
    said = trial.said(heard)
    lit = trial.lightings(seen)
    if "REFUSED trip" in said:
        cause = re.search(r"trip \d+ \((\w+)\)", said)
        by = f"asked, acknowledged ({cause.group(1) if cause else '?'})"
        return by, "" if "LIT" in said and lit == 1 else "not lit after acknowledging: " + said[-200:]
    return ("asked", "") if "LIT" in said else ("", "not lit: " + said[-200:])


def _off_after_mark(board: FirmwareBoard) -> float | None:
    """Seconds from the mark to the first darkness behind it, on the board's clock."""
    mark_ms = None
    for ms, name, values in board.events():
        if name == "mark":
            mark_ms = ms
        elif mark_ms is not None and ((name == "laser" and not values[0]) or name in ("boot", "all_off")):
            return max(ms - mark_ms, 0) / 1000.0
    return None
