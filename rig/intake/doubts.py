"""Doubts about a readable table: implausible units, sizes, times and signs, refused with a remedy."""

import math
import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np

from processing.arrays import Floats, Ints
from processing.decay_summary import DecaySummary, summarise_decay
from processing.errors import ConfigurationError, DataError
from processing.swing import HalfCycle, turning_points
from processing.units import conversion, seconds
from processing.unsigned import unsigned_period_s
from rig.intake.cell_text import is_missing
from rig.intake.times import number
from rig.intake.trajectory import ANGLE_UNITS, UNSTATED_UNIT, Trajectory
from rig.intake.units import TIME_UNITS
from rig.settings import Configuration
from rig.terminal import plain

_LARGEST_RAD: Final = 1.1 * math.pi
"""Largest amplitude of a pendulum that swings and returns, with a tenth for the uncertain rest position."""
_MAX_WORD_FRACTION: Final = 0.25
"""Fraction of a column of positions that may be words, as of an instrument that lost its signal."""
_MIN_JUMP: Final = 0.7
"""Step between samples, in units of the position's range, that no swing makes among far smaller steps."""
_MIN_JUMPS: Final = 4
_MIN_CUT_ROWS: Final = 3
"""Fewest rows in succession at the largest value that show a sensor's limit."""
_MAX_TIME_S: Final = 253_402_300_800.0
"""The end of the year 9999, in s since 1970."""
_ZONE: Final = re.compile(r"\d\d(?:Z|[+-]\d\d:?\d\d)$")
_HOUR_S: Final = 3600.0


def judge_words(path: Path, name: str, cells: Sequence[str], lines: Sequence[int]) -> None:
    """Refuse a column with many cells that are not numbers: the rest would show no swing."""
    words = [n for n, cell in enumerate(cells) if math.isnan(number(cell)) and not is_missing(cell)]
    if len(words) > _MAX_WORD_FRACTION * len(cells):
        raise DataError(
            f"{path}: {len(words)} of {len(cells)} values of {name} are no numbers, first "
            f"{cells[words[0]]!r} (line {lines[words[0]]}); write them as numbers, or name another column "
            "with --position"
        )


def judge_size(path: Path, unit: str, table: Floats) -> None:
    """Refuse an angle larger than any swing."""
    span = float(np.max(np.nanmax(table, axis=0) - np.nanmin(table, axis=0)))
    if unit in ANGLE_UNITS and 0.5 * span * conversion(unit, "rad") > _LARGEST_RAD:
        raise ConfigurationError(
            f"{path}: the position goes over {span:.4g} {unit}, more than a turn: is that its unit? State "
            "another with --unit, or use a stretch (--from, --to)"
        )


def judge_clock(path: Path, name: str, unit: str, first_ns: int, times_ns: Ints) -> None:
    """Refuse numbers of a clock in another unit (beyond the year 9999), and its digits written as one number.

    At the end of each minute such a number, 235959.95 (HHMMSS) or 59.5995 (MM.SS), jumps by 40.
    """
    first_s = float(first_ns) / 1e9
    if abs(first_s) > _MAX_TIME_S:
        raise ConfigurationError(
            f"{path}: {name!r} begins at {first_s / conversion(unit, 's'):.16g} {unit}, beyond the year "
            "9999: state its unit (--time-unit ms, us or ns), or correct the header"
        )
    times = seconds(times_ns) + first_s
    for minute, form in ((100.0, "HHMMSS"), (1.0, "MM.SS")) if unit == "s" else ():
        minutes, fraction = np.divmod(times / minute, 1.0)
        ends = np.flatnonzero(np.diff(minutes))
        if not len(ends) or np.median(np.diff(times)) > 0.01 * minute or fraction.max() >= 0.6 + 1e-9:
            continue
        if np.all(fraction[ends] > 0.58) and np.all(fraction[ends + 1] < 0.02):
            before, after = times[ends[0] : ends[0] + 2]
            raise ConfigurationError(
                f"{path}: {name!r} goes from {before:.10g} to {after:.10g} as the digits of a clock do "
                f"({form}), and is no time in s; write it with colons, or state the rate of the rows "
                "instead: --rate HZ --position COLUMN"
            )


def judge_moments(path: Path, cells: Sequence[str], times_ns: Ints) -> None:
    """Refuse moments of which only some have a time zone, and a local clock that is set to summer time."""
    zoned = [cell for cell in cells if _ZONE.search(cell.strip())]
    if 0 < len(zoned) < len(cells):
        zoneless = next(cell for cell in cells if not _ZONE.search(cell.strip()))
        raise DataError(
            f"{path}: {zoned[0]!r} has a zone and {zoneless!r} has none; write all times with theirs, "
            "or in UTC"
        )
    steps_s = seconds(np.diff(times_ns))
    step_s = float(np.median(steps_s))
    forward = np.flatnonzero(np.abs(steps_s - step_s - _HOUR_S) < step_s)
    if not zoned and len(forward) == 1 and step_s < 1.0:
        row = int(forward[0])
        raise DataError(
            f"{path}: {cells[row + 1]!r} follows {cells[row]!r}, an hour and one step later: was the clock "
            "set to summer time? Write the times with their zone (+01:00, then +02:00), or in UTC (...Z)"
        )


