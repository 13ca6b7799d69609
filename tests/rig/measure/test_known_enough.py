"""Runs that end by what they know, what the screen says of it, and who ended a run."""

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

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
from processing.errors import ConfigurationError, DataError
from processing.estimate import Estimate
from rig.control import Light
from rig.devices import FrameStream
from rig.instrument import Phase, RunNow, piece_contents
from rig.interruption import BY_USER
from rig.measure import end_of_run, record_plainly
from rig.measure.end_of_run import CONSECUTIVE_FITS, EndOfRun, StopRequest
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunOutcome
from rig.measure.run_status import estimate_rows
from rig.measure.session import measure_session
from rig.settings import StopCondition, load_configuration
from rig.terminal import plain_values
from rig.view.show import show_record
from tests.rig.command_line import CONFIGS, SMALL, configured
from tests.rig.made_up import half_cycle
from tests.rig.view.rrd_contents import column

WHEN = (StopCondition("c", 0.03), StopCondition("b", 0.01))
KNOWN = {"c": Estimate(1e-8, 2.5e-10), "b": Estimate(37e-4, 0.2e-4)}
NOT_C, NOT_B = {**KNOWN, "c": Estimate(1e-8, 4e-10)}, {**KNOWN, "b": Estimate(37e-4, 1e-4)}


@pytest.mark.parametrize(
    "before",
    [
        [],
        # fits that know too little, and fits that are none
        [None, {}, NOT_B],
        # one fit is asked about with every block of frames, and counts once
        [KNOWN] * 20 + [NOT_C],
        # a lucky dip: one that fails begins anew
        [dict(KNOWN), dict(KNOWN), NOT_C],
    ],
)
def test_a_run_ends_once_all_conditions_hold_in_fits_in_a_row(before: list[Any]) -> None:
    end = EndOfRun(0.0, 1e3, WHEN)
    for fit in (*before, *(dict(KNOWN) for _ in range(CONSECUTIVE_FITS - 1))):
        assert end.reason([], 1.0, fit) is None
    assert end.reason([], 1.0, dict(KNOWN)) == (
        "known well enough: u(c)/c = 0.025 < 0.03, u(b)/b = 0.00541 < 0.01"
    )


def test_a_run_ends_below_its_amplitude_or_at_its_time_limit() -> None:
    end = EndOfRun(2.0, 1e3)
    # one or two that are disturbed do not end it
    below, above = half_cycle(0, 1.9), half_cycle(0, 2.0)
    assert end.reason([above, below, below], 1.0, KNOWN) is None
    assert end.reason([above, below], 999.9) is None
    assert end.reason([below, below], 1.0) == "final amplitude reached"
    assert EndOfRun(0.0, 1e3).reason([half_cycle(0, 0.1)] * 9, 1e3) == "time limit of 1000 s reached"


def test_the_screen_says_what_is_known_and_what_the_end_waits_for() -> None:
    rows = dict(estimate_rows(RunNow(estimates=KNOWN, estimated_from=200), WHEN))
    assert rows["c, b"] == "(1.000 ± 0.025) × 10⁻⁸ (2.5 %),  (3.700 ± 0.020) × 10⁻³ rad⁻ᵖ (0.54 %)"
    assert rows["ends when"] == "u(c)/c = 0.025 < 0.03, u(b)/b = 0.00541 < 0.01"
    unseen = dict(estimate_rows(RunNow(estimates={"c": Estimate(1e-8, 2e-8)}), ()))
    assert unseen == {"c": "not yet seen"}
    assert estimate_rows(RunNow(), ()) == []


def read_again(record: Path) -> RunNow:
    """The state of a run as a reader of its whole record adds it up."""
    now = RunNow()
    with RecordReader(record) as reader:
        times_ns = reader.spots()["time_ns"]
        for piece in reader.unread():
            now = now.with_contents(
                piece_contents(reader, piece, int(times_ns[0]), int(times_ns[-1])), reader.deflection_unit
            )
    return now


