"""Reported results of the contact: fits of its laws, and the comparison of laws.

Field names are keys of results.json; see `rig.analysis.results`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, nan
from typing import Annotated

import numpy as np

from processing.contact import DRAG, ContactParameters
from processing.contact.laws import DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import FitQuality
from rig.analysis.encoding import Entries, Floats

_STRONG = 0.99


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()

    @property
    def strong(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters that the data hardly distinguish, strongest correlation first."""
        pairs = [
            (self.names[i], self.names[j], self.matrix[i][j])
            for i in range(len(self.matrix))
            for j in range(i)
            if abs(self.matrix[i][j]) >= _STRONG
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))


@dataclass(frozen=True, kw_only=True)
class Fit(FitQuality):
    """One fit of one decay: parameters by name, and the quality of the fit.

    `law` names the law of `processing.contact.laws` that was fitted.
    `ground` and `whiteness` are None for the asymptotic fit.
    """

    law: str = ""
    parameters: Annotated[Mapping[str, Estimate], Entries] = field(default_factory=dict)
    correlation: Correlation = field(default_factory=Correlation)

    def estimate(self, name: str) -> Estimate:
        """A parameter; NaN where the fit has none of that name."""
        return self.parameters.get(name, NOT_DETERMINED)

    def contact(self) -> ContactParameters:
        """The contact parameters of the paper's law; NaN where the fit has none."""
        values = {name: self.estimate(name).value for name in DEFAULT_LAW.names()}
        drag = self.parameters.get(DRAG.key)
        return ContactParameters(**values, drag_s=0.0 if drag is None else drag.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawFit:
    """The best fit of one law.

    `bic_above_best` and `aic_above_best` are its distances from the best law in the criteria of Schwarz and
    Akaike, `log_odds_against` is the natural logarithm of the odds against it from the evidence and
    `waveform_chance` the chance of a third harmonic at least so far from the law's (see
    `processing.fit.law_comparison`), `ground_rad_per_s2_rthz` the drive that the law needs; `problem` is the
    reason where there is no fit.
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
    """Both moments of a fitted law, in the terms of `ModelFreeMoments`."""

    friction_n_m: Floats
    elastic_n_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFreeMoments:
    """Friction against the motion and elastic moment at the angles `phi_rad`, as splines of the angle.

    `u_friction_n_m` and `u_elastic_n_m` are standard uncertainties: bands that cover 68 %. A moment
    proportional to the angle counts as gravity's, so the elastic moment vanishes at `reference_rad`. `laws`
    has the fitted laws in the same terms. `ground_rad_per_s2_rthz` is the drive with which the splines fit.
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
    """Harmonics (of `ORDERS`) measured about one amplitude, their standard uncertainties, and the laws'."""

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
    without_law: ModelFreeMoments | None = None
    waveform: tuple[WaveformClass, ...] = ()
