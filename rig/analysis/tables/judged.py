"""What a table holds that can be read, but is hardly what it was read as: refused, with what to state."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.ticks import seconds
from processing.units import conversion
from rig.analysis.tables.column_units import NOT_STATED_TIME
from rig.analysis.tables.numbers import MOMENT, is_missing
from rig.analysis.tables.times import number
from rig.analysis.trajectory import ANGLES

_LARGEST_RAD: Final = 1.1 * math.pi
"""No pendulum swings further from its middle and comes back; a tenth for where the middle is taken to be."""
_MOST_WORDS: Final = 0.25
"""Of a column of positions that may be words; single ones are of an instrument that lost its signal."""
_LARGEST: Final = 1e60
"""Positions beyond it, or below its inverse, are no measurement, and squares leave the range of floats."""
_DAYS: Final = (30_000.0, 60_000.0)
"""Days since 1899-12-30, as spreadsheets count, from 1982 to 2064."""
_DAY_NS: Final = 86_400_000_000_000
SPREADSHEET_ZERO_NS: Final = 25_569 * _DAY_NS
"""1970 on the clock of a spreadsheet."""
_HOUR_S: Final = 3600.0


def of_spreadsheet(first_ns: int) -> bool:
    """Whether a time in days is likely one of a spreadsheet; since 1970, it would be after 2052."""
    return _DAYS[0] * _DAY_NS < first_ns < _DAYS[1] * _DAY_NS


def judge_words(path: Path, name: str, cells: Sequence[str], lines: Sequence[int]) -> None:
    """Refuse a column of which much is written so that it is not read: what is left would be no swing."""
    words = [n for n, cell in enumerate(cells) if math.isnan(number(cell)) and not is_missing(cell)]
    if len(words) > _MOST_WORDS * len(cells):
        raise DataError(
            f"{path}: {len(words)} of {len(cells)} values of {name} are no numbers, first "
            f"{cells[words[0]]!r} (line {lines[words[0]]}); write them as numbers, or name another column "
            "with --position"
        )


def judge_size(path: Path, unit: str, table: NDArray[np.float64]) -> None:
    """Refuse an angle that no pendulum swings by, and what no instrument measures in any unit."""
    sizes = np.abs(table[np.isfinite(table) & (table != 0)])
    if not len(sizes):
        return
    if not (sizes.max() < _LARGEST and np.median(sizes) > 1.0 / _LARGEST):
        raise DataError(
            f"{path}: the position is of the order of {np.median(sizes):.3g} {unit}, up to "
            f"{sizes.max():.3g}, which no instrument measures; is it the right column (--position), and are "
            "wrong values left out?"
        )
    if unit not in ANGLES:
        return
    each = float(np.max(np.nanmax(table, axis=0) - np.nanmin(table, axis=0)))
    if 0.5 * each * conversion(unit, "rad") > _LARGEST_RAD:
        raise ConfigurationError(
            f"{path}: the position goes over {each:.4g} {unit}, more than a turn: is that its unit? State "
            "another with --unit, or use a stretch (--from, --to)"
        )


def judge_days(path: Path, title: str, source: str, first_ns: int, times_ns: NDArray[np.int64]) -> None:
    """Refuse what no header calls seconds, and looks like the days of a spreadsheet."""
    first, span = seconds(first_ns), float(seconds(times_ns[-1]))
    if source == NOT_STATED_TIME and _DAYS[0] < first < _DAYS[1] and span < 1.0:
        raise ConfigurationError(
            f"{path}: {title!r} begins at {first:.10g} and goes over {span:.3g}: a spreadsheet's days, or "
            "seconds? State --time-unit d, or --time-unit s"
        )


def judge_zones(path: Path, cells: Sequence[str], times_ns: NDArray[np.int64]) -> None:
    """Refuse moments of which some have a zone, and a local clock that is put forward an hour."""
    found = [match for cell in cells if (match := MOMENT.fullmatch(cell.strip())) and match["date"]]
    with_zone = [match[0] for match in found if match["zone"]]
    without = [match[0] for match in found if not match["zone"]]
    if with_zone and without:
        raise DataError(
            f"{path}: {with_zone[0]!r} has a zone and {without[0]!r} has none; write all times with theirs, "
            "or in UTC"
        )
    steps_s = seconds(np.diff(times_ns))
    step_s = float(np.median(steps_s))
    forward = np.flatnonzero(np.abs(steps_s - step_s - _HOUR_S) < step_s)
    if without and len(forward) == 1 and step_s < 1.0:
        row = int(forward[0])
        raise DataError(
            f"{path}: {cells[row + 1]!r} follows {cells[row]!r}, an hour and one step later: was the clock "
            "set to summer time? Write the times with their zone (+01:00, then +02:00), or in UTC (...Z)"
        )
