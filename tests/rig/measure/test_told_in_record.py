"""A record says how its session stood: phase, light, how it kept up, the live fit, the level of events."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.events import Severity
from acquisition.record.reader import RecordReader
from acquisition.record.topics import (
    EVENT,
    RecordedEstimate,
    RecordedFittedPoint,
    RecordedHealth,
    RecordedLight,
    RecordedPhase,
)
from rig.control import Light
from rig.instrument import Phase, RunNow, piece_contents
from rig.measure import measure_session
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunOutcome
from rig.terminal import plain_values
from tests.rig.command_line import CONFIGS, SMALL, configured


def read_again(record: Path) -> RunNow:
    """The state of a run as a reader of its whole record adds it up."""
    now = RunNow()
    with RecordReader(record) as reader:
        times_ns = reader.spots()["time_ns"]
        for piece in reader.unread():
            now = now.after(
                piece_contents(reader, piece, int(times_ns[0]), int(times_ns[-1])), reader.deflection_unit
            )
    return now


@pytest.mark.slow
def test_a_record_says_how_its_session_stood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usual, outcomes = MeasurementRun.execute, []

    def kept(run: MeasurementRun, *words: Any) -> RunOutcome:
        outcomes.append(usual(run, *words))
        return outcomes[-1]

    monkeypatch.setattr(MeasurementRun, "execute", kept)
    # without a limit that holds the fits are made all the same, and waited for: the run repeats exactly
    stated = {**SMALL, "session.max_duration_s": "88", "session.stop_when": '["u(b)/b < 1e-9"]'}
    config = configured(stated)
    measure_session(config, CONFIGS / "demo.toml", tmp_path / "out")
    record = tmp_path / "out" / "run-1.mcap"
    # who reads the record sees what the screen has shown; that it is closed it cannot say
    last = replace(outcomes[0].last, phase=Phase.CLOSING)
    shown, read = (plain_values(asdict(one)) for one in (last, read_again(record)))
    assert shown == read
    with RecordReader(record) as reader:
        phases = reader.values(RecordedPhase)
        lights = reader.values(RecordedLight)
        healths = reader.values(RecordedHealth)
        estimates = reader.values(RecordedEstimate)
        points = reader.values(RecordedFittedPoint)
        levels = {
            EVENT.decode(one.data)[1]: EVENT.decode(one.data)[3] for one in reader.messages(EVENT.topic)
        }
        frames, swings = len(reader.spots()), reader.swings()
    assert [one.phase for one in phases] == [Phase.MEASURING, Phase.CLOSING]
    assert "time limit" in phases[-1].reason
    # this rig controls no laser
    assert (lights[-1].light, lights[-1].trip) == (Light.UNKNOWN, 0)
    # with the first block of 64 frames after each second
    assert len(healths) == pytest.approx(69, abs=3)
    assert np.isnan(healths[-1].frame_age_s)
    assert healths[-1].frames == pytest.approx(frames, abs=200)
    assert levels["start"] == levels["stop"] == Severity.INFORMATION
    last = [one for one in estimates if one.time_ns == estimates[-1].time_ns]
    assert {"b", "c"} <= {one.quantity for one in last}
    assert last[0].half_cycles <= len(swings)
    beside = [one for one in points if one.time_ns == points[-1].time_ns]
    assert len(beside) == last[0].half_cycles
