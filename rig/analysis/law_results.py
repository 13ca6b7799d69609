"""What results.json says of several laws that were fitted to one run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, nan

import numpy as np

from processing.estimate import Estimate
from rig.analysis.encoding import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class LawFit:
    """One law at its best.

    `bic_above_best` and `aic_above_best` are its distances from the best law in the criteria of Schwarz and
    Akaike, `log_odds_against` is the natural logarithm of the odds against it from the evidence (see
    `processing.fit.law_comparison`), `waveform_chance` the chance of a third harmonic at least so far from
    the law's, `ground_rad_per_s2_rthz` the drive that it needs; `problem`
    says why there is no fit.
    """

    title: str
    source: str
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    bic_above_best: float = inf
    aic_above_best: float = inf
    log_odds_against: float = inf
    ground_rad_per_s2_rthz: float = inf
    waveform_chance: float = nan
    residuals_are_noise: bool = False
    excluded: bool = True
    problem: str = ""


@dataclass(frozen=True, slots=True)
class LawMoments:
    """Both moments of a fitted law, in the terms of `MomentsWithoutLaw`."""

    friction_n_m: Floats
    elastic_n_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentsWithoutLaw:
    """Friction against the motion and elastic moment at the angles `phi_rad`, as splines of the angle.

    `u_friction_n_m` and `u_elastic_n_m` are standard uncertainties: bands that cover 68 %. A moment
    proportional to the angle counts as gravity's, so the elastic moment vanishes at `reference_rad`. `laws`
    has the fitted laws in the same terms. `ground_rad_per_s2_rthz` is the drive that the splines leave.
    """

    phi_rad: Floats = field(default_factory=lambda: np.empty(0))
    friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    u_friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    u_elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    reference_rad: float = nan
    ground_rad_per_s2_rthz: float = nan
    laws: Mapping[str, LawMoments] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Harmonics of the swing by order, from its turning point on: ``cosine cos(k s) + sine sin(k s)``."""

    cosine_rad: Floats
    sine_rad: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveformClass:
    """Harmonics 2 to 5 of the swings about one amplitude, their standard uncertainties, and the laws' own."""

    amplitude_rad: float
    measured: Harmonics
    u_rad: Floats
    laws: Mapping[str, Harmonics] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ComparedLaws:
    """Laws by name, the best first, the verdict in words, the moments without a law (None: no fit), and the
    waveform by classes of amplitude, the largest first."""

    laws: Mapping[str, LawFit]
    verdict: str
    without_law: MomentsWithoutLaw | None = None
    waveform: tuple[WaveformClass, ...] = ()
