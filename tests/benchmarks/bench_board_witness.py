"""How late the board darkens the laser, with and without its accelerometer, by the firmware on MicroPython.

Run as ``python -m tests.benchmarks board_witness [--quick]``. The interpreter runs in node on this computer,
at one end of a pseudo-terminal; the outputs are logged on the board's clock. ``watchdog``: past the deadline
after the last heartbeat. ``interlock``: from the loop's opening, with the host asking for samples and feeding
the watchdog meanwhile. Cases: no witness; samples that come; a bus that hangs, 5 ms in each look.
"""

import contextlib
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from rig.control.controller import Controller
from rig.control.link import ControllerReset
from tests.rig.control.conftest import PACKAGE, VERSION, micropython_boards, settings_for
from tests.rig.control.wires import FirmwareBoard

_DEADLINE_S = 1.0
_CASES = {"without": (False, b"I"), "samples": (True, b"I"), "bus hangs": (True, b"i")}


def _interpreter(folder: Path) -> Path:
    if shutil.which("npm") is None or shutil.which("node") is None:
        raise SystemExit("node and npm run the MicroPython interpreter: install them")
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), f"{PACKAGE}@{VERSION}"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return folder / "node_modules" / PACKAGE


def _lit(board: FirmwareBoard, witness: bool, bus: bytes, watchdog_s: float) -> Controller:
    board.press(bus + b"c")
    controller = Controller(settings_for(board.port, watchdog_s=watchdog_s, heartbeat_s=0.1), 0.001)
    controller.open()
    board.wait_for(controller.interlock_closed, 10.0)
    if (latch := controller.status().latch) is not None:
        controller.acknowledge(latch.number)
    if witness:
        controller.start_witness()
    controller.laser_on()
    return controller


def _last(board: FirmwareBoard, name: str, value: float) -> int:
    return [ms for ms, said, values in board.events() if said == name and values[0] == value][-1]


def _late(board: FirmwareBoard, witness: bool, bus: bytes) -> tuple[float, float]:
    """ms past the watchdog's deadline, and from an opening of the interlock, until the laser is off."""
    controller = _lit(board, witness, bus, _DEADLINE_S)
    end_s = time.monotonic() + 0.4
    while time.monotonic() < end_s:
        fed_ms = controller.heartbeat().uptime_ms
        if witness:
            controller.witness_samples()
    board.wait_for(lambda: board.outputs()["laser"][0] == 0, 10.0)
    watchdog_ms = _last(board, "laser", 0) - fed_ms - 1e3 * _DEADLINE_S
    controller.close()

    controller = _lit(board, witness, bus, 2.0)
    end_s = time.monotonic() + 0.2
    opened = False
    while board.outputs()["laser"][0]:
        controller.heartbeat()
        if witness:
            controller.witness_samples()
        if not opened and time.monotonic() > end_s:
            opened = True
            # the mark is logged in the turn that sees the keys, which is before the loop looks at the pin
            board.press(b"mo")
    interlock_ms = _last(board, "laser", 0) - _last(board, "mark", 1)
    controller.close()
    return watchdog_ms, interlock_ms


def run(quick: bool = False) -> dict[str, Any]:
    """Median and largest of each case, in ms."""
    repeats = 5 if quick else 30
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with micropython_boards(_interpreter(folder / "npm"), folder) as make:
            board = make()
            late: dict[str, list[tuple[float, float]]] = {case: [] for case in _CASES}
            for repeat in range(repeats):
                # in turns, so that whatever else this computer does is in all of them
                for case, (witness, bus) in _CASES.items():
                    # a busy computer feeds the watchdog too late
                    with contextlib.suppress(ControllerReset):
                        late[case].append(_late(board, witness, bus))
                print(f"  {repeat + 1} of {repeats}", file=sys.stderr)
    for case, each in late.items():
        for which, values in zip(("watchdog", "interlock"), np.array(each).T, strict=True):
            found[f"{case}, {which}"] = {
                "median_ms": float(np.median(values)),
                "p90_ms": float(np.quantile(values, 0.9)),
                "largest_ms": float(values.max()),
                "count": len(values),
            }
    print(found)
    return found
