"""What is to be doubted of a table's decays: refused with what to state, or said beside the results."""

import math
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.decay_summary import DecaySummary, summarise_decay
from processing.errors import ConfigurationError, DataError
from processing.swing import Swing, turning_points
from processing.ticks import seconds
from processing.unsigned import unsigned_period_s
from rig.analysis.tables.column_units import TIME_UNITS
from rig.analysis.trajectory import ANGLES, NOT_STATED, Trajectory
from rig.presentation import plain
from rig.settings import Configuration

_SLOW_STEP_S = 1.0
_USUAL_PERIOD_S = (1e-3, 100.0)
"""Of times in s of which nothing states the unit."""
_TOO_LARGE = 3.0
"""Times the first amplitude of a session; 1 arcsec is 5 urad."""


def judge_sign(path: Path, trajectory: Trajectory) -> None:
    """Refuse one position without a sign, of which the period is half of the pendulum's."""
    if len(trajectory.positions) > 1:
        return
    period_s = unsigned_period_s(trajectory.times_ns, trajectory.positions[0])
    if math.isfinite(period_s):
        raise DataError(
            f"{path}: {trajectory.names[0]} has no sign, as |x| or x² of a swing: it comes back to one value "
            f"every {0.5 * period_s:.4g} s, while the pendulum's period is {period_s:.4g} s; give the "
            "position with its sign, or its largest values as an envelope (--envelope amplitude)"
        )


def judge_time_unit(path: Path, trajectory: Trajectory, decays: Sequence[Sequence[Swing]] = ()) -> None:
    """Refuse times that are hardly s where nothing states it: ms, numbers of rows, parts of a day."""
    step_s = float(np.median(np.diff(seconds(trajectory.times_ns))))
    periods_s = [summarise_decay(turning_points(part)).period_s.value for part in decays]
    longest_s = max(periods_s, default=_USUAL_PERIOD_S[0])
    usual = step_s < _SLOW_STEP_S and _USUAL_PERIOD_S[0] <= longest_s < _USUAL_PERIOD_S[1]
    if usual or not trajectory.time_is_assumed:
        return
    lasts = f", a period {longest_s:.4g} s" if periods_s else ""
    raise ConfigurationError(
        f"{path}: nothing states the unit of {trajectory.time_name!r}, and in s the rows would be "
        f"{step_s:.4g} s apart{lasts}; state --time-unit {', '.join(TIME_UNITS)}, or the rows in a second: "
        "--rate HZ --position COLUMN"
    )


def strange_amplitudes(
    amplitude_arcsec: NDArray[np.float64], trajectory: Trajectory, config: Configuration
) -> list[str]:
    """What is to be said of amplitudes that the rig does not have, as of angles in another unit."""
    first, last = config.session.initial_amplitude_arcsec, config.session.final_amplitude_arcsec
    is_rig = trajectory.scale_rad is not None and config.instrument.kind == "single_ball"
    if not is_rig or (np.median(amplitude_arcsec) >= last and amplitude_arcsec[0] <= _TOO_LARGE * first):
        return []
    return [
        (
            f"amplitudes of {amplitude_arcsec[0]:.3g} to {amplitude_arcsec[-1]:.3g} arcsec are none of this "
            f"rig, which swings from {first:g} to {last:g} arcsec (session.initial_amplitude_arcsec, "
            f"final_amplitude_arcsec): are the positions in {trajectory.unit}?"
        )
    ]


def changes_in(summary: DecaySummary) -> list[str]:
    """What a mean does not describe."""
    said = []
    if summary.grows:
        said.append(
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
            said.append(
                f"the {name} is not constant (χ²/dof {mean.chi2_per_dof:.3g} if it were){ends}; the "
                "uncertainty of its mean allows for it"
            )
    return said


def why_no_laws(trajectory: Trajectory, config: Configuration | None) -> str:
    """What a fit of the contact's laws lacks; empty: nothing."""
    if trajectory.scale_rad is None:
        if trajectory.unit == NOT_STATED:
            return f"the unit of the position is not stated; --unit takes {', '.join(ANGLES)}, or any word"
        near = get_close_matches(trajectory.unit, ANGLES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"--unit takes {', '.join(ANGLES)}"
        return f"the laws need an angle, but the unit is {trajectory.unit!r}; {hint}"
    if config is None:
        return "the pendulum is not described; --config FILE with [pendulum] gives mass and ball"
    return ""