@pytest.mark.slow
def test_a_session_ends_by_what_it_knows_and_its_record_says_how_it_stood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Phase, light, how it kept up, the live fit, the level of events."""
    usual, outcomes = MeasurementRun.execute, []

    def kept(run: MeasurementRun, *words: Any) -> RunOutcome:
        outcomes.append(usual(run, *words))
        return outcomes[-1]

    monkeypatch.setattr(MeasurementRun, "execute", kept)
    monkeypatch.setattr(end_of_run, "CONSECUTIVE_FITS", 2)
    wanted = {**SMALL, "camera.frame_rate_hz": "25", "session.stop_when": '["u(p)/p < 0.9"]'}
    record = tmp_path / "run-1.mcap"
    assert record_plainly(configured(wanted), CONFIGS / "demo.toml", record) == 0
    show_record(record, rrd=tmp_path / "run-1.rrd")
    _, drawn = column(tmp_path / "run-1.rrd", "/parameters/period0_s", "Measurements:values")
    assert drawn[0][0] == pytest.approx(4.071, rel=0.02)
    # who reads the record sees what the screen has shown; that it is closed it cannot say
    last = replace(outcomes[0].last, phase=Phase.CLOSING)
    shown, read = (plain_values(asdict(one)) for one in (last, read_again(record)))
    assert shown == read
    with RecordReader(record) as reader:
        ended = reader.events()[-1].text
        phases, lights = reader.values(RecordedPhase), reader.values(RecordedLight)
        healths, estimates = reader.values(RecordedHealth), reader.values(RecordedEstimate)
        points = reader.values(RecordedFittedPoint)
        decoded = [EVENT.decode(one.data) for one in reader.messages(EVENT.topic)]
        frames, half_cycles = len(reader.spots()), reader.half_cycles()
    assert [one.phase for one in phases] == [Phase.MEASURING, Phase.CLOSING]
    assert re.fullmatch(r"known well enough: u\(p\)/p = 0\.\d+ < 0\.9", ended)
    assert phases[-1].reason == ended
    # fits of 40 and 42 half-cycles; the turning point of one is known some frames after it
    assert 42 <= len(half_cycles) <= 46
    # this rig controls no laser
    assert (lights[-1].light, lights[-1].trip) == (Light.UNKNOWN, 0)
    # with the first block of at most 64 frames after each second, and at the end
    apart_s = np.diff([one.time_ns for one in healths][:-1]) * 1e-9
    assert min(apart_s) >= 1.0
    assert max(apart_s) <= 1.0 + 64 / 25
    assert np.isnan(healths[-1].frame_age_s)
    assert healths[-1].frames == pytest.approx(frames, abs=200)
    levels = {event[1]: event[3] for event in decoded}
    assert levels["start"] == levels["stop"] == Severity.INFORMATION
    fitted = [one for one in estimates if one.time_ns == estimates[-1].time_ns]
    assert {"b", "c"} <= {one.quantity for one in fitted}
    assert 42 <= fitted[0].half_cycles <= len(half_cycles)
    beside = [one for one in points if one.time_ns == points[-1].time_ns]
    assert len(beside) == fitted[0].half_cycles


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["instrument.kind=persoz"], "instrument.kind = 'persoz' reports none; leave stop_when out"),
        (["camera.driver=usb3vision"], r"without \[lever\] amplitudes are in px"),
        (
            ["camera.driver=usb3vision", "lever={arm_m=1.0, pixel_pitch_m=4.8e-6}"],
            r"state mass_kg and ball_radius_m in \[pendulum\]",
        ),
    ],
)
def test_a_rig_that_fits_no_contact_is_told_before_it_measures(
    overrides: list[str], message: str, tmp_path: Path
) -> None:
    source = CONFIGS / "demo.toml"
    config = load_configuration(source, ['session.stop_when=["u(c)/c < 0.03"]', *overrides])
    said = f"session.stop_when needs the contact's parameters: {message}"
    with pytest.raises(ConfigurationError, match=said):
        measure_session(config, source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


class Stream:
    """A camera's stream that takes note of the end."""

    stopped = 0

    def request_stop(self) -> None:
        self.stopped += 1


def test_only_the_first_who_asks_ends_the_run() -> None:
    stream = Stream()
    stop = StopRequest(cast(FrameStream, stream))
    assert stop.request("final amplitude reached")
    # Ctrl-C just after the end, and in the same words
    assert not stop.request(BY_USER)
    assert not stop.request("final amplitude reached")
    stop.failed(DataError("the record cannot be read"))
    assert (stop.reason, stream.stopped) == ("final amplitude reached", 1)
