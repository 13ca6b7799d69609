"""LIGHT OFF at random moments, from before a program starts to after it ends: is there light afterwards?

Run as ``python -m tests.benchmarks presses [--quick]`` from the repository. The board is a process of its
own, and so is each program, which nobody has started from the desk; the desk presses as its page does. A
press must leave a trip, whoever has the rig, and nothing may be lit after it until that is acknowledged.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from rig.desk.desk import Desk
from tests.rig.desk.board_process import BoardProcess, board_process
from tests.rig.desk.conftest import write_rig
from tests.rig.desk.test_light_off import SERIAL
from tests.rig.known_rig import known

PATHS = ("session", "align", "balance", "preflight")
ENDS_WITHIN_S = 60.0
LONGEST_S = 9.0
"""A program is there for about so long: it starts, lights, measures, darkens, fits."""
AFTERWARDS_S = 3.0
SHORT = {
    "session.max_duration_s": "3",
    "balance.seconds": "9.1",
    "start.way": '"at once"',
    "laser.when_dark": '"end"',
}


def run(quick: bool = False) -> dict[str, Any]:
    """Presses, and those after which there was light, or no trip; the longest time to dark in s."""
    with tempfile.TemporaryDirectory() as place:
        os.environ["XDG_STATE_HOME"] = place
        with board_process() as board:
            known(board.port)
            return _presses(board, Path(place), 40 if quick else 200)


def _presses(board: BoardProcess, folder: Path, count: int) -> dict[str, Any]:
    config = write_rig(folder, SERIAL.replace("PORT", board.port))
    desk = Desk(config, tuple(f"{key}={value}" for key, value in SHORT.items()))
    desk.follower.start()
    desk.safety.start()
    chance, counts, dark_s = random.Random(50), Counter[str](), []
    try:
        for number in range(count):
            path = PATHS[number % len(PATHS)]
            found = _press(desk, board, folder / f"one-{number}", path, chance.uniform(-0.5, LONGEST_S))
            counts.update(word for word in ("lit before", "lit afterwards", "no trip") if found[word])
            dark_s.append(found["dark_s"])
            print(f"{number:>4} {path:<10} {found}", flush=True)
    finally:
        desk.close()
    return {
        "presses": count,
        "lit when pressed": counts["lit before"],
        "lit afterwards": counts["lit afterwards"],
        "without a trip": counts["no trip"],
        "longest to dark, s": max(dark_s),
    }


def _press(desk: Desk, board: BoardProcess, folder: Path, path: str, at_s: float) -> dict[str, Any]:
    """One press, so long after a program was started; it is ended and acknowledged afterwards."""
    if at_s < 0:
        pressed_ns, was_lit = _pressed(desk, board)
        time.sleep(-at_s)
    program = None if path == "align" else _started(desk, path, folder)
    if program is None:
        _align(desk)
    if at_s >= 0:
        time.sleep(at_s)
        pressed_ns, was_lit = _pressed(desk, board)
    end_s = time.monotonic() + ENDS_WITHIN_S
    if program is not None:
        while program.poll() is None and time.monotonic() < end_s:
            time.sleep(0.05)
        program.kill()
        program.wait()
    else:
        time.sleep(AFTERWARDS_S)
        desk.end_aligning()
    changes = [change for change in board.changes if change[0] > pressed_ns]
    dark_s = next((1e-9 * (at_ns - pressed_ns) for at_ns, power_w in changes if not power_w), 0.0)
    time.sleep(0.3)
    trip = desk.safety.trip
    if trip is not None:
        desk.lighting.acknowledge(trip.number)
        time.sleep(0.3)
    return {
        "at_s": round(at_s, 2),
        "lit before": was_lit,
        "lit afterwards": any(power_w > 0 for _, power_w in changes) or board.lit,
        "no trip": trip is None or desk.safety.trip is not None,
        "dark_s": round(dark_s, 3) if was_lit else 0.0,
    }


def _pressed(desk: Desk, board: BoardProcess) -> tuple[int, bool]:
    pressed_ns, was_lit = time.monotonic_ns(), board.lit
    desk.lighting.off()
    return pressed_ns, was_lit


def _align(desk: Desk) -> None:
    """As the desk does it, which starts nothing while a trip is latched."""
    if desk.safety.trip is None:
        desk.begin_aligning()


def _started(desk: Desk, path: str, folder: Path) -> "subprocess.Popen[bytes]":
    """As somebody starts it at a terminal."""
    words = {
        "session": ["run", str(desk.source), "-o", str(folder)],
        "balance": ["balance", str(desk.source)],
        "preflight": ["doctor", str(desk.source), "--preflight"],
    }[path]
    words += [word for one in desk.overridden() for word in ("--set", one)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-m", "rig", *words], stdin=quiet, stdout=quiet, stderr=quiet)
