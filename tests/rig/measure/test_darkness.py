"""The laser is lit only while frames are processed, and a run that loses its light says so."""

import _thread
import getpass
import json
import re
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.writer import RecordWriter
from acquisition.simulation.inputs import RigInputs
from processing.errors import RigError
from rig.control import Stage, light_permit
from rig.control.simulated import SimulatedBoard
from rig.devices import OrderConnection, lit_devices
from rig.measure import recording
from tests.rig.acting import acting, at_desk
from tests.rig.command_line import AT_ONCE, QUICK, Session, run
from tests.rig.control.wires import pull_cable

pytestmark = pytest.mark.timeout(300)
WAITING = {"laser__when_dark": '"wait"'}


class Apparatus:
    """The simulated laser as the tests see it, and the moment at which the record has begun.

    `dark` is set when the laser's light has gone during the run, `recording` `begun_after` so many blocks of
    spots; `write` is called before each block that the record's thread writes.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.patch, self.folder = monkeypatch, folder
        self.recording = threading.Event()
        self.dark = threading.Event()
        self.power_w = 0.0
        self.begun_after = 5
        self.write: Callable[[], None] = lambda: None
        blocks = 0
        usual_write, usual_laser = RecordWriter.write_spots, RigInputs.laser

        def write_spots(writer: RecordWriter, *values: Any) -> None:
            nonlocal blocks
            blocks += 1
            if blocks == self.begun_after:
                self.recording.set()
            self.write()
            usual_write(writer, *values)

        def laser(inputs: RigInputs, power_w: float) -> None:
            self.power_w = power_w
            if power_w == 0.0 and self.recording.is_set():
                self.dark.set()
            usual_laser(inputs, power_w)

        # what is tested here are states: on a busy machine frames and answers may come seconds late
        monkeypatch.setattr(lit_devices, "_MAX_BOARD_CONFIRM_S", 30.0)
        monkeypatch.setattr(light_permit, "_MAX_PRESS_CHECK_INTERVAL_S", 30.0)
        self.allow_pauses(30.0)
        monkeypatch.setattr(RecordWriter, "write_spots", write_spots)
        monkeypatch.setattr(RigInputs, "laser", laser)

    def allow_pauses(self, longest_s: float) -> None:
        for stage in Stage:
            self.patch.setitem(light_permit.LONGEST_PAUSE_S, stage, longest_s)

    def run(self, **changes: str) -> Session:
        live = {**QUICK, **AT_ONCE, "session.max_duration_s": "5", "controller.watchdog_s": "5"}
        return run(self.folder, live, config="live.toml", **changes)


@pytest.fixture
def apparatus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Apparatus:
    return Apparatus(monkeypatch, tmp_path / "out")


@pytest.mark.slow
def test_a_run_whose_laser_goes_dark_ends_with_an_error_and_a_whole_record(apparatus: Apparatus) -> None:
    pull_cable(apparatus.patch, apparatus.recording.is_set)
    apparatus.patch.setattr(lit_devices, "_MAX_BOARD_CONFIRM_S", 0.5)
    told = apparatus.folder.with_name("told")
    tell = [sys.executable, "-c", f"import sys; open({str(told)!r}, 'a').write(sys.argv[1] + ' ')"]
    session = apparatus.run(session__notify_command=json.dumps(tell))
    assert session.done.returncode == 1
    assert told.read_text().split() == ["alarm", "failure"]
    assert "IT IS NOT KNOWN WHETHER THE LASER IS LIT: THE CONTROLLER IS LOST" in session.said
    assert "WATCHDOG TURNS IT OFF 5 S AFTER THE LAST HEARTBEAT" in session.said
    assert "THE LASER IS DARK" not in session.said
    assert "THE LASER MAY BE LIT: the controller does not confirm that it is off" in session.said
    entry = session.entries[-1]
    assert entry["state"] == "failed"
    assert "it is not known whether the laser is lit: the controller is lost" in entry["reason"]
    (said,) = [text for kind, text in session.events if kind == "laser unknown"]
    assert re.search(r"it was last confirmed on at \d\d:\d\d:\d\d; ", said)
    (measured,) = session.runs
    assert [one["ok"] for one in measured["conditions"] if one["name"] == "light"] == [False]
    lit, dark = session.audit
    assert (lit["what"], lit["laser"], lit["user"]) == ("lit", "controller", getpass.getuser())
    assert (lit["task"], lit["why"]) == ("rig run", "asked for by rig run")
    assert dark["what"] == "unknown"
    assert "the controller is lost" in dark["why"]


@pytest.mark.slow
@pytest.mark.parametrize("asked", [True, False])
def test_a_run_that_waits_in_the_dark_is_lit_by_who_asks_and_by_nothing_else(
    apparatus: Apparatus, asked: bool
) -> None:
    """The controller's cable is pulled and put in again."""
    pull_cable(apparatus.patch, lambda: apparatus.recording.is_set() and not apparatus.dark.is_set())
    apparatus.patch.setattr(recording, "_MIN_LOST_S", 2.0)

    def ask(line: OrderConnection) -> None:
        """Once the laser is dark, and its controller is back."""
        safety = line.news()["safety"]
        with suppress(RigError):
            if safety["trip"]:
                line.order(f"acknowledge {safety['trip']['number']}")
            elif asked and safety["light"] == "off":
                line.order("light")

    with acting(lambda: at_desk(apparatus.folder, ask)):
        session = apparatus.run(**WAITING, session__max_duration_s="8")
    assert "laser off, confirmed by the controller" in session.said
    # who is asked for light is not asked to look for the spot
    assert "SPOT LOST" not in session.said
    kinds = [kind for kind, _ in session.events if kind.startswith("laser")]
    assert kinds == ["laser unknown", "laser dark", *["laser lit"] * asked]
    assert [entry["what"] for entry in session.audit].count("lit") == 1 + asked
    assert session.entries[-1]["state"] == "complete"


