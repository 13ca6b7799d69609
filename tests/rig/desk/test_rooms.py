"""What panels ask of the desk: settings of the camera to keep, answers to the balance, looking again."""

import inspect
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from acquisition.camera import CameraSettings
from processing.errors import ConfigurationError, RigError
from rig.commands import calibration
from rig.control import Loop, SafetyNow
from rig.desk import jobs
from rig.desk.alarm_list import AlarmKey, AlarmState
from rig.desk.calibrating import KINDS
from rig.desk.desk import Desk
from rig.desk.lighting import lamps, refusal
from rig.desk.panels.balance import net_of
from rig.desk.panels.rig_panel import checks, region_drawn
from rig.interruption import start_python
from rig.prepare import BalanceStage
from tests.rig.command_line import CONFIGS, SMALL
from tests.waiting import until


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    found = Desk(CONFIGS / "demo.toml", (f'session.output="{tmp_path.as_posix()}"',))
    yield found
    found.close()


def test_what_the_camera_has_set_is_kept_and_what_cannot_be_is_not(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the news may be older than the frame that is seen
    desk.follower.news = {"camera": {"applied": {"exposure_us": 100.0}}}
    applied = CameraSettings(exposure_us=125.0, width_px=64, offset_x_px=8)
    monkeypatch.setattr(desk.follower, "frame", SimpleNamespace(applied=applied))
    desk.keep_camera_settings()
    kept = {"camera.exposure_us": 125.0, "camera.width_px": 64, "camera.offset_x_px": 8}
    assert desk.own_settings == kept
    assert desk.checked().camera.width_px == 64
    unusable = CameraSettings.model_construct(exposure_us=-1.0)
    monkeypatch.setattr(desk.follower, "frame", SimpleNamespace(applied=unusable))
    with pytest.raises(RigError, match="exposure_us"):
        desk.keep_camera_settings()
    assert desk.own_settings == kept


@pytest.mark.parametrize(("ends", "first_px", "size_px"), [((0, 400), 0, 320), ((500, 800), 409, 231)])
def test_a_region_that_is_drawn_beyond_the_frame_ends_at_its_edge(
    ends: tuple[float, float], first_px: int, size_px: int
) -> None:
    """The part beyond the left edge made it too wide, that beyond the right one wider than the sensor."""
    # a frame of 640 × 480 has 40 px of margin at both sides of a picture of 800 × 540
    look = SimpleNamespace(image=np.zeros((480, 640)), applied=CameraSettings(offset_x_px=16, offset_y_px=0))
    region = region_drawn(look, ends, (54.0, 216.0))  # type: ignore[arg-type]
    assert (region.offset_x_px, region.width_px) == (16 + first_px, size_px)
    assert (region.offset_y_px, region.height_px) == (48, 144)


FORGETS = """print('{"forgotten": "nothing learned yet", "turns": []}')"""
"""Stands for `rig balance --forget-last --json`, which prints one object."""


def test_without_a_measurement_a_turn_is_forgotten_but_not_stated(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "start_python", lambda *_, **how: start_python("-c", FORGETS, **how))
    assert desk.balancing.dialogue.stage is BalanceStage.IDLE
    with pytest.raises(ConfigurationError, match="first measure"):
        desk.balancing.state_turn("x", "0.5")
    desk.balancing.end()
    desk.balancing.forget()
    assert desk.jobs["balance"].wait(50.0)
    dialogue = desk.balancing.dialogue
    assert (dialogue.stage, dialogue.detail) == (BalanceStage.ENDED, "nothing learned yet")


ECHO = """
import json, sys, time
from pathlib import Path
print(json.dumps({"kind": "trajectory", "x": [1.0], "y": [2.0]}), flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.02)
print(json.dumps({"kind": "ask"}), flush=True)
for line in sys.stdin:
    time.sleep(0.2)
    heard = line.rstrip()
    said = {"forgotten": "nothing learned yet"} if heard == "f" else {}
    print(json.dumps({"kind": "heard", "heard": heard, **said}), flush=True)
    print(json.dumps({"kind": "ask"}), flush=True)
"""
"""Stands for `rig balance --json`: measures until a file is there, then says what it was told, and asks."""


def test_a_turn_is_refused_while_it_is_measured_and_answered_when_it_is_asked_for(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    over = tmp_path / "over"
    monkeypatch.setattr(jobs, "start_python", lambda *_, **how: start_python("-c", ECHO, str(over), **how))
    job = desk.jobs["balance"] = jobs.Job(["balance"], uses_camera=True)
    until(lambda: bool(job.lines))
    with pytest.raises(ConfigurationError, match="first measure"):
        desk.balancing.state_turn("x", "0.5")
    with pytest.raises(ConfigurationError, match="wait for the end"):
        desk.balancing.forget()
    over.touch()
    for do in (
        lambda: desk.balancing.state_turn("x", " +0.5 "),
        desk.balancing.measure,
        desk.balancing.forget,
        desk.balancing.end,
    ):
        until(lambda: job.asks)
        do()
        # the same press again, before the command has answered
        assert not job.asks
        assert desk.balancing.dialogue.stage is BalanceStage.MEASURING
        job.answer("x +0.5")
        if do == desk.balancing.forget:
            until(lambda: job.asks)
            assert desk.balancing.dialogue.detail == "nothing learned yet"
    until(lambda: job.asks)
    assert [line["heard"] for line in job.lines if "heard" in line] == ["x +0.5", "m", "f", "q"]
    assert job.end_requested
    job.end()
    assert job.wait(50.0)
    # what a person ended has not failed
    assert desk.balancing.dialogue.stage is BalanceStage.ENDED


COMPILES = """
import sys, pathlib, time
print('still compiling, 40 s so far', file=sys.stderr, flush=True)
while not pathlib.Path(sys.argv[1]).exists():
    time.sleep(0.05)
sys.exit('rig: the laser stays off: trip 1\\nlaser off, confirmed by the controller')
"""


def test_preflight_says_what_it_waits_for_and_why_it_failed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    over = tmp_path / "over"
    monkeypatch.setattr(
        jobs, "start_python", lambda *_, **how: start_python("-c", COMPILES, str(over), **how)
    )
    job = desk.jobs.begin("doctor", uses_camera=True)
    until(lambda: bool(job.output))
    assert checks(desk) == "<span class=''>still compiling, 40 s so far</span>"
    over.touch()
    assert job.wait(50.0)
    assert checks(desk) == "<span class='no'>the laser stays off: trip 1</span>"


def test_a_session_without_a_record_says_why_it_failed(desk: Desk, tmp_path: Path) -> None:
    folder = tmp_path / "no-go"
    folder.mkdir()
    said = "rig: run 1 failed: preflight says no-go\nlaser off, confirmed by the controller\n"
    (folder / jobs.MESSAGES_NAME).write_text(said, encoding="utf-8")
    desk.last_start = jobs.StartedSession(start_python("-c", "raise SystemExit(1)"), folder)
    until(lambda: desk.start_failed)
    assert desk.start_problem == "run 1 failed: preflight says no-go"
    desk.alarming.start()
    until(lambda: bool(desk.alarming.alarms.rows()))
    (row,) = desk.alarming.alarms.rows()
    assert row.cause == "no-go: run 1 failed: preflight says no-go"


DEAF = """
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("peak", flush=True)
time.sleep(600.0)
"""


def test_a_live_picture_that_hears_nothing_is_ended_with_its_laser_told_off(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[object] = []
    monkeypatch.setattr("rig.desk.desk._MAX_CLOSING_S", 0.5)
    monkeypatch.setattr("rig.desk.desk.darken_directly", lambda *lamps: told.append(lamps))
    monkeypatch.setattr(jobs, "start_python", lambda *_, **how: start_python("-c", DEAF, **how))
    desk.begin_aligning()
    job = desk.live_picture
    assert job is not None
    until(lambda: bool(job.output))
    # its picture that stands still is an alarm, but not because somebody has ended it
    desk.follower.command_folder, desk.follower.news_s = Path(), time.monotonic()
    desk.follower.news = {"frames_age_s": 60.0}
    desk.alarming.start()
    until(lambda: [row.key for row in desk.alarming.alarms.rows()] == [AlarmKey.CAMERA])
    job.end_requested = True
    until(lambda: [row.state for row in desk.alarming.alarms.rows()] == [AlarmState.CLEARED])
    desk.end_aligning()
    assert not job.running
    assert len(told) == 1
    assert desk.live_picture is None


def test_the_bar_knows_the_light_of_a_simulated_rigs_command_and_that_it_went_dark(tmp_path: Path) -> None:
    sets = {**SMALL, "session.output": f'"{tmp_path.as_posix()}"', "controller.watchdog_s": "5"}
    desk = Desk(CONFIGS / "live.toml", tuple(f"{key}={value}" for key, value in sets.items()))
    try:
        desk.follower.start()
        desk.safety.start()
        desk.balancing.measure()
        until(lambda: lamps(desk.safety, "")["laser"]["text"] == "on")
        assert desk.lighting.off("one") == []
        until(lambda: not desk.balancing.running)
        until(lambda: lamps(desk.safety, "")["laser"]["age_s"] is None)
        laser = lamps(desk.safety, "")["laser"]
        assert re.match(r"off, confirmed \d\d:\d\d:\d\d by board", str(laser["last"]))
        # the trip of a simulated rig ends with the program that had it
        assert desk.safety.trip is None
    finally:
        desk.close()


def test_a_trip_is_not_to_be_acknowledged_while_the_interlock_is_open() -> None:
    assert not refusal(SafetyNow())
    is_open = SafetyNow(interlock=Loop.OPEN, interlock_age_s=0.1)
    assert refusal(is_open) == "close the interlock first"
    # what was heard long ago holds nobody up: the devices decide
    assert not refusal(replace(is_open, interlock_age_s=60.0))


def test_every_form_of_a_calibration_has_the_options_of_its_command() -> None:
    options = {
        str(one.callback.__name__): {
            name.replace("_", "-") for name in inspect.signature(one.callback).parameters
        }
        for one in calibration.commands.registered_commands
        if one.callback is not None
    }
    assert options.keys() == KINDS.keys()
    for name, kind in KINDS.items():
        assert {"output", "valid-days", "by", "as-json", *kind.fields} <= options[name]


def test_turns_in_two_parts_are_summed_in_words() -> None:
    assert net_of([0.5]) == ""
    assert net_of([0.61, -0.5]) == "net +0.11 (the second turn takes up the play)"
