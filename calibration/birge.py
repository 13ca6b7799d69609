"""Birge ratio, by which the uncertainties of a weighted fit are enlarged."""

import math

_P_VALUE = 0.01
"""Probability of a chi-square below which its size is not attributed to chance."""


def birge_ratio(chi_square: float, dof: int) -> float:
    """``sqrt(chi_square / dof)`` if a chi-square this large is improbable (`_P_VALUE`), otherwise 1.

    R. T. Birge, Phys. Rev. 40, 207, 1932. A scatter that is small by chance must not reduce uncertainties.
    """
    from scipy.special import chdtrc

    return math.sqrt(chi_square / dof) if dof > 0 and chdtrc(dof, chi_square) < _P_VALUE else 1.0
