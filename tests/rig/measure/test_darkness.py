"""The laser is lit only while frames are processed, and a run that loses its light says so."""

import _thread
import getpass
import json
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from acquisition.simulation.inputs import RigInputs
from processing.errors import RigError
from rig.control import Stage, light_permit
from rig.control.simulated import SimulatedBoard
from rig.devices import NoSession, OrderConnection, lit_devices
from rig.measure import recording
from tests.rig.command_line import AT_ONCE, CONFIGS, QUICK, rig, set_words
from tests.rig.control.wires import pull_cable

pytestmark = pytest.mark.timeout(300)

LIVE = {
    **QUICK,
    **AT_ONCE,
    "session.max_duration_s": "5",
    "controller.watchdog_s": "5",
}


class Apparatus:
    """The simulated laser as the tests see it, and the moment at which the record has begun.

    `dark` is set when the laser's light has gone during the run, `recording` `begun_after` so many blocks of
    spots; `write` is called before each block that the record's thread writes.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
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
        for stage in Stage:
            monkeypatch.setitem(light_permit.LONGEST_PAUSE_S, stage, 30.0)
        monkeypatch.setattr(RecordWriter, "write_spots", write_spots)
        monkeypatch.setattr(RigInputs, "laser", laser)


@pytest.fixture
def apparatus(monkeypatch: pytest.MonkeyPatch) -> Apparatus:
    return Apparatus(monkeypatch)


def entry_of(folder: Path) -> dict[str, Any]:
    entry: dict[str, Any] = json.loads((folder / "session.json").read_text())["entries"][-1]
    return entry


def events_of(folder: Path) -> list[tuple[str, str]]:
    with RecordReader(folder / "run-1.mcap") as reader:
        assert not reader.truncated
        return [(event.kind, event.text) for event in reader.events()]


@pytest.mark.slow
def test_a_run_whose_laser_goes_dark_ends_with_an_error_and_a_whole_record(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    pull_cable(monkeypatch, apparatus.recording.is_set)
    monkeypatch.setattr(lit_devices, "_MAX_BOARD_CONFIRM_S", 0.5)
    tell = f"import sys; open({str(tmp_path / 'told')!r}, 'a').write(sys.argv[1] + ' ')"
    told = {"session.notify_command": json.dumps([sys.executable, "-c", tell])}
    done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words({**LIVE, **told}))
    assert done.returncode == 1
    assert (tmp_path / "told").read_text().split() == ["alarm", "failure"]
    assert "IT IS NOT KNOWN WHETHER THE LASER IS LIT: THE CONTROLLER IS LOST" in done.stderr
    assert "WATCHDOG TURNS IT OFF 5 S AFTER THE LAST HEARTBEAT" in done.stderr
    assert "THE LASER IS DARK" not in done.stderr
    assert "THE LASER MAY BE LIT: the controller does not confirm that it is off" in done.stderr
    entry = entry_of(tmp_path / "out")
    assert entry["state"] == "failed"
    assert "it is not known whether the laser is lit: the controller is lost" in entry["reason"]
    (said,) = [text for kind, text in events_of(tmp_path / "out") if kind == "laser unknown"]
    assert re.search(r"it was last confirmed on at \d\d:\d\d:\d\d; ", said)
    (run,) = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    assert [one["ok"] for one in run["conditions"] if one["name"] == "light"] == [False]
    lit, dark = map(json.loads, (tmp_path / "out" / "audit.jsonl").read_text().splitlines())
    assert (lit["what"], lit["laser"], lit["user"]) == ("lit", "controller", getpass.getuser())
    assert (lit["task"], lit["why"]) == ("rig run", "asked for by rig run")
    assert dark["what"] == "unknown"
    assert "the controller is lost" in dark["why"]


@pytest.mark.slow
@pytest.mark.parametrize("asked", [True, False])
def test_a_run_that_waits_in_the_dark_is_lit_by_who_asks_and_by_nothing_else(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch, asked: bool
) -> None:
    """The controller's cable is pulled and put in again."""
    pull_cable(monkeypatch, lambda: apparatus.recording.is_set() and not apparatus.dark.is_set())
    monkeypatch.setattr(recording, "_MIN_LOST_S", 2.0)
    waiting = {**LIVE, "laser.when_dark": '"wait"', "session.max_duration_s": "8"}
    out = tmp_path / "out"
    with acting(lambda: watch_in_the_dark(out, asked)):
        done = rig("run", CONFIGS / "live.toml", "-o", out, *set_words(waiting))
    assert "laser off, confirmed by the controller" in done.stderr
    # who is asked for light is not asked to look for the spot
    assert "SPOT LOST" not in done.stderr
    kinds = [kind for kind, _ in events_of(out)]
    assert [kind for kind in kinds if kind in ("laser unknown", "laser dark")] == [
        "laser unknown",
        "laser dark",
    ]
    assert ("laser lit" in kinds) == asked
    said = [json.loads(line)["what"] for line in (out / "audit.jsonl").read_text().splitlines()]
    assert said.count("lit") == 1 + asked
    assert entry_of(out)["state"] == "complete"


