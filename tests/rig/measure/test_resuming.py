"""Sessions that wait, go on, and follow each other, measured with a clock of their own."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from rig.analysis import read_results
from rig.devices import Devices
from rig.interruption import Terminated
from rig.measure import measure_sessions, notices, resume_session
from rig.measure import session as session_module
from rig.measure.run_parts import RunOutcome, RunPlan
from tests.rig.command_line import CONFIGS, QUICK, SMALL, Session, rig, run, set_words
from tests.rig.made_up import speaking_port
from tests.rig.measure.test_preparation import BY_HAND


class Night:
    """The room at night: time passes only while the program waits; after half an hour the air has cooled."""

    def __init__(self) -> None:
        self.now_s, self.port = 0.0, ""
        self.waits_s: list[float] = []

    def sleep(self, wait_s: float) -> None:
        self.waits_s.append(wait_s)
        self.now_s += wait_s

    def air(self, _: bytes) -> bytes:
        """A line of the sensor."""
        return b"%.1f, 40.0, 1000.0\n" % (23.0 if self.now_s < 1800.0 else 20.0)


@pytest.fixture
def night(monkeypatch: pytest.MonkeyPatch) -> Iterator[Night]:
    night = Night()
    monkeypatch.setattr(notices, "time", SimpleNamespace(monotonic=lambda: night.now_s, sleep=night.sleep))
    with speaking_port(night.air, 0.005) as night.port:
        yield night


def written(path: Path, values: dict[str, str]) -> Path:
    lines = [f'extends = "{CONFIGS / "demo.toml"}"', *(f"{key} = {value}" for key, value in values.items())]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.slow
def test_a_session_waits_for_its_conditions_and_is_left_out_without_them(
    tmp_path: Path, night: Night, capsys: pytest.CaptureFixture[str]
) -> None:
    patient = {"preflight.wait_max_s": "3600", "preflight.try_every_s": "600"}
    cool = {
        "environment_sensor.kind": '"serial"',
        "environment_sensor.port": f'"{night.port}"',
        "preflight.when": '"always"',
        "preflight.max_temperature_c": "20.5",
        "preflight.duration_s": "1",
        "session.max_duration_s": "2",
    }
    # a pendulum that always trembles by more than its limit
    quiet = {
        "preflight.max_vibration_arcsec": "0.05",
        "preflight.try_every_s": "1800",
        "simulation.disturbances.microphonics": "[{ frequency_hz = 11.0, amplitude_px = 0.5 }]",
    }
    sources = [
        written(tmp_path / "steel.toml", {**QUICK, **patient, **cool}),
        written(tmp_path / "silicon.toml", {**BY_HAND, **patient, **quiet}),
    ]
    out = tmp_path / "out"
    assert measure_sessions(sources, (), out) == 1
    said = capsys.readouterr().err
    # three times for the temperature, twice for quiet
    assert night.waits_s == [600.0, 600.0, 600.0, 1800.0, 1800.0]
    assert re.search(r"steel: waiting since \d\d:\d\d: environment: 23.0 °C", said)
    assert (out / "steel" / "run-1.mcap").exists()
    assert re.search("silicon: not ready within 3600 s: .*vibration", said)
    assert not list(out.glob("silicon/*.mcap"))


def test_a_failure_ends_the_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stalled = {"faults.frames_stalled_at_s": "1", "faults.frames_stalled_duration_s": "60"}
    sources = [written(tmp_path / "one.toml", SMALL | stalled), written(tmp_path / "two.toml", SMALL)]
    assert measure_sessions(sources, (), tmp_path / "out") == 1
    assert not (tmp_path / "out" / "two").exists()
    assert "no frame within 5 s; the list ends here" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_that_was_made_after_the_last_results_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program was killed while it fitted; results of other runs were there from before."""
    out = run(tmp_path / "out", QUICK, session__max_duration_s="3").folder
    state = json.loads((out / "session.json").read_text())
    (out / "session.json").write_text(json.dumps({**state, "runs_wanted": 2}))
    with monkeypatch.context() as killed:
        killed.setattr(session_module, "report", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            resume_session(out)
    assert [one.record for one in read_results(out).runs] == ["run-1.mcap"]
    resume_session(out)
    assert [one.record for one in read_results(out).runs] == ["run-1.mcap", "run-2.mcap"]


def test_a_list_that_is_ended_before_a_run_has_begun_says_so_of_that_run_and_goes_on_with_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terminal is closed between two runs: nothing was killed, and the list goes on from there."""
    sources = [
        written(tmp_path / name, QUICK | {"session.max_duration_s": "3", "session.runs": runs})
        for name, runs in (("one.toml", "2"), ("two.toml", "1"))
    ]
    one, two = (Session(tmp_path / "out" / name) for name in ("one", "two"))
    measure_run = session_module.measure_run

    def ended(made: RunPlan, devices: Devices) -> RunOutcome:
        if made.record.name == "run-2.mcap":
            raise Terminated("terminated: the terminal was closed")
        return measure_run(made, devices)

    with monkeypatch.context() as closed:
        closed.setattr(session_module, "measure_run", ended)
        with pytest.raises(Terminated):
            measure_sessions(sources, (), tmp_path / "out")
    _, second = one.entries
    assert (second["state"], second["reason"]) == ("stopped", "terminated: the terminal was closed")
    measure_sessions(sources, (), tmp_path / "out")
    assert [entry["state"] for entry in one.entries] == ["complete", "stopped", "complete"]
    # sessions of the simulated rig are different runs
    with RecordReader(one.record) as reader, RecordReader(two.record) as other:
        assert not (reader.spots()["y_px"][:50] == other.spots()["y_px"][:50]).any()


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"preflight.max_temperature_c": "20"}, "preflight.max_temperature_c needs a sensor of the air"),
        (
            {"preflight.min_humidity_percent": "30"},
            "preflight.min_humidity_percent needs a sensor of the air",
        ),
        (
            {"preflight.max_vibration_arcsec": "0.1"},
            "preflight.max_vibration_arcsec needs a pendulum at rest",
        ),
        (
            {
                "preflight.max_ground_rad_per_s2_rthz": "1e-8",
                "start.way": "'magnet'",
                "controller.kind": "'simulated'",
            },
            "set preflight.duration_s to 60 or more, it is 4",
        ),
        ({"preflight.when": "'never'"}, 'has no effect with preflight.when = "never"'),
        ({"session.rnus": "3"}, "did you mean runs?"),
    ],
)
def test_a_wait_that_cannot_be_is_refused_before_anything_begins(
    tmp_path: Path, stated: dict[str, str], message: str
) -> None:
    for sources in (["demo"], ["demo", "silicon"]):
        files = [CONFIGS / f"{name}.toml" for name in sources]
        done = rig(
            "run", *files, "-o", tmp_path / "out", *set_words({"preflight.wait_max_s": "60", **stated})
        )
        assert done.returncode == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1
        assert not (tmp_path / "out").exists()


def test_sessions_have_folders_of_their_own(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="one: named twice"):
        measure_sessions([tmp_path / "one.toml", tmp_path / "b" / "one.toml"], (), None)
