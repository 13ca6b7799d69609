"""Ladders of tilts that something bends, or in which a step is wrong; the arm is 1 m."""

from typing import NamedTuple

import numpy as np

from calibration.ladder import LadderSteps
from calibration.lever_fit import fit_ladder
from processing.units import ARCSEC_RAD

PITCH_M = 4.8e-6


class Ladder(NamedTuple):
    """Readings in arcsec; `cubic` is relative at the ladder's end, `wrong_by_u` what one step is off.

    A wrong step is any of them, off to any side, by so many of its standard uncertainties.
    """

    readings_arcsec: tuple[float, ...]
    skew: float = 0.0
    cubic: float = 0.0
    wrong_by_u: float = 0.0
    noise_px: float = 0.02
    u_reference_arcsec: float = 0.05

    def climbed(self, seed: int) -> LadderSteps:
        """The ladder as measured once."""
        rng = np.random.default_rng([seed, 9])
        reference = np.array(self.readings_arcsec) * ARCSEC_RAD
        count, u_rad = len(reference), self.u_reference_arcsec * ARCSEC_RAD
        t = np.tan(2 * (reference + u_rad * rng.standard_normal(count)))
        end = np.tan(2 * np.abs(reference).max())
        along = (t + self.skew * t**2 + self.cubic * t * (t / end) ** 2) / PITCH_M
        y_px = 300 - along + self.noise_px * rng.standard_normal(count)
        x_px = 160 + self.noise_px * rng.standard_normal(count)
        if self.wrong_by_u:
            u_px = np.hypot(self.noise_px, 2 * u_rad / PITCH_M)
            y_px[rng.integers(count)] += rng.choice([-1.0, 1.0]) * self.wrong_by_u * u_px
        u = np.full(count, self.noise_px)
        return LadderSteps(reference, np.full(count, u_rad), x_px, y_px, u, u)


def even(first: float, last: float, count: int) -> tuple[float, ...]:
    """Evenly spaced readings."""
    return tuple(np.linspace(first, last, count).tolist())


_UP_AND_DOWN = even(-300, 300, 9) + even(300, -300, 9)
LADDERS = {
    "straight, 9 steps to 150 arcsec": Ladder(even(-150, 150, 9)),
    "straight, 5 steps to 60 arcsec": Ladder(even(-60, 60, 5)),
    "straight, one-sided to 300 arcsec": Ladder(even(-10, 300, 9)),
    "straight, up and down to 300 arcsec": Ladder(_UP_AND_DOWN),
    "cubic 3.6e-4, 9 steps to 300 arcsec": Ladder(even(-300, 300, 9), cubic=3.6e-4),
    "cubic 3.6e-4, up and down to 300 arcsec": Ladder(_UP_AND_DOWN, cubic=3.6e-4),
    "cubic 3.6e-4, quiet": Ladder(even(-150, 150, 9), cubic=3.6e-4, u_reference_arcsec=0.01),
    "cubic 3.6e-3, 9 steps to 300 arcsec": Ladder(even(-300, 300, 9), cubic=3.6e-3),
    "skew 0.1, one-sided to 300 arcsec": Ladder(even(-10, 300, 9), skew=0.1),
    "skew 0.3, one-sided to 300 arcsec": Ladder(even(-10, 300, 9), skew=0.3),
    "skew 0.3, one-sided, quiet": Ladder(even(-10, 300, 9), skew=0.3, u_reference_arcsec=0.01),
    "wrong by 5 u, 5 steps to 60 arcsec": Ladder(even(-60, 60, 5), wrong_by_u=5.0),
    "wrong by 10 u, 5 steps to 60 arcsec": Ladder(even(-60, 60, 5), wrong_by_u=10.0),
    "wrong by 30 u, 5 steps to 60 arcsec": Ladder(even(-60, 60, 5), wrong_by_u=30.0),
    "wrong by 10 u, 9 steps to 150 arcsec": Ladder(even(-150, 150, 9), wrong_by_u=10.0),
}


def pull(name: str, seed: int) -> tuple[float, float, tuple[str, ...]]:
    """Error of the scale over its uncertainty, that uncertainty relative to the scale, and the notes."""
    fit = fit_ladder(LADDERS[name].climbed(seed), "tilt")
    return (fit.scale * PITCH_M - 1.0) / (fit.u_scale * PITCH_M), fit.u_scale * PITCH_M, fit.notes
