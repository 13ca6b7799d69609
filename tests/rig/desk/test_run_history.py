"""The history of a run: decimated, with nothing that stands out lost."""

import math

import numpy as np
import pytest

from acquisition.record.topics import RecordedFittedPoint
from processing.deflections import Deflections, DeflectionUnit
from processing.swing import Swing
from processing.units import ARCSEC_RAD
from rig.desk.run_history import Extremes, RunHistory, spectrum

SECOND_NS = 1_000_000_000


def deflections(time_s: np.ndarray, x: np.ndarray, y: np.ndarray) -> Deflections:
    none = np.zeros_like(x)
    return Deflections((time_s * 1e9).astype(np.int64), x, y, none, none, DeflectionUnit.PX)


def test_a_spike_of_one_sample_is_kept_however_long_the_run_is() -> None:
    rng = np.random.default_rng(1)
    kept = Extremes(1, most=100)
    time_s = np.arange(0.0, 4000.0, 0.01)
    values = rng.normal(size=len(time_s))
    values[123_456], values[300_001] = 50.0, -60.0
    place = 0
    while place < len(time_s):
        more = int(rng.integers(1, 900))
        kept.take(time_s[place : place + more], values[np.newaxis, place : place + more])
        place += more
    curve = kept.curve(0)
    assert len(curve) <= 200
    y = [one for _, one in curve if one is not None]
    assert (max(y), min(y)) == (50.0, -60.0)
    at_s = next(t for t, one in curve if one == 50.0)
    assert at_s == pytest.approx(1234.56, abs=80.0)
    assert [t for t, _ in curve] == sorted(t for t, _ in curve)


def test_lost_spots_are_gaps_and_no_numbers() -> None:
    kept = Extremes(1)
    kept.take(np.array([0.0, 0.5, 1.0]), np.array([[1.0, math.nan, 2.0]]))
    assert [one for _, one in kept.curve(0)] == [1.0, None, 2.0]


def test_the_spectrum_has_its_peak_where_the_swing_is() -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    found = spectrum([deflections(time_s, np.sin(2 * np.pi * 3.0 * time_s), np.zeros_like(time_s))])
    assert found["f"][int(np.argmax(found["x"]))] == pytest.approx(3.0, abs=0.15)
    assert spectrum([]) == {"f": [], "x": [], "y": []}


def test_a_fit_is_told_at_the_times_of_the_record_in_arcsec() -> None:
    history = RunHistory()
    assert history.told()["fit"] == {}
    start_ns = 5 * SECOND_NS
    swing = Swing(0, start_ns + SECOND_NS, 1e-4, 3e-4, 1e-9, 2.0, 1e-4, 0.0, 1, 0)
    history.swing(start_ns, swing, ARCSEC_RAD)
    history.fitted([RecordedFittedPoint(9, start_ns, 3e-4, 0.0)])
    history.fitted(
        [
            RecordedFittedPoint(10, start_ns + SECOND_NS, 3e-4, 1.234),
            RecordedFittedPoint(10, start_ns + 3 * SECOND_NS, 2.9e-4, -0.5, 4.01, 0.25),
        ]
    )
    told = history.told()["fit"]
    assert told["amplitude"][1] == (3.0, pytest.approx(2.9e-4 / ARCSEC_RAD, abs=1e-5))
    assert told["amplitude_residual"] == [(1.0, 1.23), (3.0, -0.5)]
    assert told["period"] == [(3.0, 4.01)]
    assert told["period_residual"] == [(3.0, 0.25)]