@pytest.mark.slow
def test_after_an_interlock_nothing_is_lit_that_nobody_allowed(apparatus: Apparatus) -> None:
    def closed(_: SimulatedBoard) -> bool:
        return apparatus.dark.is_set() or not apparatus.recording.is_set()

    apparatus.patch.setattr(SimulatedBoard, "interlock_closed", closed)
    session = apparatus.run(**WAITING, session__runs="2")
    assert session.done.returncode == 1
    assert "the interlock of the controller opened" in session.said
    assert not (session.folder / "run-2.mcap").exists()
    assert session.entries[-1]["state"] == "failed"


def test_an_interlock_that_opens_before_the_run_is_named(apparatus: Apparatus) -> None:
    apparatus.patch.setattr(SimulatedBoard, "interlock_closed", lambda _: not apparatus.power_w)
    session = apparatus.run(start__way='"by hand"')
    assert session.done.returncode == 1
    assert "the interlock of the controller opened; nothing was recorded" in session.said
    assert not session.record.exists()


@pytest.mark.slow
def test_a_laser_that_stays_lit_is_seen_and_latched(apparatus: Apparatus) -> None:
    """Its output is stuck: the controller has switched it off and says so."""
    usual = RigInputs.laser

    def stuck(inputs: RigInputs, power_w: float) -> None:
        if power_w or not apparatus.recording.is_set():
            usual(inputs, power_w)

    apparatus.patch.setattr(RigInputs, "laser", stuck)
    apparatus.patch.setattr(lit_devices, "_MAX_DARK_FRAMES_S", 30.0)
    session = apparatus.run(session__max_duration_s="3")
    assert "confirmed" not in session.said
    assert (
        "THE LASER MAY BE LIT: trip 1 (OUTPUT): the laser was commanded off, but the camera" in session.said
    )
    assert (session.audit[-1]["what"], session.audit[-1]["cause"]) == ("latch", "OUTPUT")


def test_a_disk_that_hangs_darkens_the_laser_and_two_interrupts_end_the_program(apparatus: Apparatus) -> None:
    released = threading.Event()
    lit_when_it_hung: list[bool] = []
    dark: list[bool] = []

    def hang() -> None:
        if apparatus.recording.is_set():
            lit_when_it_hung.append(apparatus.power_w > 0)
            apparatus.allow_pauses(1.0)
            released.wait()

    def operator() -> None:
        dark.append(apparatus.dark.wait(60.0))
        while not released.wait(0.5):
            _thread.interrupt_main()

    apparatus.write, apparatus.begun_after = hang, 20
    with acting(operator):
        try:
            # of a slow machine's large blocks the twentieth may come only after ten seconds
            session = apparatus.run(session__max_duration_s="100")
        finally:
            released.set()
    assert lit_when_it_hung[0], session.said
    assert dark == [True]
    assert session.done.returncode != 0
    assert "nothing was processed or recorded for" in session.said
    assert session.entries[-1]["state"] == "recording"
