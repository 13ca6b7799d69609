"""Warnings that an exact fit gives beside its values."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from processing.estimate import WELL_DETERMINED
from processing.fit.ground import Ground
from processing.fit.whiteness import Whiteness
from processing.swing import TurningPoints


def of_ground(ground: Ground, points: TurningPoints) -> tuple[str, ...]:
    """That the end of the run was left out; `points` are those fitted."""
    if not ground.left_out_half_cycles:
        return ()
    text = (
        f"{ground.left_out_half_cycles} half-cycles at the end are left out: below "
        f"{points.amplitude[-1]:.3g} rad the ground moves the pendulum in one "
        "half-swing by more than a tenth of its amplitude"
    )
    return (text,)


def of_correlation(white: Whiteness) -> tuple[str, ...]:
    """That the residuals are no noise."""
    if not white.correlated:
        return ()
    wider = f"widened by up to {white.widened:.2g}" if white.widened >= 1.05 else "hardly wider"
    text = (
        "the residuals of neighbouring half-cycles are correlated (chance "
        f"{min(white.p_amplitude, white.p_time):.1g}): the model does not describe all of the motion, or the "
        f"point of rest wanders (pointing of the beam, air); uncertainties are {wider} for it"
    )
    return (text,)


def of_limits(limited: Sequence[str]) -> tuple[str, ...]:
    """Parameters at a limit of the range of search."""
    return tuple(f"{name} stands at the limit of its range: the data do not determine it" for name in limited)


def of_uncertainties(
    names: tuple[str, ...], values: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[str, ...]:
    """Parameters with a large relative uncertainty; the last two names (amplitude, time) are not tested."""
    found = []
    for name, value, variance in zip(names[:-2], values, np.diag(covariance), strict=False):
        u = float(np.sqrt(variance))
        if u > WELL_DETERMINED * abs(value):
            known = f"u = {u / abs(value):.0%} of it" if value and np.isfinite(u) else "u without limit"
            found.append(f"{name} is poorly determined ({known}): take its interval, not its value")
    return tuple(found)
