"""Enlargement of standard uncertainties where the residuals scatter more than the stated uncertainties."""

import math

_IMPROBABLE = 0.01
"""Probability of the chi-square below which the scatter is not attributed to chance."""


def birge_ratio(chi_square: float, dof: int) -> float:
    """Factor for the standard uncertainties of a weighted fit, at least 1.

    It is ``sqrt(chi_square / dof)`` (R. T. Birge, Phys. Rev. 40, 207, 1932) if a chi-square this large has a
    probability below 1 %, otherwise 1: a scatter that is small by chance must not reduce the uncertainties.
    """
    from scipy.special import chdtrc

    return math.sqrt(chi_square / dof) if dof > 0 and chdtrc(dof, chi_square) < _IMPROBABLE else 1.0
