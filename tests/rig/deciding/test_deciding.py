"""A night that decides: it measures until its target is reached, and says why each run was chosen."""

import datetime
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from rig.deciding import decide_night
from rig.settings import load_deciding_plan
from tests.rig.command_line import SMALL, figures_are_not_drawn, rig
from tests.rig.measure.test_night import Night, written
from tests.rig.measure.test_preparation import holds_spots

SHORT = {**SMALL, "simulation.clock.frame_rate_hz": "50.0"}
STEADY = "[size]\nb = 0.02\np = 0.002\nc = 0.03\nn = 0.01\nperiod0_s = 1e-4\ngamma_pa = 0.01\n"
PLAN = """\
[auto]
config = "rig.toml"
campaign = "campaign.toml"
for = ["u(c)/c<0.025"]
first_arcsec = [20]
last_arcsec = [10, 8]
max_runs = 6
hours = 2
"""


@pytest.fixture
def night() -> Iterator[Night]:
    made = Night()
    yield made
    made.close()


def planned(folder: Path, *lines: str, config: dict[str, str] | None = None, plan: str = PLAN) -> Path:
    written(folder / "rig.toml", SHORT if config is None else config)
    (folder / "campaign.toml").write_text(STEADY)
    (folder / "auto.toml").write_text("\n".join([plan, *lines]) + "\n")
    return folder / "auto.toml"