def unwrapped(path: Path, name: str, unit: str, values: Floats, lines: Ints) -> tuple[Floats, int]:
    """An angle with its jumps by whole turns removed, and the number of jumps.

    Raises ConfigurationError for jumps of another size against the motion, as by a turn in another unit.
    """
    finite = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[finite])
    span = float(np.ptp(values[finite])) if len(finite) else 0.0
    turn = conversion("rad", unit) * 2.0 * math.pi if unit in ANGLE_UNITS else math.inf
    if span <= 1.001 * turn < math.inf and (count := int(np.count_nonzero(np.abs(steps) > 0.5 * turn))):
        continuous = values.copy()
        continuous[finite] = np.unwrap(values[finite], period=turn)
        return continuous, count
    jumps = np.flatnonzero(np.abs(steps[1:-1]) > _MIN_JUMP * span) + 1
    others = np.delete(steps, jumps)
    against = steps[jumps] * (steps[jumps - 1] + steps[jumps + 1]) < 0.0
    # jumps in both directions, unlike those of a turning wheel
    both_ways = len(jumps) >= _MIN_JUMPS and abs(np.sign(steps[jumps]).sum()) <= 1.0
    if both_ways and np.abs(others).max() < (1.0 - _MIN_JUMP) * span and np.mean(against) > 0.8:
        raise ConfigurationError(
            f"{path}: {name} jumps by {np.median(np.abs(steps[jumps])):.4g} {unit} against its motion, "
            f"{len(jumps)} times, first after line {lines[finite[jumps[0]]]}, as an angle does that is "
            "counted round a turn: state its unit with --unit, or write it without the jumps"
        )
    return values, 0


_MAX_NET_FRACTION = 0.5
"""Largest ratio of a position's whole change to the sum of its steps; that of a swing, which returns, is near
0."""
_MAX_PLAUSIBLE_STEP_S = 1.0
"""Time between rows above which times without a stated unit are hardly in s."""
_PLAUSIBLE_PERIODS_S = (0.2, 100.0)
"""Range of plausible periods of times without a stated unit; a pendulum of 0.2 s is 1 cm long."""
_MAX_PLAUSIBLE_RATIO = 3.0
"""Largest plausible ratio of an amplitude to the first amplitude of a session; 1 arcsec is 5 urad."""


def judge_sign(path: Path, trajectory: Trajectory) -> None:
    """Refuse one position without a swing, and one without a sign, whose period is half of the pendulum's."""
    if len(trajectory.positions) > 1:
        return
    values = trajectory.positions[0][np.isfinite(trajectory.positions[0])]
    if len(values) > 1 and abs(values[-1] - values[0]) > _MAX_NET_FRACTION * np.abs(np.diff(values)).sum():
        raise DataError(
            f"{path}: {trajectory.names[0]} goes from {values[0]:.4g} to {values[-1]:.4g} and hardly ever "
            "back: no position of a swing does; name the column of the position (--position)"
        )
    period_s = unsigned_period_s(trajectory.times_ns, trajectory.positions[0])
    if math.isfinite(period_s):
        raise DataError(
            f"{path}: {trajectory.names[0]} has no sign, as |x| or x² of a swing: it comes back to one value "
            f"every {0.5 * period_s:.4g} s, while the pendulum's period is {period_s:.4g} s; give the "
            "position with its sign"
        )


def judge_time_unit(path: Path, trajectory: Trajectory, decays: Sequence[Sequence[HalfCycle]] = ()) -> None:
    """Refuse times without a stated unit that are hardly in s: ms, row numbers, fractions of a day."""
    step_s = float(np.median(np.diff(seconds(trajectory.times_ns))))
    periods_s = [summarise_decay(turning_points(decay)).period_s.value for decay in decays]
    min_s, max_s = _PLAUSIBLE_PERIODS_S
    longest_s = max(periods_s, default=min_s)
    if (step_s < _MAX_PLAUSIBLE_STEP_S and min_s <= longest_s < max_s) or not trajectory.time_is_assumed:
        return
    period = f", a period {longest_s:.4g} s" if periods_s else ""
    raise ConfigurationError(
        f"{path}: nothing states the unit of {trajectory.time_name!r}, and in s the rows would be "
        f"{step_s:.4g} s apart{period}; state --time-unit {', '.join(TIME_UNITS)}, or the rows in a second: "
        "--rate HZ --position COLUMN"
    )


