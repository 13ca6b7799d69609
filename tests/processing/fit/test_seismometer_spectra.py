"""Spectra of the drive and of a seismometer, against those of the samples that made them."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.fit import SeismometerSpectra, fit_with_seismometer
from tests.processing.fit.test_seismometer import (
    CLOCK,
    PENDULUM,
    STEP_S,
    Q,
    decay,
    on_white,
    seismometer,
    white,
    with_all_of_the_drive,
)

LINE_HZ, LINE = 0.27, 3e-8
"""A line in the ground beside the pendulum's frequency of 0.24 Hz, rad/s^2."""


def near(found: SeismometerSpectra, tenths: float = 1.0) -> np.ndarray:
    """Which frequencies lie within so many tenths of the pendulum's."""
    frequency = np.array(found.frequency_hz)
    middle = np.median(frequency)
    return np.asarray(np.abs(frequency / middle - 1) < 0.1 * tenths)


def mean(density: tuple[float, ...], where: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(density)[where])))


def density_of_samples(value: Floats, low_hz: float, high_hz: float) -> float:
    """One-sided density of samples in a band, by one spectrum over all of them."""
    frequency = np.fft.rfftfreq(len(value), STEP_S)
    power = 2 * STEP_S * np.abs(np.fft.rfft(value)) ** 2 / len(value)
    return float(np.sqrt(np.mean(power[(frequency > low_hz) & (frequency < high_hz)])))


def test_the_pendulum_shows_the_drive_that_moved_it_and_the_seismometer_all_of_it() -> None:
    points, _ = on_white()
    found = with_all_of_the_drive().use.spectra
    assert found is not None
    during = white(3)[points.time_s[-1] > CLOCK]
    frequency = np.array(found.frequency_hz)
    for where in (near(found), (frequency > 0.26) & (frequency < 0.31), (frequency > 0.17) & near(found, 3)):
        stated = density_of_samples(during, frequency[where].min(), frequency[where].max())
        assert mean(found.pendulum_rad_per_s2_rthz, where) == pytest.approx(stated, rel=0.12)
        assert mean(found.seismometer_rad_per_s2_rthz, where) == pytest.approx(stated, rel=0.12)
    # what is left is the measurement's noise, which grows away from the pendulum's frequency
    wide = near(found, 5.0)
    ratio = mean(found.left_rad_per_s2_rthz, wide) / mean(found.measurement_rad_per_s2_rthz, wide)
    assert ratio == pytest.approx(1.0, abs=0.12)
    assert mean(found.left_rad_per_s2_rthz, near(found)) < 0.1 * Q
    assert np.min(np.array(found.coherence)[near(found, 0.5)]) > 0.99
    assert found.coherence_near > 0.99


def test_noise_of_the_seismometer_takes_coherence() -> None:
    points, alone = on_white()
    noisy = seismometer(white(3) + white(4))
    found = fit_with_seismometer(points, PENDULUM, noisy, alone, averaged=False).use.spectra
    assert found is not None
    # its power is half noise, and so the coherence is a half, within what nine stretches scatter
    assert found.coherence_near == pytest.approx(0.5, abs=0.15)
    assert np.mean(found.coherence) == pytest.approx(0.5, abs=0.1)
    assert mean(found.left_rad_per_s2_rthz, near(found, 2)) == pytest.approx(Q / np.sqrt(2), rel=0.2)


def test_a_line_of_the_ground_stands_at_its_frequency() -> None:
    drive = 0.3 * white(3) + LINE * np.sin(2 * np.pi * LINE_HZ * CLOCK)
    points, alone = decay(CLOCK, drive)
    found = fit_with_seismometer(points, PENDULUM, seismometer(drive), alone, averaged=False).use.spectra
    assert found is not None
    frequency = np.array(found.frequency_hz)
    inside = np.abs(frequency - 0.24) < 0.06
    for density in (found.pendulum_rad_per_s2_rthz, found.seismometer_rad_per_s2_rthz):
        highest = frequency[inside][np.argmax(np.array(density)[inside])]
        assert highest == pytest.approx(LINE_HZ, abs=frequency[1] - frequency[0])


def test_a_run_too_short_for_stretches_has_none() -> None:
    points, alone = decay(CLOCK, white(3), last_arcsec=90.0)
    found = fit_with_seismometer(points, PENDULUM, seismometer(white(3)), alone, averaged=False).use
    assert len(points) < 56
    assert found.spectra is None
