"""Columns of times in exact nanoseconds, and second oscillations in the samples of a table."""

import math
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.errors import DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import timestamps_ns

_REMEDY: Final = (
    "sort the rows, remove one that stands there twice, or name the time column with --time; several runs "
    "need a blank line between them or a column 'run'; a clock of too few digits can be replaced by the rate "
    "of the rows (--rate HZ)"
)
"""Remedy for times that do not increase."""
_MAX_SPAN_S: Final = 1e9  # thirty years; 64 bits of nanoseconds hold nine times as much
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
    path: Path, cells: Sequence[str], unit: str | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    """Times since the first one in ns, the rows that have a time, and the first time in ns.

    `unit` is that of numbers; None for dates and times of day. Raises DataError if times do not increase.
    """
    whole_ns: Sequence[int]
    if unit is None:
        found = timestamps_ns(cells)
        good, whole_ns = (
            np.array([one is not None for one in found]),
            [one for one in found if one is not None],
        )
    else:
        size_ns, values = round(conversion(unit, "ns")), np.array([number(cell) for cell in cells])
        good = np.isfinite(values)
        values = values[good]
        span_s = (
            float(values.max()) * seconds(size_ns) - float(values.min()) * seconds(size_ns)
            if len(values)
            else 0
        )
        if not span_s <= _MAX_SPAN_S:
            raise DataError(
                f"{path}: the times span {span_s:.3g} s, which no decay lasts; state their unit (--time-unit "
                "ms, us or ns), or name the time column with --time"
            )
        if not len(values) or np.abs(values).max() < _MAX_EXACT_NS / size_ns:
            whole_ns = np.round(values * size_ns).astype(np.int64).tolist()
        else:
            whole_ns = [
                round(Decimal(cell) * size_ns) for cell, kept in zip(cells, good, strict=True) if kept
            ]
    if len(whole_ns) < 2:
        raise DataError(
            f"{path}: {len(whole_ns)} rows have a time, {cells[0]!r} is none; write dates as 2024-05-01 "
            "12:00:00, or name another time column with --time"
        )
    times_ns = np.array([one - whole_ns[0] for one in whole_ns], dtype=np.int64)
    backwards = np.nonzero(np.diff(times_ns) <= 0)[0]
    if len(backwards):
        row = int(backwards[0])
        before, after = np.asarray(cells)[good][row : row + 2]
        raise DataError(
            f"{path}: time does not increase after {before} (row {row + 1}): {after} follows; {_REMEDY}"
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
"""Smallest second oscillation relative to the swing; below are rounding of the table and side lobes."""


def fast_oscillation(times_ns: NDArray[np.int64], deflection: NDArray[np.float64], period_s: float) -> str:
    """A warning of a weaker oscillation that holds most of the power beside the swing; else empty.

    Such an oscillation adds to the noise of a sample, and so to every uncertainty, without another sign.
    """
    found = _spectrum(times_ns, deflection, period_s)
    power = np.zeros(0) if found is None else np.abs(found.rest) ** 2
    rest = float(power.sum())
    if found is None or not rest > 0 or not found.swing > 0:
        return ""
    k = int(np.argmax(power))
    near = found.near(k)
    line = float(power[near].sum())
    size = (line / found.swing) ** 0.5
    if line < _MIN_REST_FRACTION * rest or size < _MIN_RELATIVE_SIZE:
        return ""
    middle = float(np.average(np.arange(len(power))[near], weights=power[near]))
    return (
        f"the samples hold a second oscillation at {middle / found.span_s:.3g} Hz, {size:.2g} times as large "
        "as the swing: it counts as noise of the samples and widens every uncertainty; filter or damp it, "
        "or choose a position that does not see it (--position)"
    )


def fast_mode_ratio(
    times_ns: NDArray[np.int64], along: NDArray[np.float64], across: NDArray[np.float64], period_s: float
) -> float:
    """Ratio of the fast mode along the swing to the fast mode across it, if the modes are not at a right
    angle.

    Positions across, multiplied by it and subtracted from those along, leave the swing alone. It is 0 if no
    fast mode is seen across, if the motion along is not related to it, or if it is an overtone of the swing,
    which a swing without a plane has in both positions.
    """
    good = np.isfinite(along) & np.isfinite(across)
    # across the swing overtones are absent, but a fast mode may lie next to one
    found = [_spectrum(times_ns[good], one[good], period_s, overtones=1) for one in (along, across)]
    if found[0] is None or found[1] is None:
        return 0.0
    power = np.abs(found[1].rest) ** 2
    k = int(np.argmax(power))
    turns = found[1].span_s / period_s
    if abs(k - max(round(k / turns), 1) * turns) < _OVERTONE_BINS:
        return 0.0
    line = found[1].near(k)
    x, y = found[1].rest[line], found[0].rest[line]
    if not float(power[line].sum()) > _MIN_REST_FRACTION * float(power.sum()):
        return 0.0
    weight, part, common = np.ones(len(x)), 0.0, 0.0
    for _ in range(_ITERATIONS):
        both, power_x, power_y = (
            float(np.sum(weight * one)) for one in ((x.conj() * y).real, np.abs(x) ** 2, np.abs(y) ** 2)
        )
        part, common = both / power_x, both**2 / (power_x * power_y)
        left = np.abs(y - part * x)
        # an overtone of the swing may lie near the line, so outlying frequencies get little weight
        weight = 1.0 / (1.0 + (left / (_OUTLIER_SCALE * float(np.median(left)))) ** 2)
    return part if len(x) * common > _MIN_COHERENCE_RATIO * (1.0 - common) else 0.0


class _Spectrum(NamedTuple):
    """Spectrum of the longest stretch without a gap: its duration, the swing's power, and all other lines."""

    span_s: float
    swing: float
    rest: NDArray[np.complex128]

    @staticmethod
    def near(k: float) -> slice:
        """The bins of the line at the k-th frequency."""
        width = max(_MIN_HALF_WIDTH_BINS, round(_RELATIVE_HALF_WIDTH * k))
        return slice(max(round(k) - width, 0), round(k) + width + 1)


def _spectrum(
    times_ns: NDArray[np.int64],
    deflection: NDArray[np.float64],
    period_s: float,
    overtones: int = _LAST_OVERTONE,
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
    turns = float(even_s[-1]) / period_s
    swing = float(np.sum(np.abs(rest[_Spectrum.near(turns)]) ** 2))
    rest[: _MIN_HALF_WIDTH_BINS + 1] = 0.0
    for overtone in range(1, overtones + 1):
        rest[_Spectrum.near(overtone * turns)] = 0.0
    # slower motion is ground or rest position, which the fits model, or a side lobe of the swing's line
    rest[: round(_MIN_FAST_RATIO * turns)] = 0.0
    return _Spectrum(float(even_s[-1]), swing, rest)
