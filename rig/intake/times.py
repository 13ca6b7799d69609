"""Columns of times in exact nanoseconds, and second oscillations in the samples of a table."""

import math
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Complexes, Flags, Floats, Ints
from processing.errors import DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import timestamps_ns

_REMEDY: Final = (
    "sort the rows, remove one that stands there twice, or name the time column with --time; several runs "
    "need a blank line between them or a column 'run'; a clock of too few digits can be replaced by the rate "
    "of the rows (--rate HZ)"
)
"""Remedy for times that do not increase."""
_MAX_SPAN_S: Final = 1e9
"""Longest time that the rows may span, thirty years; 64 bits of nanoseconds hold nine times as much."""
_MAX_EXACT_NS: Final = 2**53
"""Largest number up to which a floating-point number holds every whole number of ns."""
_MAX_LISTED: Final = 5
"""Largest number of stretches of lines that a message lists."""


def lines_text(lines: Sequence[int]) -> str:
    """The first few stretches of lines in words, as ``lines 4, 9 to 12``."""
    stretches: list[list[int]] = []
    for line in lines:
        if stretches and line == stretches[-1][1] + 1:
            stretches[-1][1] = line
        else:
            stretches.append([line, line])
    listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in stretches[:_MAX_LISTED])
    more = f" and {len(stretches) - _MAX_LISTED} more places" if len(stretches) > _MAX_LISTED else ""
    return f"line{'s' if len(lines) > 1 else ''} {listed}{more}"


def read_times(
    path: Path, cells: Sequence[str], lines: Sequence[int], unit: str | None
) -> tuple[Ints, Flags, int]:
    """Times since the first one in ns, the rows that have a time, and the first time in ns.

    `lines` are the numbers of the lines of the cells. `unit` is that of numbers; None for dates and times of
    day. Raises DataError if times do not increase.
    """
    if unit is None:
        moments = timestamps_ns(cells)
        good = np.array([moment is not None for moment in moments])
        whole_ns = [moment for moment in moments if moment is not None]
        remedy = "correct the dates"
    else:
        size_ns, values = round(conversion(unit, "ns")), np.array([number(cell) for cell in cells])
        good = np.isfinite(values)
        if np.abs(values[good]).max(initial=0.0) < _MAX_EXACT_NS / size_ns:
            whole_ns = np.round(values[good] * size_ns).astype(np.int64).tolist()
        else:
            whole_ns = [round(Decimal(cells[k]) * size_ns) for k in np.flatnonzero(good).tolist()]
        remedy = "state their unit (--time-unit ms, us or ns)"
    if len(whole_ns) < 2:
        raise DataError(
            f"{path}: {len(whole_ns)} rows have a time, {cells[0]!r} is none; write dates as 2024-05-01 "
            "12:00:00, or name another time column with --time"
        )
    # a number of 300 digits is no float
    span_s = float(Decimal(max(whole_ns) - min(whole_ns)).scaleb(-9))
    if span_s > _MAX_SPAN_S:
        raise DataError(
            f"{path}: the times span {span_s:.3g} s, which no decay lasts; {remedy}, or name the time column "
            "with --time"
        )
    times_ns = np.array([time_ns - whole_ns[0] for time_ns in whole_ns], dtype=np.int64)
    backwards = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(backwards):
        row, next_row = np.flatnonzero(good)[backwards[0] :][:2]
        raise DataError(
            f"{path}: time does not increase after {cells[row]} (line {lines[row]}): {cells[next_row]} "
            f"follows; {_REMEDY}"
        )
    return times_ns, good, whole_ns[0]


def number(cell: str) -> float:
    """The value of a cell; NaN if it is no finite number."""
    try:
        # Python reads 1_0 as ten, which no instrument writes
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


_MIN_SAMPLES: Final = 64
"""Fewest samples in which a second oscillation is searched."""
_RELATIVE_HALF_WIDTH: Final = 0.1
"""Half width of a spectral line relative to its frequency, including the width by decay."""
_MIN_HALF_WIDTH_BINS: Final = 4
_MIN_GAP_STEPS: Final = 3.0
"""Shortest gap, in steps between samples."""
_MIN_FAST_RATIO: Final = 1.5
"""Lowest frequency of a fast oscillation, in units of the swing's frequency."""
_LAST_OVERTONE: Final = 5
_OVERTONE_BINS: Final = 2.0
"""Distance from an overtone, in bins of the spectrum, within which a line cannot be separated from it."""
_MIN_REST_FRACTION: Final = 0.5
"""Fraction of power beside the swing in a second oscillation; white noise has a fifth in a line at most."""
_ITERATIONS: Final = 10
_OUTLIER_SCALE: Final = 2.0
"""Residual, in median residuals, beyond which a frequency gets little weight."""
_MIN_COHERENCE_RATIO: Final = 20.0
"""Least coherent over incoherent power of related positions, times the number of frequencies; 1 by chance."""
_KAISER_BETA: Final = 12.0
"""Parameter of Kaiser's window: a swing's line reaches four bins to each side and its side lobes lie
below 1e-4 of it, so that those of a few swings are no second oscillation."""
_MIN_RELATIVE_SIZE: Final = 3e-4
"""Smallest second oscillation relative to the swing; rounding of the table and side lobes are smaller."""


