"""Comparison of laboratories as in key comparisons: a reference value, and how far each lies from it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from processing.estimate import Estimate
from processing.fit.series import combine


@dataclass(frozen=True, slots=True)
class Degree:
    """Degree of equivalence of one laboratory: its distance from the reference, with its uncertainty.

    `expanded` is twice the standard uncertainty; beyond it the laboratory differs from the reference.
    """

    distance: float
    expanded: float

    @property
    def differs(self) -> bool:
        return abs(self.distance) > self.expanded


@dataclass(frozen=True, slots=True)
class KeyComparison:
    """What several laboratories say of one quantity.

    Attributes
    ----------
    weighted
        Mean weighted by the stated uncertainties alone, as if they explained the scatter.
    between_dl, mean_dl
        Standard deviation between laboratories beyond their uncertainties after DerSimonian and Laird
        (Control. Clin. Trials 7, 177, 1986), and the mean with it.
    between_mp, reference
        The same after Mandel and Paule (Anal. Chem. 54, 1194, 1982), the mean's uncertainty after Hartung
        and Knapp (see `combine`). This is the reference value.
    p_homogeneous
        Probability of a scatter at least as large from the stated uncertainties alone.
    degrees
        One a laboratory, in their order.
    """

    weighted: Estimate
    between_dl: float
    mean_dl: Estimate
    between_mp: float
    reference: Estimate
    p_homogeneous: float
    degrees: tuple[Degree, ...]


def compare_laboratories(name: str, values: Sequence[Estimate]) -> KeyComparison:
    """Compare what laboratories state of a quantity `name`.

    The uncertainty of a distance is that of the laboratory and the reference together, less what the
    reference owes to the laboratory; the scatter between laboratories is not counted as the laboratory's
    own uncertainty, or none would ever differ.

    Raises
    ------
    DataError
        Fewer than two laboratories, or an uncertainty that is not positive and finite.
    """
    combined = combine(name, values)
    x = np.array([value.value for value in values])
    u = np.array([value.standard_uncertainty for value in values])
    weight = 1 / u**2
    weighted = float(np.sum(weight * x) / np.sum(weight))
    excess = float(np.sum(weight * (x - weighted) ** 2)) - (len(x) - 1)
    between_dl = sqrt(max(0.0, excess / float(np.sum(weight) - np.sum(weight**2) / np.sum(weight))))
    with_dl = 1 / (u**2 + between_dl**2)
    reference = combined.value
    share = 1 / (u**2 + combined.between_runs**2)
    u_reference = 1 / sqrt(float(np.sum(share)))
    share = share / np.sum(share)
    variance = u**2 * (1 - 2 * share) + u_reference**2
    degrees = [
        Degree(float(value - reference), 2 * sqrt(max(0.0, float(own))))
        for value, own in zip(x, variance, strict=True)
    ]
    return KeyComparison(
        Estimate(weighted, float(1 / np.sqrt(np.sum(weight)))),
        between_dl,
        Estimate(float(np.sum(with_dl * x) / np.sum(with_dl)), float(1 / np.sqrt(np.sum(with_dl)))),
        combined.between_runs,
        combined.estimate,
        combined.p_homogeneous,
        tuple(degrees),
    )
