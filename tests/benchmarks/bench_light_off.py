"""Time from LIGHT OFF, pressed in a browser, to dark on the board's clock; a frozen session, a busy desk.

Run as ``python -m tests.benchmarks light_off [--quick]`` from the repository. The board is a process of its
own; its clock and the one that is read just before the click are the system's. What is frozen was stopped
(SIGSTOP) 0.1 s before each click.
"""

import json
import os
import signal
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from processing.errors import RigError
from rig.devices import OrderConnection
from tests.rig.desk.board_process import BoardProcess, board_process
from tests.rig.desk.conftest import write_rig
from tests.rig.desk.desk_page import Page, desk_page
from tests.rig.desk.test_light_off import SERIAL
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser

BUSY_PICTURES = 40
"""Pictures that the page asks for at once, so that the desk's threads and its loop have all hands full."""


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic, in ms."""
    clicks, results = 3 if quick else 10, {}
    with headless_browser() as browser, tempfile.TemporaryDirectory() as place:
        for name in ("session, desk busy", "session frozen, desk busy"):
            took_ms = _series(browser, Path(place) / name.replace(" ", "-"), clicks, "frozen" in name)
            results[name] = {"clicks": clicks, "median": float(np.median(took_ms)), "largest": max(took_ms)}
    return results


def _series(browser: HeadlessBrowser, folder: Path, clicks: int, frozen: bool) -> list[float]:
    """Clicks on one session."""
    took_ms = []
    folder.mkdir()
    # a board may get the port of one before, whose session was killed while it was lit: its rig stays latched
    os.environ["XDG_STATE_HOME"] = str(folder / "state")
    with ExitStack() as stack:
        board = stack.enter_context(board_process())
        config = write_rig(folder, SERIAL.replace("PORT", board.port))
        _, page = stack.enter_context(desk_page(browser, config))
        page.key("3")
        page.click("Start …")
        page.in_dialog()
        # it would take the port of the next series' board
        stack.callback(_signal, folder / "runs", signal.SIGKILL)
        board.wait_lit(True, 120)
        for _ in range(clicks):
            took_ms.append(_clicked(page, board, folder / "runs", frozen))
            print(f"  {took_ms[-1]:.0f} ms", flush=True)
            _ordered_again(folder / "runs", board)
            board.wait_lit(True, 120)
    return took_ms


def _ordered_again(runs: Path, board: BoardProcess) -> None:
    """Acknowledge and ask for light until there is light: a session that was stopped trips once more."""
    end_s = time.monotonic() + 120.0
    with OrderConnection(next(runs.glob("*/.orders.json")).parent) as line:
        while not board.lit:
            assert time.monotonic() < end_s, line.news()["safety"]
            trip = line.news()["safety"]["trip"]
            with suppress(RigError):
                if trip is not None:
                    line.order(f"acknowledge {trip['number']} the benchmark")
                line.order("light")
            time.sleep(0.05)


def _clicked(page: Page, board: BoardProcess, runs: Path, frozen: bool) -> float:
    """Milliseconds from the click to dark."""
    if frozen:
        _signal(runs, signal.SIGSTOP)
        time.sleep(0.1)
    try:
        ask = "fetch('/picture?width=1600&height=1200&n=' + n)"
        page.ask(f"void [...Array({BUSY_PICTURES}).keys()].forEach(n => {ask})")
        x, y = page.ask(
            "(r => [r.x + r.width / 2, r.y + r.height / 2])"
            "(document.getElementById('light-off').getBoundingClientRect())"
        )
        pressed_ns = time.monotonic_ns()
        for kind in ("mousePressed", "mouseReleased"):
            page.browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        return 1e-6 * (board.wait_lit(False) - pressed_ns)
    finally:
        if frozen:
            _signal(runs, signal.SIGCONT)


def _signal(runs: Path, number: signal.Signals) -> None:
    # none is there where its session has ended, whose reason is told by what waits for light
    for orders in runs.rglob(".orders.json"):
        os.kill(int(json.loads(orders.read_text())["pid"]), number)