def fast_oscillation(times_ns: Ints, deflection: Floats, period_s: float) -> str:
    """A warning of a weaker oscillation that holds most of the power beside the swing; else empty.

    Such an oscillation adds to the noise of a sample, and so to every uncertainty, without another sign.
    """
    spectrum = _spectrum(times_ns, deflection, period_s)
    if spectrum is None:
        return ""
    power = np.abs(spectrum.rest) ** 2
    rest = float(power.sum())
    if not rest > 0 or not spectrum.swing > 0:
        return ""
    line = spectrum.near(int(np.argmax(power)))
    line_power = float(power[line].sum())
    size = (line_power / spectrum.swing) ** 0.5
    if line_power < _MIN_REST_FRACTION * rest or size < _MIN_RELATIVE_SIZE:
        return ""
    centre = float(np.average(np.arange(len(power))[line], weights=power[line]))
    return (
        f"the samples hold a second oscillation at {centre / spectrum.span_s:.3g} Hz, {size:.2g} times as "
        "large as the swing: it counts as noise of the samples and widens every uncertainty; filter or damp "
        "it, or choose a position that does not see it (--position)"
    )


def fast_mode_ratio(times_ns: Ints, along: Floats, across: Floats, period_s: float) -> float:
    """Fast mode along the swing over the fast mode across it, for modes that are not at a right angle.

    Positions across, multiplied by this ratio and subtracted from those along, leave the swing alone. The
    ratio is 0 if no fast mode is seen across, if the motion along is not related to it, or if it is an
    overtone of the swing, which a swing without a plane has in both positions.
    """
    good = np.isfinite(along) & np.isfinite(across)
    # across the swing overtones are absent, but a fast mode may lie next to one
    of_y, of_x = (
        _spectrum(times_ns[good], values[good], period_s, overtones=1) for values in (along, across)
    )
    if of_y is None or of_x is None:
        return 0.0
    power = np.abs(of_x.rest) ** 2
    k = int(np.argmax(power))
    cycles = of_x.span_s / period_s
    if abs(k - max(round(k / cycles), 1) * cycles) < _OVERTONE_BINS:
        return 0.0
    line = of_x.near(k)
    x, y = of_x.rest[line], of_y.rest[line]
    if not float(power[line].sum()) > _MIN_REST_FRACTION * float(power.sum()):
        return 0.0
    weight, ratio, coherence = np.ones(len(x)), 0.0, 0.0
    for _ in range(_ITERATIONS):
        cross, power_x, power_y = (
            float(np.sum(weight * term)) for term in ((x.conj() * y).real, np.abs(x) ** 2, np.abs(y) ** 2)
        )
        ratio, coherence = cross / power_x, cross**2 / (power_x * power_y)
        residual = np.abs(y - ratio * x)
        # an overtone of the swing may lie near the line, so outlying frequencies get little weight
        weight = 1.0 / (1.0 + (residual / (_OUTLIER_SCALE * float(np.median(residual)))) ** 2)
    return ratio if len(x) * coherence > _MIN_COHERENCE_RATIO * (1.0 - coherence) else 0.0


class _Spectrum(NamedTuple):
    """Spectrum of the longest stretch without a gap."""

    span_s: float
    """Duration of the stretch."""
    swing: float
    """Power of the swing's line."""
    rest: Complexes
    """Amplitudes at all frequencies; 0 at the swing's line, its overtones and lower frequencies."""

    @staticmethod
    def near(k: float) -> slice:
        """The bins of the line at the k-th frequency."""
        width = max(_MIN_HALF_WIDTH_BINS, round(_RELATIVE_HALF_WIDTH * k))
        return slice(max(round(k) - width, 0), round(k) + width + 1)


def _spectrum(
    times_ns: Ints, deflection: Floats, period_s: float, overtones: int = _LAST_OVERTONE
) -> _Spectrum | None:
    """The spectrum without the swing and its overtones up to `overtones`; None with too few samples."""
    good = np.isfinite(deflection)
    if np.count_nonzero(good) < _MIN_SAMPLES:
        return None
    time_s, values = seconds(times_ns[good] - times_ns[0]), deflection[good]
    # interpolation across a gap would replace the swing by a straight line, with spectral lines of its own
    steps_s = np.diff(time_s)
    borders = np.flatnonzero(steps_s > _MIN_GAP_STEPS * float(np.median(steps_s))) + 1
    longest = max(np.split(np.arange(len(time_s)), borders), key=len)
    time_s, values = time_s[longest] - time_s[longest[0]], values[longest]
    if len(time_s) < _MIN_SAMPLES:
        return None
    even_s = np.linspace(0.0, time_s[-1], len(time_s))
    even = np.interp(even_s, time_s, values)
    rest = np.fft.rfft((even - even.mean()) * np.kaiser(len(even), _KAISER_BETA))
    cycles = float(even_s[-1]) / period_s
    swing = float(np.sum(np.abs(rest[_Spectrum.near(cycles)]) ** 2))
    rest[: _MIN_HALF_WIDTH_BINS + 1] = 0.0
    for overtone in range(1, overtones + 1):
        rest[_Spectrum.near(overtone * cycles)] = 0.0
    # slower motion is ground or rest position, which the fits model, or a side lobe of the swing's line
    rest[: round(_MIN_FAST_RATIO * cycles)] = 0.0
    return _Spectrum(float(even_s[-1]), swing, rest)
