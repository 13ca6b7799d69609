"""A live run whose camera's clock errs in every way at once comes to its end, and says what was done."""

import time
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.events import EventKind
from acquisition.record.reader import RecordReader
from acquisition.record.topics import ClockAnchor, RecordedClockStep
from rig.analysis import analyse_record
from rig.measure import record_plainly
from rig.measure.phases import PhasesBeforeRecord
from tests.rig.command_line import CONFIGS, QUICK, configured

pytestmark = pytest.mark.slow
DAY_NS = 86_400_000_000_000


def recorded(record: Path, **changes: str) -> None:
    """A live run: its record alone, without fit and report."""
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    config = configured({**QUICK, "simulation.real_time": "true", **changes})
    record_plainly(config, CONFIGS / "demo.toml", record)


def test_wrong_times_steps_and_a_short_counter_cost_one_frame(tmp_path: Path) -> None:
    record = tmp_path / "run-1.mcap"
    faults = {"faults__clock_zero_at_s": "3", "faults__clock_steps_at_s": "5", "faults__clock_bits": "32"}
    recorded(record, **faults, session__max_duration_s="8", preflight__when='"never"')
    with RecordReader(record) as reader:
        events, losses, spots = reader.events(), reader.losses(), reader.spots()
        steps = reader.values(RecordedClockStep)
    assert "time limit" in events[-1].text
    said = [event.text for event in events if event.kind == EventKind.CAMERA_CLOCK]
    assert any("the camera's time 0 ns is" in text for text in said)
    assert any("stepped by +0.13" in text for text in said)
    assert any("begins again every 4.295 s" in text for text in said)
    assert losses is not None
    assert losses.wrong_time == 1
    times_s = spots["time_ns"] * 1e-9
    assert np.diff(times_s).min() > 0
    # what is left of the steps is less than a hundredth of a frame time
    line = np.polyval(np.polyfit(spots["sequence"], times_s, 1), spots["sequence"])
    assert np.abs(times_s - line).max() < 3e-4
    assert [step.step_ns for step in steps] == [pytest.approx(130_000_000, abs=200_000)]
    results = analyse_record(record)
    assert results.clock is not None
    assert results.clock.steps == 1
    verdict = next(one for one in results.conditions if one.name == "camera's clock")
    assert verdict.ok
    assert verdict.reason.startswith("it was taken off its times")


def test_a_record_has_the_time_of_day_at_which_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, check = time.time_ns, PhasesBeforeRecord._check

    def set_back(phases: PhasesBeforeRecord, resting: bool) -> None:
        monkeypatch.setattr(time, "time_ns", lambda: usual() - DAY_NS)
        check(phases, resting)

    monkeypatch.setattr(PhasesBeforeRecord, "_check", set_back)
    recorded(tmp_path / "run-1.mcap", session__max_duration_s="1", preflight__duration_s="1")
    with RecordReader(tmp_path / "run-1.mcap") as reader:
        anchors = reader.values(ClockAnchor)
        off_ns = anchors[0].utc_ns - anchors[0].time_ns - reader.epoch_offset_ns
    assert abs(off_ns) < 10 * 10**9, "the anchors of a record contradict its own beginning"
