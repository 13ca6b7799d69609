"""The ground as a source of scatter: the noise of a fit, and what a fit says of it."""

from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np

from processing.estimate import Estimate

GROUND_SEEN = 6.63
"""Difference of -2 ln L from ground at rest above which a drive is stated and not bounded: chance 0.5 %."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What makes turning points scatter.

    `step` is the standard deviation by which the ground moves either quadrature of the oscillation
    in one half-swing, in the unit of the amplitudes that are fitted. `scale` multiplies the stated
    uncertainties of the turning points. `averaged` says that they were measured on the samples of
    their half-cycles, and not at the instant of turning. Turning points farther than `limit` standard
    uncertainties from their prediction do not move the prediction of the next one.
    """

    step: float = 0.0
    scale: float = 1.0
    averaged: bool = True
    limit: float = inf

    @property
    def at_rest(self) -> bool:
        return self.step == 0

    @property
    def in_stated_uncertainties(self) -> "Noise":
        """The same noise over `scale`: with it as weights, chi2/dof is the square of the scale."""
        return replace(self, step=self.step / self.scale, scale=1.0)


AT_REST = Noise()


@dataclass(frozen=True, slots=True)
class Ground:
    """How strongly the ground drove the pendulum during a run.

    Attributes
    ----------
    density
        One-sided spectral density q of the angular acceleration at the pendulum's frequency, in
        rad/s^2/sqrt(Hz) (without a calibration in the unit of the amplitudes), and its standard uncertainty.
    upper_95
        Bound of 95 % of the density.
    noise
        The likeliest noise, its step in the unit of the amplitudes.
    against_rest
        By how much -2 ln L of ground at rest exceeds that of this ground.
    deviance
        -2 ln L of the turning points with this noise, restricted to what the fitted parameters leave over, up
        to a constant of their number and of the law.
    unrestricted
        -2 ln L of the turning points themselves, up to a constant of their number: laws are compared by it.
    left_out
        Half-cycles at the end that were not fitted, because the ground moves the pendulum in one half-swing
        by more than a tenth of its amplitude: amplitude and phase no longer describe the motion there.
    """

    density: Estimate
    upper_95: float
    noise: Noise
    against_rest: float
    left_out: int = 0
    deviance: float = nan
    unrestricted: float = nan

    @property
    def seen(self) -> bool:
        """Whether the run shows that the ground moved; otherwise it sets a bound."""
        return self.against_rest > GROUND_SEEN


def density_of_step(step: float, half_period_s: float) -> float:
    """q for which either quadrature moves by `step` in a half-swing: ``2 w step / sqrt(T/2)``, w = 2 pi/T."""
    return float(2 * np.pi * step / half_period_s**1.5)


def step_of_density(density: float, half_period_s: float) -> float:
    """Inverse of `density_of_step`."""
    return float(density * half_period_s**1.5 / (2 * np.pi))
