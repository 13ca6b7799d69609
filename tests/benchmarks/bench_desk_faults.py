"""Thirty faults at the desk: how long each takes to be an alarm on the page, with its cause and its remedy.

Run as ``python -m tests.benchmarks desk_faults [--quick]`` from the repository. Desk, sessions and browser
are processes of their own. A session of the simulated rig in real time gets the faults that the rig can
have; one that only tells (`told_session`) those that it cannot; desk and browser get theirs from outside.
"""

import contextlib
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rig.alarms import CATALOGUE, AlarmKey
from rig.orders import ORDERS_NAME, Line, NoSession
from tests.benchmarks.told_session import BEGUN
from tests.rig.desk.conftest import RIG
from tests.rig.desk.desk_page import DeskProcess, Page
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser

ASKED_S = 3.0
_LIMIT_S = 30.0
_LARGEST_KIB = 4608
"""Of a file, in place of a full disk; what a record reserves at its start fits in."""
_NEAR_KIB = 128
"""Before its end, a few writes."""
_LONGEST_S = 240.0
LASER = """
[controller]
watchdog_s = 5.0
[laser]
kind = "controller"
max_power_w = 0.001
power_w = 0.0009
when_dark = "wait"
[preflight]
when = "never"
"""
TIMED = {
    AlarmKey.CAMERA: (
        10.0,
        "frames do not come for 4 s",
        "frames_stalled_at_s = 10\nframes_stalled_duration_s = 4",
    ),
    AlarmKey.SPOT: (20.0, "the laser's light fades", "laser_fades_at_s = 20\nlaser_fade_duration_s = 6"),
    AlarmKey.CAMERA_CLOCK: (32.0, "the camera's clock steps", "clock_steps_at_s = 32"),
    AlarmKey.INTERLOCK: (40.0, "the interlock opens", "interlock_opens_at_s = 40\ninterlock_open_for_s = 6"),
}
"""Of the simulated rig: when, what, and how it is configured."""
TOLD: tuple[tuple[AlarmKey, str, dict[str, Any]], ...] = (
    (AlarmKey.DISK_HANGS, "a write hangs", {"state": {"alarm": "the disk", "disk_silent_s": 2.5}}),
    (AlarmKey.STALLED, "a thread of the run stalls", {"state": {"alarm": "processing has stalled"}}),
    (AlarmKey.LASER_DARK, "the laser is dark", {"state": {"alarm": "dark"}, "news": {"darkness": "a trip"}}),
    (
        AlarmKey.DISK_FORECAST,
        "the disk will be full",
        {"state": {"disk_free_bytes": 1e8, "record_bytes_per_s": 1e6, "remaining_s": 3600.0}},
    ),
    (
        AlarmKey.PREFLIGHT,
        "preflight says no-go",
        {"state": {"phase": "preflight"}, "news": {"preflight": [{"name": "spot", "ok": False}]}},
    ),
    (AlarmKey.CONTROLLER, "the controller is unplugged", {"news": {"devices": {"controller": "lost"}}}),
    (
        AlarmKey.LIGHT_DISAGREES,
        "light although it is commanded off",
        {
            "news": {
                "safety": {
                    "light": "commanded off, but its output or its light is seen to be on",
                    "light_age_s": 0.0,
                }
            }
        },
    ),
    (
        AlarmKey.TRIP,
        "a trip",
        {"news": {"safety": {"trip": {"number": 5, "cause": "WATCHDOG", "why": "it ran out", "lit": True}}}},
    ),
    (
        AlarmKey.LASER_UNKNOWN,
        "the laser does not answer",
        {
            "news": {
                "devices": {"laser": {"light": "does not answer"}},
                "safety": {"light": "does not answer", "light_age_s": 0.0},
            }
        },
    ),
    (AlarmKey.SPOT, "the beam is blocked", {"lost": True}),
    (AlarmKey.CAMERA, "the camera is unplugged", {"event": ["camera lost", "usb3vision: unplugged"]}),
    (AlarmKey.CAMERA, "frames stop, and nothing says so", {"frames": False}),
    (AlarmKey.FRAMES, "frames are lost", {"event": ["gap", "12 frames are missing"]}),
    (AlarmKey.BACKLOG, "the processor is late", {"event": ["backlog", "300 frames wait"]}),
    (AlarmKey.HOST_CLOCK, "the computer's clock is set", {"event": ["clock step", "by +3600 s"]}),
    (AlarmKey.SENSOR, "a sensor is lost", {"event": ["sensor", "port /dev/ttyUSB1 is gone"]}),
    (AlarmKey.REST_STEP, "the mirror is touched", {"event": ["rest step", "by +12 arcsec"]}),
    (AlarmKey.LIGHT_STEP, "a lamp is switched on", {"event": ["light step", "by +12 DN"]}),
    (AlarmKey.PUSH, "a draught", {"event": ["push", "by 3 arcsec"]}),
    (AlarmKey.REJECTED, "a start is not accepted", {"event": ["rejected", "amplitude too small"]}),
    (AlarmKey.LIVE_FIT, "the live fit fails", {"event": ["posterior", "no longer fitted"]}),
    (AlarmKey.WATCHER, "the view fails", {"event": ["watcher failed", "the view"]}),
    (AlarmKey.ENVIRONMENT, "the sensor of the air is silent", {"state": {"temperature_c": None}}),
)
"""What a session tells: alarm, fault, and the words."""
_WELL = {
    "state": {
        **BEGUN,
        "alarm": "",
        "disk_silent_s": 0.0,
        "disk_free_bytes": None,
        "record_bytes_per_s": None,
        "remaining_s": None,
    },
    "news": {"darkness": "", "preflight": [], "devices": {}, "safety": {}},
    "lost": False,
    "frames": True,
}


