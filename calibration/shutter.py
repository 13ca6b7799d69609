"""Rolling shutter, which exposes the rows of an image one after the other, and the fit of its row time.

A spot that is centred on row y was exposed ``y * row_time_s`` after the first row. If it swings across the
rows, its times are modulated by its own position, and a swing ``A cos(w t)`` gets a second harmonic
``-(A^2 w row_time / 2) sin(2 w t)``, from which the row time is measured.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.units import NS_PER_S

_STRETCH_PERIODS = 3.0
"""Length in periods of a stretch that is fitted by itself, short enough for a nearly constant amplitude."""
_HARMONICS = (1, 2, 3, 5, 7, 9)
"""Harmonics of a stretch. Friction and elasticity of the contact make the odd ones, which fade within it; if
they were left out, the second would contain part of them.
"""
_ITERATIONS = 4
_MIN_STRETCHES = 6
_MIN_FRAMES = 60
_MIN_PATH_PX = 20.0
_MIN_AMPLITUDE_FRACTION = 0.2
"""Smallest amplitude of a stretch that is used, over the largest; the effect goes with its square."""


@dataclass(frozen=True, slots=True)
class Shutter:
    """Times of exposure of the rows of an image: `row_time_s` from one row to the next, 0 for all at once.

    The time of a frame is that of its first row. The row time holds for the rows of the image as delivered;
    another binning or pixel format may change it. `first_row` is exposed first: the row y = 0 of the image,
    or of its region of interest, if it is "top", the last one if it is "bottom".
    """

    row_time_s: float = field(
        default=0.0, metadata={"ge": 0, "lt": 1e-2, "description": "0: all rows at once (global shutter)"}
    )
    u_row_time_s: float = field(default=0.0, metadata={"ge": 0})
    first_row: Literal["top", "bottom"] = "top"

    def times_ns(self, frame_times_ns: Ints, y_px: Floats, rows: int) -> Ints:
        """Times (n,) of spots at `y_px` in frames with these times and `rows` rows.

        A frame without a spot (NaN) gets the time of its middle row. Times keep their order as long as the
        rows take less than the interval of the frames.
        """
        if not self.row_time_s:
            return frame_times_ns
        row = y_px if self.first_row == "top" else rows - 1 - y_px
        row = np.where(np.isfinite(row), row, 0.5 * (rows - 1))
        return frame_times_ns + np.rint(NS_PER_S * self.row_time_s * row).astype(np.int64)


GLOBAL = Shutter()


@dataclass(frozen=True, slots=True)
class ShutterFit:
    """Row time from a swing; it is negative if the bottom row is exposed first."""

    row_time_s: float
    u_row_time_s: float
    """Includes the scatter of the stretches."""
    amplitude_px: float
    """Largest amplitude of the stretches."""
    harmonic_px: float
    """Amplitude of the second harmonic that the row time causes at `amplitude_px`."""
    even_per_px: float
    """Second harmonic from the geometry, which is in phase, over the squared amplitude."""
    chi2_per_dof: float
    """Scatter of the stretches over their uncertainties."""
    stretches: int


def fit_row_time(times_s: Floats, y_px: Floats) -> ShutterFit:
    """Row time from the swing of a spot across the rows.

    Parameters
    ----------
    times_s, y_px : (n,)
        Times of the frames, not corrected for the shutter, and the spot's row; NaN is left out.

    Raises
    ------
    DataError
        The spot moves over fewer than 20 rows, or the run has fewer than six stretches of three periods.

    Notes
    -----
    In each stretch the Fourier coefficients C_k of ``y = Re sum C_k exp(i k w t)`` are fitted, with slow
    changes of offset and amplitudes. The shutter adds i w row_time / 2 to C2 / C1^2; an effect that is
    symmetric in time about the turning points (the lever's tangent, a tilted sensor) adds a real number.
    """
    good = np.isfinite(y_px)
    times_s, y_px = times_s[good] - times_s[good][:1].sum(), y_px[good]
    path_px = float(np.ptp(y_px)) if len(y_px) else 0.0
    if path_px < _MIN_PATH_PX:
        raise DataError(
            f"row time: the spot moves over {path_px:.3g} rows, at least {_MIN_PATH_PX:g} are needed: "
            "let it swing further, with the slow axis along the columns"
        )
    period_s = _period(times_s, y_px)
    length_s = _STRETCH_PERIODS * period_s
    count = int((times_s[-1] - times_s[0]) / length_s)
    rows = []
    for begin_s in times_s[0] + length_s * np.arange(count):
        stretch = slice(*np.searchsorted(times_s, [begin_s, begin_s + length_s]))
        if stretch.stop - stretch.start >= _MIN_FRAMES:
            rows.append(_harmonics(times_s[stretch], y_px[stretch], period_s))
    table = np.array(rows).reshape(-1, 4)
    if len(table):
        table = table[table[:, 3] > _MIN_AMPLITUDE_FRACTION * table[:, 3].max()]
    if len(table) < _MIN_STRETCHES:
        raise DataError(
            f"row time: {len(table)} stretches of {_STRETCH_PERIODS:g} periods ({period_s:.3g} s) have a "
            f"swing, {_MIN_STRETCHES} are needed; record for longer"
        )
    row_times_s, u_row_times_s, even, amplitude_px = table.T
    weight = u_row_times_s**-2.0
    mean_s = float(np.average(row_times_s, weights=weight))
    chi2, dof = float(np.sum(weight * (row_times_s - mean_s) ** 2)), len(table) - 1
    largest_px = float(amplitude_px.max())
    return ShutterFit(
        row_time_s=mean_s,
        # a scatter of so few stretches is itself uncertain (the variance of Student's t)
        u_row_time_s=float(weight.sum() ** -0.5) * max(chi2 / (dof - 2), 1.0) ** 0.5,
        amplitude_px=largest_px,
        harmonic_px=abs(mean_s) * np.pi / period_s * largest_px**2,
        even_per_px=float(np.average(even, weights=weight)),
        chi2_per_dof=chi2 / dof,
        stretches=len(table),
    )


def _period(times_s: Floats, y_px: Floats) -> float:
    """Mean period, from the first and the last upward crossing of the middle between the extremes."""
    deflection_px = y_px - 0.5 * (y_px.max() + y_px.min())
    # frames near the middle are left out, because noise would make them cross it several times
    outer = np.flatnonzero(np.abs(deflection_px) > 0.05 * np.ptp(y_px))
    is_above = deflection_px[outer] > 0
    last_below = np.flatnonzero(~is_above[:-1] & is_above[1:])
    if len(last_below) < 2:
        raise DataError("row time: the spot does not swing to and fro across the rows; record a whole run")
    crossing_s = 0.5 * (times_s[outer[last_below]] + times_s[outer[last_below + 1]])
    return float(np.median(np.diff(crossing_s)))


def _harmonics(times_s: Floats, y_px: Floats, period_s: float) -> tuple[float, float, float, float]:
    """Row time and its standard uncertainty in s, even part of C2 / C1^2, and |C1|, of one stretch."""
    since_s = times_s - 0.5 * (times_s[0] + times_s[-1])
    periods = since_s / period_s
    rate = 2.0 * np.pi / period_s
    row_time_s = 0.0
    for _ in range(_ITERATIONS):
        phase = rate * (since_s + row_time_s * y_px)
        waves = np.exp(1j * np.outer(phase, _HARMONICS))
        # all change slowly, the first one also in amplitude and period, and as strong drag curves its decay
        curvature = periods[:, None] ** [2, 3] * waves[:, :1]
        waves = np.hstack([waves, periods[:, None] * waves, curvature])
        design = np.column_stack([np.ones_like(periods), periods, waves.real, -waves.imag])
        values, *_ = np.linalg.lstsq(design, y_px, rcond=None)
        real, imaginary = values[2:].reshape(2, -1)
        amplitudes = real + 1j * imaginary
        first, second, third, growth = amplitudes[[0, 1, 2, len(_HARMONICS)]]
        # the second harmonic of the squared position, to which the third of the position contributes
        ratio = complex(second / (first**2 + 2.0 * first.conjugate() * third))
        row_time_s += 2.0 * ratio.imag / rate
        # d(phase)/dt follows from the part in quadrature that grows with time, and corrects the frequency
        rate += (growth / first).imag / period_s
    residual = y_px - design @ values
    variance = float(residual @ residual) / max(len(y_px) - design.shape[1], 1)
    second_columns = (3, 3 + len(amplitudes))
    u2_second = variance * np.linalg.inv(design.T @ design)[second_columns, second_columns].mean()
    amplitude = float(abs(first))
    return row_time_s, 2.0 * float(np.sqrt(u2_second)) / amplitude**2 / rate, ratio.real, amplitude