def decisions(folder: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads((folder / "decisions.json").read_text())
    return tree


def plan_events(record: Path) -> list[str]:
    with RecordReader(record) as reader:
        return [event.text for event in reader.events() if event.kind == "plan"]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_a_night_that_was_killed_goes_on_with_what_it_learned(tmp_path: Path) -> None:
    plan, out = planned(tmp_path), tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "rig", "run", "--plan", str(plan), "-o", str(out)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 250
        while not any(holds_spots(record) for record in out.glob("02-*/run-1.mcap")):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    before = decisions(out)
    first, second = before["decisions"]
    assert (first["state"], second["state"]) == ("measured", "chosen")
    # what the second one was chosen by is the first one's result
    assert second["after_runs"] == 1
    assert second["u_before"] < first["u_before"]
    kept = (out / first["folder"] / "results.json").read_bytes()

    done = rig("run", "--plan", plan, "-o", out)
    assert done.returncode == 0, done.stderr
    assert "continues after 1 runs" in done.stderr
    after = decisions(out)
    assert after["decisions"][0] == first
    assert {**after["decisions"][1], "state": "chosen"} == second
    assert (out / first["folder"] / "results.json").read_bytes() == kept
    assert after["ending"] == "reached"
    assert after["u_now"] < 1
    assert len(after["decisions"]) <= 6
    states = [
        entry["state"]
        for entry in json.loads((out / second["folder"] / "session.json").read_text())["entries"]
    ]
    assert states == ["interrupted", "complete"]
    for decision in after["decisions"]:
        # the second folder holds the record that was cut, too
        *_, record = sorted((out / decision["folder"]).glob("run-?.mcap"))
        assert plan_events(record) == [decision["why"]]
        assert decision["number"] == 1 or f"run {decision['number']}: {decision['why']}" in done.stderr
    # one that is ended measures nothing more, and says so
    again = rig("run", "--plan", plan, "-o", out)
    assert again.returncode == 0
    assert decisions(out)["decisions"] == after["decisions"]
    assert "the night ends: No further runs are needed" in again.stderr


@pytest.mark.slow
def test_a_limit_ends_the_night_and_says_what_is_left(tmp_path: Path) -> None:
    plan = planned(tmp_path, plan=PLAN.replace("0.025", "0.002").replace("max_runs = 6", "max_runs = 1"))
    done = rig("run", "--plan", plan, "-o", tmp_path / "out")
    assert done.returncode == 1
    tree = decisions(tmp_path / "out")
    (only,) = tree["decisions"]
    assert "within the plan's limits it is not reached" in only["why"]
    assert tree["ending"] == "a limit of the plan"
    assert tree["said"].startswith("max_runs = 1 were made; u is ")
    assert tree["u_now"] > 1
    # more is allowed, and said: but no time is left
    plan.write_text(
        plan.read_text().replace("max_runs = 1", "max_runs = 2").replace("hours = 2", "hours = 0.1")
    )
    more = rig("run", "--plan", plan, "-o", tmp_path / "out")
    assert more.returncode == 1
    assert "the plan was changed: hours = 0.1 (was 2.0); max_runs = 2 (was 1)" in more.stderr
    assert "no run ends before" in decisions(tmp_path / "out")["said"]


def test_what_no_number_of_runs_reaches_is_not_begun(tmp_path: Path) -> None:
    plan = planned(tmp_path, plan=PLAN.replace("0.025", "0.000001"))
    done = rig("run", "--plan", plan, "-o", tmp_path / "out")
    assert done.returncode == 1
    tree = decisions(tmp_path / "out")
    assert not tree["decisions"]
    assert tree["ending"] == "cannot be reached"
    assert "with any number of runs" in done.stderr


def test_conditions_that_are_never_met_end_the_night(tmp_path: Path, night: Night) -> None:
    sensor = {"environment_sensor.kind": '"serial"', "environment_sensor.port": f'"{night.port}"'}
    bands = ("humidity_percent = [60, 70]", "wait_max_s = 1200", "try_every_s = 600")
    plan = planned(tmp_path, *bands, config=SHORT | sensor)
    seen: list[str] = []

    def sleep(wait_s: float) -> None:
        seen.append(decisions(tmp_path / "out")["waiting"])
        night.sleep(wait_s)

    with figures_are_not_drawn():
        status = decide_night(plan, tmp_path / "out", now_s=lambda: night.now_s, sleep=sleep)
    assert status == 1
    assert night.waits_s == [600.0, 600.0]
    assert all(text.startswith("waiting since ") and "60 to 70 %" in text for text in seen)
    tree = decisions(tmp_path / "out")
    assert tree["ending"] == "conditions were not met"
    (only,) = tree["decisions"]
    assert only["state"] == "failed"
    assert not list((tmp_path / "out").glob("*/*.mcap"))


@pytest.mark.parametrize(
    ("lines", "config", "message"),
    [
        ([], {"start.way": '"by hand"'}, "nobody releases the pendulum at night"),
        (
            [],
            {"camera.driver": '"usb3vision"'},
            "nothing sets the pendulum swinging",
        ),
        (
            ["first_arcsec = [20, 40]"],
            {"start.way": '"magnet"', "controller.kind": '"simulated"'},
            "first_arcsec = [20, 40]: the magnet releases from one place",
        ),
        (["hours = 0"], {}, "auto.hours = 0"),
        (["hour = 2"], {}, "auto.hour: unknown key; did you mean hours?"),
        (['for = ["u(x)/x<0.1"]'], {}, "no parameter x"),
        (["max_runs = 0"], {}, "auto.max_runs = 0"),
        (["humidity_percent = [30, 40]"], {}, "humidity_percent needs a sensor of the air"),
    ],
)
def test_a_night_that_cannot_be_is_refused_before_anything_begins(
    tmp_path: Path, lines: list[str], config: dict[str, str], message: str
) -> None:
    own = {line.partition(" =")[0] for line in lines}
    plan = "\n".join(line for line in PLAN.splitlines() if line.partition(" =")[0] not in own)
    source = planned(tmp_path, *lines, config=SHORT | config, plan=plan)
    done = rig("run", "--plan", source, "-o", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_with_a_person_there_a_night_may_be_released_by_hand(tmp_path: Path) -> None:
    by_hand = SHORT | {"start.way": '"by hand"'}
    plan = planned(tmp_path, "attended = true", config=by_hand, plan=PLAN.replace("0.025", "0.000001"))
    assert "with any number of runs" in rig("run", "--plan", plan, "-o", tmp_path / "out").stderr


def test_a_night_ends_at_the_earlier_one_of_both_ends(tmp_path: Path) -> None:
    begun = datetime.datetime(2026, 11, 25, 20, 0).astimezone()
    lasting = {}
    for line in ("hours = 2", "until = 07:00:00", "until = 19:00:00", "hours = 30\nuntil = 07:00:00",
                 "until = 2026-11-26T01:00:00+00:00"):  # fmt: skip
        plan = load_deciding_plan(planned(tmp_path, line, plan=PLAN.replace("hours = 2\n", "")))
        lasting[line] = (plan.ends_utc(begun.astimezone(datetime.UTC)) - begun).total_seconds() / 3600
    utc = datetime.datetime(2026, 11, 26, 1, tzinfo=datetime.UTC)
    assert list(lasting.values()) == [2.0, 11.0, 23.0, 11.0, (utc - begun).total_seconds() / 3600]
    with pytest.raises(ConfigurationError, match="state hours or until"):
        load_deciding_plan(planned(tmp_path, plan=PLAN.replace("hours = 2\n", "")))


@pytest.mark.slow
def test_a_clock_that_is_set_back_makes_the_night_no_longer(tmp_path: Path) -> None:
    plan, out = planned(tmp_path), tmp_path / "out"
    begun = datetime.datetime(2026, 11, 1, 20, tzinfo=datetime.UTC)

    def measured() -> bool:
        file = out / "decisions.json"
        return file.exists() and any(one["state"] == "measured" for one in decisions(out)["decisions"])

    with figures_are_not_drawn():
        status = decide_night(
            plan,
            out,
            now_s=lambda: 3 * 3600.0 if measured() else 0.0,
            now_utc=lambda: begun - datetime.timedelta(days=1) if measured() else begun,
        )
    assert status == 1
    tree = decisions(out)
    assert len(tree["decisions"]) == 1
    assert tree["ending"] == "a limit of the plan"
