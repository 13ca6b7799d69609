"""The spectrum outside the modes: sensor, air and ground come out at their levels."""

import numpy as np
import pytest
import scipy

from processing.errors import DataError
from processing.swing import residual_spectrum
from processing.swing.noise import segment_powers
from tests.processing.swing.truth import damped_sinusoid, detect


def test_white_noise_has_its_level_with_gaps_too() -> None:
    record = damped_sinusoid(np.random.default_rng(4), 300.0, 60.0, 200, noise=0.02)
    gap = (record.time_s > 200.0) & (record.time_s < 203.0)
    for seen in (record, record.keep(~gap), record.plus(np.where(gap, np.nan, 0.0))):
        found = residual_spectrum(seen.times_ns, seen.deflection, detect(seen))
        assert found.pendulum_hz == pytest.approx(0.25, rel=1e-3)
        count = len(found.density)
        assert found.density.mean() == pytest.approx(
            2 * 0.02**2 / 100.0, rel=4 * found.relative_u / count**0.5
        )
        assert found.density.std() / found.density.mean() == pytest.approx(found.relative_u, rel=0.15)


@pytest.mark.parametrize("length", [64, 75])
def test_powers_of_segments_are_those_of_welch(length: int) -> None:
    samples = 3.0 + np.random.default_rng(9).normal(size=500).cumsum()
    expected = scipy.signal.welch(samples, 1.0, nperseg=length)[1]
    assert segment_powers(samples, length).mean(axis=0) == pytest.approx(expected, rel=1e-9)


def test_what_has_no_spectrum_says_so() -> None:
    record = damped_sinusoid(np.random.default_rng(4), 300.0, 60.0, 30)
    swings = detect(record)
    with pytest.raises(DataError, match="5 good half-cycles"):
        residual_spectrum(record.times_ns, record.deflection, swings[2:7])
    with pytest.raises(DataError, match="without a gap"):
        residual_spectrum(record.times_ns, record.deflection, swings)
