"""Sessions that wait, go on, and follow each other, measured with a clock of their own."""

import contextlib
import json
import os
import pty
import re
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
from rig.interruption import Terminated
from rig.measure import measure_session, measure_sessions, resume_session
from rig.measure import session as session_module
from rig.measure.run_parts import RunOutcome, RunPlan
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, QUICK, SMALL, rig
from tests.rig.measure.test_preparation import BY_HAND


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


def written(path: Path, values: dict[str, str]) -> None:
    lines = [f'extends = "{CONFIGS / "demo.toml"}"', *(f"{key} = {value}" for key, value in values.items())]
    path.write_text("\n".join(lines) + "\n")


def entries(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "session.json").read_text())["entries"]
    return found


@pytest.mark.slow
def test_a_session_waits_for_its_conditions_and_is_left_out_without_them(
    tmp_path: Path, night: Night, capsys: pytest.CaptureFixture[str]
) -> None:
    sensor = {"environment_sensor.kind": '"serial"', "environment_sensor.port": f'"{night.port}"'}
    cool = {"preflight.when": '"always"', "preflight.max_temperature_c": "20.5"}
    patient = {"preflight.wait_max_s": "3600", "preflight.try_every_s": "600"}
    written(tmp_path / "steel.toml", {**QUICK, **sensor, **cool, **patient, "session.max_duration_s": "8"})
    # a pendulum that always trembles by more than its limit
    trembling = "[{ frequency_hz = 11.0, amplitude_px = 0.5 }]"
    quiet = {"preflight.max_vibration_arcsec": "0.05", **patient, "preflight.try_every_s": "1800"}
    written(
        tmp_path / "silicon.toml", {**BY_HAND, **quiet, "simulation.disturbances.microphonics": trembling}
    )
    status = measure_sessions(
        [tmp_path / "steel.toml", tmp_path / "silicon.toml"],
        (),
        tmp_path / "out",
        now_s=lambda: night.now_s,
        sleep=night.sleep,
    )
    assert status == 1
    said = capsys.readouterr().err
    # three times for the temperature, twice for quiet
    assert night.waits_s == [600.0, 600.0, 600.0, 1800.0, 1800.0]
    assert re.search(r"steel: waiting since \d\d:\d\d: environment: 23.0 °C", said)
    assert (tmp_path / "out" / "steel" / "run-1.mcap").exists()
    assert re.search("silicon: not ready within 3600 s: .*vibration", said)
    assert not list((tmp_path / "out").glob("silicon/*.mcap"))


def test_a_failure_ends_the_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stalled = {"frames_stalled_at_s": "1", "frames_stalled_duration_s": "60"}
    written(tmp_path / "one.toml", SMALL | {f"faults.{key}": value for key, value in stalled.items()})
    written(tmp_path / "two.toml", SMALL)
    assert measure_sessions([tmp_path / "one.toml", tmp_path / "two.toml"], (), tmp_path / "out") == 1
    assert not (tmp_path / "out" / "two").exists()
    assert "no frame within 5 s; the list ends here" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_that_was_made_after_the_last_results_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program was killed while it fitted; results of other runs were there from before."""
    written(tmp_path / "a.toml", QUICK | {"session.max_duration_s": "8", "session.runs": "2"})
    out = tmp_path / "out"
    measure_session(load_configuration(tmp_path / "a.toml"), tmp_path / "a.toml", out)
    state = json.loads((out / "session.json").read_text())
    state["runs_wanted"] = 3
    (out / "session.json").write_text(json.dumps(state))
    with monkeypatch.context() as killed:
        killed.setattr(session_module, "report", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            resume_session(out)
    resume_session(out)
    assert [run.record for run in read_results(out).runs] == ["run-1.mcap", "run-2.mcap", "run-3.mcap"]


def test_sessions_of_the_simulated_rig_are_different_runs(tmp_path: Path) -> None:
    sources = [tmp_path / "one.toml", tmp_path / "two.toml"]
    for source in sources:
        written(source, QUICK | {"session.max_duration_s": "3"})
    measure_sessions(sources, (), tmp_path / "out")
    seen = []
    for name in ("one", "two"):
        with RecordReader(tmp_path / "out" / name / "run-1.mcap") as reader:
            seen.append(reader.spots()["y_px"][:50])
    assert not (seen[0] == seen[1]).any()


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        (["preflight.max_temperature_c=20"], "preflight.max_temperature_c needs a sensor of the air"),
        (["preflight.min_humidity_percent=30"], "preflight.min_humidity_percent needs a sensor of the air"),
        (["preflight.max_vibration_arcsec=0.1"], "preflight.max_vibration_arcsec needs a pendulum at rest"),
        (
            [
                "preflight.max_ground_rad_per_s2_rthz=1e-8",
                "start.way='magnet'",
                "controller.kind='simulated'",
            ],
            "set preflight.duration_s to 60 or more, it is 4",
        ),
        (["preflight.when='never'"], 'has no effect with preflight.when = "never"'),
        (["session.rnus=3"], "did you mean runs?"),
    ],
)
@pytest.mark.parametrize("sessions", [1, 2])
def test_a_wait_that_cannot_be_is_refused_before_anything_begins(
    tmp_path: Path, stated: list[str], message: str, sessions: int
) -> None:
    changes = [word for each in ("preflight.wait_max_s=60", *stated) for word in ("--set", each)]
    sources = [CONFIGS / "demo.toml", CONFIGS / "silicon.toml"][:sessions]
    done = rig("run", *sources, "-o", tmp_path / "out", *changes)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_sessions_have_folders_of_their_own(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="one: named twice"):
        measure_sessions([tmp_path / "one.toml", tmp_path / "b" / "one.toml"], (), None)


def test_a_list_that_is_ended_before_a_run_has_begun_says_so_of_that_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terminal is closed between two runs: nothing was killed, and the list goes on from there."""
    written(tmp_path / "one.toml", QUICK | {"session.max_duration_s": "4", "session.runs": "2"})
    sources, out = [tmp_path / "one.toml"], tmp_path / "out"
    measure_run = session_module.measure_run

    def ended(made: RunPlan, devices: Devices) -> RunOutcome:
        if made.record.name == "run-2.mcap":
            raise Terminated("terminated: the terminal was closed")
        return measure_run(made, devices)

    with monkeypatch.context() as closed:
        closed.setattr(session_module, "measure_run", ended)
        with pytest.raises(Terminated):
            measure_sessions(sources, (), out)
    _, second = entries(out / "one")
    assert (second["state"], second["reason"]) == ("stopped", "terminated: the terminal was closed")
    measure_sessions(sources, (), out)
    assert [one["state"] for one in entries(out / "one")] == ["complete", "stopped", "complete"]