def strange_amplitudes(amplitude_arcsec: Floats, trajectory: Trajectory, config: Configuration) -> list[str]:
    """A warning of amplitudes that do not fit the rig, as of angles in another unit; else empty."""
    first, last = config.session.initial_amplitude_arcsec, config.session.final_amplitude_arcsec
    is_rig = trajectory.scale_rad is not None and config.instrument.kind == "single_ball"
    is_plausible = amplitude_arcsec[0] <= _MAX_PLAUSIBLE_RATIO * first and np.median(amplitude_arcsec) >= last
    if not is_rig or is_plausible:
        return []
    text = (
        f"amplitudes of {amplitude_arcsec[0]:.3g} to {amplitude_arcsec[-1]:.3g} arcsec are none of this rig, "
        f"which swings from {first:g} to {last:g} arcsec (session.initial_amplitude_arcsec, "
        f"final_amplitude_arcsec): are the positions in {trajectory.unit}?"
    )
    return [text]


_MIN_CHI2_PER_DOF = 0.01
"""Chi-square per degree of freedom below which the estimated noise must be too large."""


def decay_warnings(summary: DecaySummary) -> list[str]:
    """Warnings of a decay that grows, of a period or decrement that is not constant, of too large a noise."""
    warnings = []
    if summary.grows:
        warnings.append(
            f"the amplitude grows, its log decrement is {plain(summary.decrement.value, 3)} in the mean: "
            "this is no free decay; is time reversed, or does something drive the pendulum?"
        )
    for name, mean, unit in (
        ("period", summary.period_s, " s"),
        ("logarithmic decrement", summary.decrement, ""),
    ):
        if mean.changes:
            ends = (
                f": {mean.first:.5g}{unit} over the first third of the half-cycles, {mean.last:.5g}{unit} "
                "over the last"
                if np.isfinite(mean.first)
                else ""
            )
            warnings.append(
                f"the {name} is not constant (χ²/dof {mean.chi2_per_dof:.3g} if it were){ends}; the "
                "uncertainty of its mean allows for it"
            )
    if max(summary.period_s.chi2_per_dof, summary.decrement.chi2_per_dof) < _MIN_CHI2_PER_DOF:
        warnings.append(
            "the half-cycles scatter far less than the estimated noise of a sample implies (with few samples "
            "a swing that estimate is too large): the uncertainties are upper limits"
        )
    return warnings


def clipping_warnings(name: str, values: Floats) -> list[str]:
    """Warnings of a position (n,) whose largest values the sensor has cut off.

    Such a position stays at one value for so many rows that an uncut swing would be larger by more than two
    steps of the last digit.
    """
    values = values[np.isfinite(values)]
    rest, step = float(np.median(values)), float(np.diff(np.unique(values)).min(initial=np.inf))
    warnings = []
    for extreme, extreme_name in ((values.max(), "largest"), (values.min(), "smallest")):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], values == extreme, [0]]).astype(np.int8)))
        begins, rows = edges[::2], np.diff(edges)[::2]
        stays = rows >= _MIN_CUT_ROWS
        if np.count_nonzero(stays) < _MIN_JUMPS:
            continue
        period = float(np.median(np.diff(begins[stays])))
        level, phase = abs(extreme - rest), math.pi * float(np.median(rows[stays])) / period
        is_longer = phase < 0.5 * math.pi and level / math.cos(phase) - level > 2.0 * step
        # no swing stays within one step of its digits for half of its period
        if is_longer or (phase >= 0.5 * math.pi and np.ptp(values) > 4.0 * step):
            warnings.append(
                f"{name} stays at its {extreme_name} value, {extreme:.6g}, for up to {rows.max()} rows, "
                f"{np.count_nonzero(stays)} times: its sensor cuts the swings off, and amplitudes and "
                "damping are not those of the pendulum there; use a later stretch (--from)"
            )
    return warnings


def missing_for_laws(trajectory: Trajectory, config: Configuration | None) -> str:
    """Text on what a fit of the contact's laws lacks; empty if nothing is missing."""
    if trajectory.scale_rad is None:
        options = f"--unit takes {', '.join(ANGLE_UNITS)}"
        if trajectory.unit == UNSTATED_UNIT:
            return f"the unit of the position is not stated; {options}, or any word"
        similar = get_close_matches(trajectory.unit, ANGLE_UNITS, n=1)
        hint = f"did you mean {similar[0]}?" if similar else options
        return f"the laws need an angle, but the unit is {trajectory.unit!r}; {hint}"
    if config is None:
        return "the pendulum is not described; --config FILE with [pendulum] gives mass and ball"
    return ""