class Table:
    """The measured faults."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.rows: list[tuple[str, AlarmKey, float | None]] = []

    def take(self, what: str, key: AlarmKey, began_s: float) -> None:
        """Wait until the page shows the alarm, not there before, with cause and remedy."""
        shown = f"document.querySelector('[data-alarm=\"{key}\"].active')"
        script = (
            f"(row => row && row.querySelector('[aria-label=cause]').innerText.length > 3 && "
            f"row.querySelector('[aria-label=remedy]').innerText === {CATALOGUE[key].remedy!r})({shown})"
        )
        self.note(what, key, began_s, script)

    def note(self, what: str, key: AlarmKey, began_s: float, script: str) -> None:
        """Wait until a script is true."""
        took_s = None
        while time.monotonic() - began_s < _LIMIT_S:
            if self.page.ask(script):
                took_s = time.monotonic() - began_s
                break
            time.sleep(0.03)
        self.rows.append((what, key, took_s))
        print(f"{what:<40} {key:<18} {'NONE' if took_s is None else f'{took_s:.2f} s'}", flush=True)

    def acknowledge(self) -> None:
        """Acknowledge all that can be, so that the next one is new."""
        self.page.wait_while(
            "![...document.querySelectorAll('.alarm-row button')].some(b => b.innerText === 'SEEN')",
            lambda: self.page.ask(
                "[...document.querySelectorAll('.alarm-row button')].filter(b => b.innerText === 'SEEN')"
                ".forEach(b => { b.rigHeld = true; b.click(); b.rigHeld = false; })"
            ),
        )


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    with tempfile.TemporaryDirectory() as place, headless_browser() as browser:
        os.environ["XDG_STATE_HOME"] = f"{place}/state"
        folder = Path(place)
        config = folder / "rig.toml"
        config.write_text(RIG.replace("OUTPUT", (folder / "runs").as_posix()) + LASER, encoding="utf-8")
        (folder / "runs").mkdir()
        rows = measured(config, browser, quick=quick)
    took = [took_s for *_, took_s in rows if took_s is not None]
    results = {
        "faults": len(rows),
        "without an alarm": len(rows) - len(took),
        "later than 3 s": sum(one > ASKED_S for one in took),
        "median, s": statistics.median(took),
        "largest, s": max(took),
        "each, s": {what: took_s for what, _, took_s in rows},
    }
    for name, value in results.items():
        if not isinstance(value, dict):
            print(f"{name:<36} {value:.3g}")
    return results


def measured(
    config: Path, browser: HeadlessBrowser, *, quick: bool
) -> list[tuple[str, AlarmKey, float | None]]:
    """The faults in turn, at one page."""
    desk = DeskProcess(config)
    try:
        with browser.another() as tab:
            table = Table(Page(tab))
            table.page.open(desk.address)
            # an alarm cries only in a tab that somebody has touched; the list is unfolded to be read
            table.page.key("a")
            table.page.key("4")
            of_told_session(table, config)
            of_surroundings(table, config)
            if not quick:
                of_simulated_rig(table, config)
            desk = of_desk(table, desk, config)
            return table.rows
    finally:
        with contextlib.suppress(subprocess.TimeoutExpired):
            desk.end()
        desk.kill()


def of_told_session(table: Table, config: Path) -> None:
    """What a session says, then what happens to its process."""
    for number, (key, what, words) in enumerate(TOLD):
        if number == 0:
            session = told_session(config, "told")
        tell(session, _WELL)
        table.page.wait(f"!document.querySelector('[data-alarm=\"{key}\"].active')")
        table.acknowledge()
        began_s = time.monotonic()
        tell(session, words)
        table.take(what, key, began_s)
        if "event" in words:
            tell(session, {"event": ["camera back", ""]})
    tell(session, _WELL)
    table.acknowledge()
    began_s = time.monotonic()
    os.kill(session.pid, signal.SIGSTOP)
    table.take("a session is frozen", AlarmKey.SESSION_FROZEN, began_s)
    grey = "getComputedStyle(document.querySelector('.live')).filter.includes('grayscale')"
    table.note("its numbers are grey", AlarmKey.SESSION_FROZEN, began_s, grey)
    os.kill(session.pid, signal.SIGCONT)
    table.page.wait("!document.querySelector('[data-alarm=\"session frozen\"].active')")
    began_s = time.monotonic()
    session.kill()
    session.communicate()
    table.take("a session is killed", AlarmKey.SESSION_DIED, began_s)
    table.acknowledge()


def of_surroundings(table: Table, config: Path) -> None:
    """Folder and configuration."""
    runs, text = config.parent / "runs", config.read_text(encoding="utf-8")
    began_s = time.monotonic()
    runs.rename(runs.with_name("away"))
    table.take("the folder of the sessions is gone", AlarmKey.OUTPUT, began_s)
    runs.with_name("away").rename(runs)
    began_s = time.monotonic()
    config.write_text(text + "[camera\n", encoding="utf-8")
    table.take("the configuration is broken", AlarmKey.CONFIGURATION, began_s)
    config.write_text(text, encoding="utf-8")
    table.page.wait("!document.querySelector('.alarm-row.active')")
    table.acknowledge()
    # no more can be written, as on a full disk
    folder = runs / "full"
    session = subprocess.Popen(
        ["bash", "-c", f'ulimit -f {_LARGEST_KIB}; exec "$@"', "-", *run_words(config, folder)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=config.parent,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    record = folder / "run-1.mcap"
    size, grown_s, deadline_s = 0, math.inf, time.monotonic() + _LONGEST_S
    # it is written twice a second; the last write is a little before the one that fails, and any other pause
    # is a busy machine's
    while time.monotonic() - grown_s < 1.2 and time.monotonic() < deadline_s:
        with contextlib.suppress(FileNotFoundError):
            if (now := record.stat().st_size) > size:
                size = now
                grown_s = time.monotonic() if size > (_LARGEST_KIB - _NEAR_KIB) * 1024 else math.inf
        time.sleep(0.01)
    table.take("the record cannot be written any more", AlarmKey.SESSION_FAILED, grown_s)
    session.kill()
    session.communicate()
    table.acknowledge()


def of_simulated_rig(table: Table, config: Path) -> None:
    """Faults of the simulated rig in a session in real time; times count from its first frame."""
    text = config.read_text(encoding="utf-8")
    faults = "\n".join(lines for _, _, lines in TIMED.values())
    timed = config.with_name("timed.toml")
    timed.write_text(f"{text}[faults]\n{faults}\n", encoding="utf-8")
    folder = config.parent / "runs" / "timed"
    session = subprocess.Popen(
        run_words(timed, folder),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=config.parent,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    try:
        first_s = first_frame_s(folder)
        for key, (at_s, what, _) in TIMED.items():
            table.acknowledge()
            while time.monotonic() < first_s + at_s:
                time.sleep(0.02)
            table.take(what, key, first_s + at_s)
            if key is AlarmKey.INTERLOCK:
                table.take("its trip", AlarmKey.TRIP, first_s + at_s)
                table.take("the run in the dark", AlarmKey.LASER_DARK, first_s + at_s)
    finally:
        session.kill()
        session.communicate()
    table.page.wait("document.querySelector('[data-alarm=\"session died\"].active') !== null")
    table.acknowledge()


def of_desk(table: Table, desk: DeskProcess, config: Path) -> DeskProcess:
    """The desk hangs, dies, comes again. Returns the desk that runs then."""
    said = "(w => !w.hidden && w.innerText.includes({!r}))(document.getElementById('watchdog'))"
    page = table.page
    began_s = time.monotonic()
    os.kill(desk.pid, signal.SIGSTOP)
    table.note("the desk hangs", AlarmKey.DESK_LOST, began_s, said.format("start rig desk again"))
    os.kill(desk.pid, signal.SIGCONT)
    page.wait("document.getElementById('watchdog').hidden")
    began_s = time.monotonic()
    desk.kill()
    table.note("the desk is killed", AlarmKey.DESK_LOST, began_s, said.format("start rig desk again"))
    again = DeskProcess(config)
    # of a busy machine: how long that takes is none of the numbers
    page.wait(
        "document.getElementById('watchdog')?.hidden && document.querySelector('.q-tab') !== null",
        _LONGEST_S,
    )
    return again


def told_session(config: Path, name: str) -> "subprocess.Popen[str]":
    """A session that tells what it is told."""
    folder = config.parent / "runs" / name
    folder.mkdir()
    session = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.told_session", str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert session.stdout is not None
    assert session.stdout.readline() == "begun\n"
    return session


def tell(session: "subprocess.Popen[str]", words: dict[str, Any]) -> None:
    """Have it say this from now on."""
    assert session.stdin is not None
    session.stdin.write(json.dumps(words) + "\n")
    session.stdin.flush()


def run_words(config: Path, folder: Path) -> list[str]:
    """The command of a session."""
    return [sys.executable, "-m", "rig", "run", str(config), "-o", str(folder)]


def first_frame_s(folder: Path, limit_s: float = 180.0) -> float:
    """When the record of a session has begun, on this program's clock."""
    deadline_s = time.monotonic() + limit_s
    while time.monotonic() < deadline_s:
        with contextlib.suppress(NoSession):
            if (folder / ORDERS_NAME).exists():
                with Line(folder) as line:
                    elapsed_s = (line.news()["state"] or {}).get("elapsed_s") or 0.0
                    if elapsed_s:
                        return time.monotonic() - float(elapsed_s)
        time.sleep(0.02)
    raise TimeoutError(f"{folder}: no frame within {limit_s:g} s")


if __name__ == "__main__":
    run()
