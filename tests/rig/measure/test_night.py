"""A night without anybody: the plan that the manual shows, measured with a clock of its own."""

import contextlib
import json
import os
import pty
import re
import sys
import tty
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from rig.analysis import read_results
from rig.devices import Devices
from rig.measure import measure_session, resume_session
from rig.measure import night as night_module
from rig.measure import session as session_module
from rig.measure.night import measure_plan
from rig.measure.run_parts import RunOutcome, RunPlan
from rig.settings import load_configuration, load_plan
from rig.terminal import Terminated
from tests.rig.command_line import CONFIGS, QUICK, SMALL, figures_are_not_drawn, rig
from tests.rig.measure.test_preparation import BY_HAND

ROOT = CONFIGS.parent


class Night:
    """The room at night: time passes only while the program waits; after half an hour the air has cooled."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.waits_s: list[float] = []
        master, slave = pty.openpty()
        tty.setraw(slave)
        self.port, self._master, self._slave = os.ttyname(slave), master, slave
        self._over = Event()
        self._writing = Thread(target=self._write)
        self._writing.start()

    def sleep(self, wait_s: float) -> None:
        self.waits_s.append(wait_s)
        self.now_s += wait_s

    def _write(self) -> None:
        os.set_blocking(self._master, False)
        while not self._over.wait(0.005):
            temperature_c = 23.0 if self.now_s < 1800.0 else 20.0
            # which fails while no session reads
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, f"{temperature_c:.1f}, 40.0, 1000.0\n".encode())

    def close(self) -> None:
        self._over.set()
        self._writing.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def night() -> Iterator[Night]:
    made = Night()
    yield made
    made.close()


def shown_plan() -> str:
    (block,) = re.findall(
        r"^```toml\n(\[\[series\]\].*?)^```", (ROOT / "docs" / "session.md").read_text(), re.M | re.S
    )
    return str(block)


def written(path: Path, values: dict[str, str]) -> None:
    lines = [f'extends = "{CONFIGS / "demo.toml"}"', *(f"{key} = {value}" for key, value in values.items())]
    path.write_text("\n".join(lines) + "\n")


def entries(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "session.json").read_text())["entries"]
    return found


@pytest.mark.slow
def test_the_plan_that_is_shown_waits_repeats_and_leaves_out(
    tmp_path: Path, night: Night, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "night.toml").write_text(shown_plan().replace("runs = 5", "runs = 1"))
    sensor = {"environment_sensor.kind": '"serial"', "environment_sensor.port": f'"{night.port}"'}
    steel = {**QUICK, **sensor, "session.max_duration_s": "8", "faults.laser_fades_at_s": "4"}
    written(tmp_path / "steel.toml", steel)
    # a pendulum that always trembles by more than the plan allows
    trembling = "[{ frequency_hz = 11.0, amplitude_px = 0.5 }]"
    written(tmp_path / "silicon.toml", {**BY_HAND, "simulation.disturbances.microphonics": trembling})
    with figures_are_not_drawn():
        status = measure_plan(
            tmp_path / "night.toml", tmp_path / "out", now_s=lambda: night.now_s, sleep=night.sleep
        )
    assert status == 1
    said = capsys.readouterr().err
    # three times for the temperature, a pause, twice for quiet
    assert night.waits_s == [600.0, 600.0, 600.0, 1800.0, 1800.0, 1800.0]
    first, second = entries(tmp_path / "out" / "steel-at-20")
    assert (first["record"], first["state"]) == ("run-1.mcap", "rejected")
    assert first["reason"].startswith("lost spots")
    assert (second["record"], second["state"]) == ("run-2.mcap", "complete")
    assert "1 of its runs are repeated" in said
    assert re.search(r"steel-at-20: waiting since \d\d:\d\d: environment: 23.0 °C", said)
    with RecordReader(tmp_path / "out" / "steel-at-20" / "run-1.mcap") as reader:
        (told,) = [event.text for event in reader.events() if event.kind == "plan"]
    assert re.match(r"waited from \d\d:\d\d for 30 min: environment: 23.0 °C", told)
    (third,) = entries(tmp_path / "out" / "silicon-quiet")
    assert third["state"] == "failed"
    assert "vibration" in third["reason"]
    assert "series silicon-quiet is left out: not ready within 3600 s" in said


def test_a_failure_ends_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stalled = {"frames_stalled_at_s": "1", "frames_stalled_duration_s": "60"}
    written(tmp_path / "a.toml", SMALL | {f"faults.{key}": value for key, value in stalled.items()})
    series = '[[series]]\nname = "{}"\nconfig = "a.toml"\n'
    (tmp_path / "plan.toml").write_text(series.format("one") + series.format("two"))
    with figures_are_not_drawn():
        assert measure_plan(tmp_path / "plan.toml", tmp_path / "out") == 1
    assert not (tmp_path / "out" / "two").exists()
    assert "no frame within 5 s; the plan ends here" in capsys.readouterr().err


@pytest.mark.slow
def test_a_night_that_goes_on_judges_what_was_made_before(tmp_path: Path) -> None:
    """One that was ended before it repeated a bad run repeats it, once; then it is still not as planned."""
    written(tmp_path / "a.toml", QUICK | {"session.max_duration_s": "8", "faults.laser_fades_at_s": "4"})
    series = '[[series]]\nname = "{}"\nconfig = "a.toml"\npause_s = 60\n'
    plan, out, paused = tmp_path / "plan.toml", tmp_path / "out", list[float]()
    plan.write_text(series.format("one"))
    with figures_are_not_drawn():
        assert measure_plan(plan, out, sleep=paused.append) == 1
        assert measure_plan(plan, out, sleep=paused.append) == 1
        assert [one["state"] for one in entries(out / "one")] == ["complete"]
        plan.write_text(series.format("one") + "repeat_bad = 1\n" + series.format("two"))
        assert measure_plan(plan, out, sleep=paused.append) == 1
        assert [one["state"] for one in entries(out / "one")] == ["rejected", "complete"]
        assert paused == [60.0]
        # nothing was made of the first one: nothing to pause after
        assert measure_plan(plan, out, sleep=paused.append) == 1
    assert paused == [60.0]


@pytest.mark.slow
def test_a_run_that_was_made_after_the_last_results_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program was killed while it fitted; results of other runs were there from before."""
    written(tmp_path / "a.toml", QUICK | {"session.max_duration_s": "8", "session.runs": "2"})
    out = tmp_path / "out"
    with figures_are_not_drawn():
        measure_session(load_configuration(tmp_path / "a.toml"), tmp_path / "a.toml", out)
        state = json.loads((out / "session.json").read_text())
        state["runs_wanted"] = 3
        (out / "session.json").write_text(json.dumps(state))
        with monkeypatch.context() as killed:
            killed.setattr(night_module, "report", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                resume_session(out)
        resume_session(out)
    assert [run.record for run in read_results(out).runs] == ["run-1.mcap", "run-2.mcap", "run-3.mcap"]


def test_series_of_the_simulated_rig_are_different_runs(tmp_path: Path) -> None:
    written(tmp_path / "a.toml", QUICK | {"session.max_duration_s": "3"})
    series = '[[series]]\nname = "{}"\nconfig = "a.toml"\n'
    (tmp_path / "plan.toml").write_text(series.format("one") + series.format("two"))
    with figures_are_not_drawn():
        measure_plan(tmp_path / "plan.toml", tmp_path / "out")
    seen = []
    for name in ("one", "two"):
        with RecordReader(tmp_path / "out" / name / "run-1.mcap") as reader:
            seen.append(reader.spots()["y_px"][:50])
    assert not (seen[0] == seen[1]).any()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("temperature_c = [19, 20]", "temperature_c needs a thermometer"),
        ("quiet_arcsec = 0.1", "quiet_arcsec needs a pendulum at rest"),
        ("humidity_percent = [30, 40]", "humidity_percent needs a sensor of the air"),
        ("ground_rad_per_s2_rthz = 1e-8", "ground_rad_per_s2_rthz needs a pendulum at rest"),
        (
            "ground_rad_per_s2_rthz = 1e-8\nset = [\"start.way='magnet'\", 'controller.kind=\"simulated\"']",
            "set preflight.duration_s to 60 or more, it is 4 in",
        ),
        ("humidity_percent = [40, 30]", "its first value should be the smaller one"),
        ("pause = 5", "series.0.pause"),
        ('name = "../away"', "series.0.name"),
        ("set = ['session.rnus=3']", "did you mean runs?"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_before_anything_begins(
    tmp_path: Path, line: str, message: str
) -> None:
    named = "" if "name" in line else 'name = "one"\n'
    (tmp_path / "plan.toml").write_text(f'[[series]]\n{named}config = "{CONFIGS / "demo.toml"}"\n{line}\n')
    done = rig("run", "--plan", tmp_path / "plan.toml", "-o", tmp_path / "out")
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_series_have_folders_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(2 * '[[series]]\nname = "one"\nconfig = "a.toml"\n')
    with pytest.raises(ConfigurationError, match="two series are called 'one'"):
        load_plan(tmp_path / "plan.toml")


@pytest.mark.slow
def test_a_plan_that_is_resumed_tells_no_end_twice(tmp_path: Path) -> None:
    """Of a series whose end was told nobody is told again; of one that was killed before it told, he is."""
    tell, told, out = tmp_path / "tell.py", tmp_path / "told", tmp_path / "out"
    tell.write_text(f"import sys\nopen({str(told)!r}, 'a').write(sys.argv[1] + ' ')\n")
    command = json.dumps([sys.executable, str(tell)])
    written(tmp_path / "a.toml", QUICK | {"session.notify_command": command})
    plan = tmp_path / "plan.toml"
    plan.write_text('[[series]]\nname = "one"\nconfig = "a.toml"\n')
    with figures_are_not_drawn():
        assert measure_plan(plan, out) == 0
        assert told.read_text() == "end "
        assert measure_plan(plan, out) == 0
        assert resume_session(out / "one") == 0
        assert told.read_text() == "end "
        state = json.loads((out / "one" / "session.json").read_text())
        assert state["told"].startswith("end: ")
        (out / "one" / "session.json").write_text(json.dumps({**state, "told": ""}))
        assert measure_plan(plan, out) == 0
    assert told.read_text() == "end end "


def test_a_plan_that_is_ended_before_a_run_has_begun_says_so_of_that_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terminal is closed between two runs: nothing was killed, and the night goes on from there."""
    written(tmp_path / "a.toml", QUICK | {"session.max_duration_s": "4"})
    plan, out = tmp_path / "plan.toml", tmp_path / "out"
    plan.write_text('[[series]]\nname = "one"\nconfig = "a.toml"\nruns = 2\n')
    measure_run = session_module.measure_run

    def ended(made: RunPlan, devices: Devices) -> RunOutcome:
        if made.record.name == "run-2.mcap":
            raise Terminated("terminated: the terminal was closed")
        return measure_run(made, devices)

    with figures_are_not_drawn():
        with monkeypatch.context() as closed:
            closed.setattr(session_module, "measure_run", ended)
            with pytest.raises(Terminated):
                measure_plan(plan, out)
        _, second = entries(out / "one")
        assert (second["state"], second["reason"]) == ("stopped", "terminated: the terminal was closed")
        measure_plan(plan, out)
    assert [one["state"] for one in entries(out / "one")] == ["complete", "stopped", "complete"]
