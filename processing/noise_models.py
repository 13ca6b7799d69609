"""Low and high noise models of ground acceleration (Peterson 1993), and a robust scatter."""

import numpy as np

from processing.arrays import Floats

# Rows: shortest period in s, A, B; both models end at 1e5 s.
_NLNM = np.array(
    [
        (0.10, -162.36, 5.64),
        (0.17, -166.70, 0.00),
        (0.40, -170.00, -8.30),
        (0.80, -166.40, 28.90),
        (1.24, -168.60, 52.48),
        (2.40, -159.98, 29.81),
        (4.30, -141.10, 0.00),
        (5.00, -71.36, -99.77),
        (6.00, -97.26, -66.49),
        (10.00, -132.18, -31.57),
        (12.00, -205.27, 36.16),
        (15.60, -37.65, -104.33),
        (21.90, -114.37, -47.10),
        (31.60, -160.58, -16.28),
        (45.00, -187.50, 0.00),
        (70.00, -216.47, 15.70),
        (101.00, -185.00, 0.00),
        (154.00, -168.34, -7.61),
        (328.00, -217.43, 11.90),
        (600.00, -258.28, 26.60),
        (10_000.00, -346.88, 48.75),
    ]
)
_NHNM = np.array(
    [
        (0.10, -108.73, -17.23),
        (0.22, -150.34, -80.50),
        (0.32, -122.31, -23.87),
        (0.80, -116.85, 32.51),
        (3.80, -108.48, 18.08),
        (4.60, -74.66, -32.95),
        (6.30, 0.66, -127.18),
        (7.90, -93.37, -22.42),
        (15.40, 73.54, -162.98),
        (20.00, -151.52, 10.01),
        (354.80, -206.66, 31.63),
    ]
)
_LONGEST_S = 1e5


def nlnm_db(frequencies_hz: Floats) -> Floats:
    """New low noise model, dB of (m/s^2)^2/Hz; beyond its ends, 10 Hz and 1e-5 Hz, it is constant."""
    return _model_db(_NLNM, frequencies_hz)


def nhnm_db(frequencies_hz: Floats) -> Floats:
    """New high noise model, dB of (m/s^2)^2/Hz; beyond its ends, 10 Hz and 1e-5 Hz, it is constant."""
    return _model_db(_NHNM, frequencies_hz)


def density_of_db(level_db: Floats) -> Floats:
    """Amplitude spectral density in m/s^2/sqrt(Hz) of a level in dB."""
    return np.asarray(10 ** (level_db / 20), dtype=np.float64)


def _model_db(table: Floats, frequencies_hz: Floats) -> Floats:
    shortest_s = float(table[0, 0])
    period_s = np.clip(1 / np.asarray(frequencies_hz, dtype=np.float64), shortest_s, _LONGEST_S)
    row = np.searchsorted(table[:, 0], period_s, side="right") - 1
    return np.asarray(table[row, 1] + table[row, 2] * np.log10(period_s), dtype=np.float64)


MAD_TO_SIGMA = 1.482602218505602
"""Ratio of standard deviation to median absolute deviation of a normal distribution, 1 / 0.67449."""


def robust_scatter(values: Floats, middle: float | None = None) -> float:
    """Standard deviation of `values`, of any shape, from the median absolute deviation about `middle`.

    By default `middle` is the median. Nearly half of the values may be outliers. NaN and infinite values are
    ignored; the result is 0 if no others are left.
    """
    good = values[np.isfinite(values)]
    if len(good) == 0:
        return 0.0
    return MAD_TO_SIGMA * float(np.median(np.abs(good - (np.median(good) if middle is None else middle))))