@contextmanager
def acting(person: Callable[[], None]) -> Iterator[None]:
    """Somebody who acts beside the program."""
    thread = threading.Thread(target=person)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def watch_in_the_dark(folder: Path, asks: bool) -> None:
    """As a desk: watch the session, and when its laser is dark, and its controller is back, ask for light."""
    heard = False
    while not heard or (folder / ".orders.json").exists():
        with suppress(NoSession), OrderConnection(folder) as line:
            while True:
                heard = True
                safety = line.news()["safety"]
                if safety["trip"]:
                    with suppress(RigError):
                        line.order(f"acknowledge {safety['trip']['number']}")
                elif asks and safety["light"] == "off":
                    with suppress(RigError):
                        line.order("light")
                time.sleep(0.05)
        time.sleep(0.05)


@pytest.mark.slow
def test_after_an_interlock_nothing_is_lit_that_nobody_allowed(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(_: SimulatedBoard) -> bool:
        return apparatus.dark.is_set() or not apparatus.recording.is_set()

    monkeypatch.setattr(SimulatedBoard, "interlock_closed", closed)
    waiting = {**LIVE, "laser.when_dark": '"wait"', "session.runs": "2"}
    done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words(waiting))
    assert done.returncode == 1
    assert "the interlock of the controller opened" in done.stderr
    assert not (tmp_path / "out" / "run-2.mcap").exists()
    assert entry_of(tmp_path / "out")["state"] == "failed"


def test_an_interlock_that_opens_before_the_run_is_named(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimulatedBoard, "interlock_closed", lambda _: not apparatus.power_w)
    waiting = {**LIVE, "start.way": '"by hand"'}
    done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words(waiting))
    assert done.returncode == 1
    assert "the interlock of the controller opened; nothing was recorded" in done.stderr
    assert not (tmp_path / "out" / "run-1.mcap").exists()


@pytest.mark.slow
def test_a_laser_that_stays_lit_is_seen_and_latched(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its output is stuck: the controller has switched it off and says so."""
    usual = RigInputs.laser

    def stuck(inputs: RigInputs, power_w: float) -> None:
        if power_w or not apparatus.recording.is_set():
            usual(inputs, power_w)

    monkeypatch.setattr(RigInputs, "laser", stuck)
    monkeypatch.setattr(lit_devices, "_MAX_DARK_FRAMES_S", 30.0)
    done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words(LIVE))
    assert "confirmed" not in done.stderr
    assert "THE LASER MAY BE LIT: trip 1 (OUTPUT): the laser was commanded off, but the camera" in done.stderr
    lines = [json.loads(line) for line in (tmp_path / "out" / "audit.jsonl").read_text().splitlines()]
    assert [(line["what"], line.get("cause")) for line in lines][-1] == ("latch", "OUTPUT")


@pytest.mark.slow
def test_a_laser_that_is_off_is_seen_to_be(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lit_devices, "_MAX_DARK_FRAMES_S", 30.0)
    done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words(LIVE))
    assert "laser off, confirmed by the controller and the camera\n" in done.stderr


def test_a_disk_that_hangs_darkens_the_laser_and_two_interrupts_end_the_program(
    tmp_path: Path, apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    lit_when_it_hung: list[bool] = []
    dark: list[bool] = []

    def hang() -> None:
        if apparatus.recording.is_set():
            lit_when_it_hung.append(apparatus.power_w > 0)
            for stage in Stage:
                monkeypatch.setitem(light_permit.LONGEST_PAUSE_S, stage, 1.0)
            released.wait()

    def operator() -> None:
        dark.append(apparatus.dark.wait(60.0))
        while not released.wait(0.5):
            _thread.interrupt_main()

    apparatus.write, apparatus.begun_after = hang, 20
    acting = threading.Thread(target=operator)
    acting.start()
    # of a slow machine's large blocks the twentieth may come only after ten seconds
    values = {**LIVE, "session.max_duration_s": "100"}
    try:
        done = rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out", *set_words(values))
    finally:
        released.set()
        acting.join()
    assert lit_when_it_hung[0], done.stderr
    assert dark == [True]
    assert done.returncode != 0
    assert "nothing was processed or recorded for" in done.stderr
    assert entry_of(tmp_path / "out")["state"] == "recording"
