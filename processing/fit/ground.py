"""The ground as a source of scatter: the noise of a fit, and what a fit says of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, nan
from typing import Annotated

import numpy as np

from processing.estimate import NOT_DETERMINED, Estimate
from processing.quantity import PLAIN, Quantity

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


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseMotion:
    """Horizontal acceleration of the ground that the drive of a pendulum corresponds to.

    One-sided spectral density at the pendulum's frequency, for the stated height of the mass centre over the
    point of contact, its bound of 95 %, and its level over Peterson's new low noise model of 1993.
    """

    mass_centre_height_m: float
    acceleration_m_per_s2_rthz: Estimate
    upper_95: Annotated[float, Quantity("", "bound of 95 %", unit="m/s^2/sqrt(Hz)")] = nan
    above_low_noise_model_db: float = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """How strongly the ground drove the pendulum during a run, as the turning points show it.

    `density_rad_per_s2_rthz` is the one-sided spectral density of the angular acceleration at the pendulum's
    frequency (without a calibration in the unit of the amplitudes instead of rad), `upper_95` its bound of
    95 %; `seen` is false where the run sets no more than that bound. `measurement_scale` is the factor by
    which turning points scatter more than their stated uncertainties. `left_out_half_cycles` at the end were
    not fitted: the ground moves the pendulum in one half-swing by more than a tenth of its amplitude there,
    and amplitude and phase do not describe its motion. `widening` says for each parameter how many times
    larger its uncertainty is than on ground at rest. `base` is there where the height of the mass centre is
    stated.
    """

    density_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    upper_95: Annotated[float, Quantity("", "bound of 95 %", unit="rad/s^2/sqrt(Hz)")] = nan
    seen: bool = False
    measurement_scale: float = 1.0
    left_out_half_cycles: int = 0
    widening: Annotated[Mapping[str, float], PLAIN] = field(default_factory=dict)
    base: BaseMotion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundFit(Ground):
    """The ground, and the likelihood that shows it.

    Attributes
    ----------
    noise
        The likeliest noise, its step in the unit of the amplitudes.
    deviance
        -2 ln L of the turning points with this noise, restricted to what the fitted parameters leave over, up
        to a constant of their number and of the law.
    unrestricted
        -2 ln L of the turning points themselves, up to a constant of their number: laws are compared by it.
    """

    noise: Noise
    deviance: float = nan
    unrestricted: float = nan


def density_of_step(step: float, half_period_s: float) -> float:
    """q for which either quadrature moves by `step` in a half-swing: ``2 w step / sqrt(T/2)``, w = 2 pi/T."""
    return float(2 * np.pi * step / half_period_s**1.5)


def step_of_density(density: float, half_period_s: float) -> float:
    """Inverse of `density_of_step`."""
    return float(density * half_period_s**1.5 / (2 * np.pi))
