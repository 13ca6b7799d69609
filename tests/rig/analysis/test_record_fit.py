"""From a closed record to its results: what they say of the run, and what a series needs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from rig.analysis import AnalysedRun, analyse_record, read_results, session_results


def test_a_record_alone_gives_the_results_of_its_session(
    analysed_series: Sequence[AnalysedRun], measured_series: Path
) -> None:
    for alone, run in zip(analysed_series, read_results(measured_series).runs, strict=True):
        assert alone.sha256 == run.sha256
        assert alone.fits["exact"].parameters == run.fits["exact"].parameters


def test_results_say_what_the_record_holds(analysed_series: Sequence[AnalysedRun]) -> None:
    run = analysed_series[0]
    with RecordReader(run.path) as reader:
        spots, half_cycles = reader.spots(), reader.half_cycles()
    assert run.frames == len(spots)
    assert run.dropped_frames == spots["sequence"][-1] + 1 - len(spots)
    assert run.simulated
    assert run.ended is not None
    good = [h for h in half_cycles if not h.flags]
    assert 0 < run.half_cycles <= len(good)
    assert run.amplitude_unit == "arcsec"
    assert run.amplitudes[0] == pytest.approx(124, abs=4)
    assert run.amplitudes[1] < run.amplitudes[0]
    assert run.turning_points is not None
    assert not run.problem
    assert {verdict.name for verdict in run.conditions} >= {"lost spots", "dropped frames"}
    assert run.rig is not None
    assert run.rig.rest_rad == pytest.approx(float(np.median([h.centre for h in good])), abs=1e-7)


@pytest.mark.slow
def test_a_clock_that_is_slow_makes_the_period_longer(analysed_series: Sequence[AnalysedRun]) -> None:
    slow = analyse_record(
        analysed_series[0].path, ["timebase.camera_rate=1.001", "timebase.u_camera_rate=1e-6"]
    )
    before, after = (run.fits["exact"].estimate("period0_s") for run in (analysed_series[0], slow))
    # what is known of the air stands in s and does not become longer with the clock
    assert after.value / 1.001 == pytest.approx(before.value, abs=0.05 * before.standard_uncertainty)
    assert slow.half_cycles == analysed_series[0].half_cycles


def test_what_all_fits_warn_of_is_said_once_and_what_one_does_with_its_name(
    analysed_series: Sequence[AnalysedRun],
) -> None:
    from rig.analysis.half_cycle_fits import _fit_warnings

    fits = analysed_series[0].fitted
    names = list(fits)
    assert len(names) > 1
    both = {name: replace(fit, warnings=("few half-cycles",)) for name, fit in fits.items()}
    assert _fit_warnings(both) == ["few half-cycles"]
    both[names[1]] = replace(fits[names[1]], warnings=("few half-cycles", "at a limit"))
    assert _fit_warnings(both) == ["few half-cycles", f"{names[1]} fit: at a limit"]


def test_a_series_needs_two_fitted_runs(
    analysed_series: Sequence[AnalysedRun], measured_series: Path
) -> None:
    both = session_results(analysed_series, measured_series)
    assert [run.record for run in both.runs] == ["run-1.mcap", "run-2.mcap"]
    assert both.series is not None
    assert both.series.runs == 2
    unfitted = replace(analysed_series[1], fitted={})
    for fewer in (analysed_series[:1], [analysed_series[0], unfitted], [unfitted, unfitted]):
        assert session_results(fewer, measured_series).series is None
    third = session_results([*analysed_series, unfitted], measured_series).series
    assert third is not None
    assert third.runs == 2
