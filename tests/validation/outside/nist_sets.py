"""NIST's Statistical Reference Datasets, nonlinear: all 27, from both starts, to how many certified
digits."""

import warnings
from functools import cache

import numpy as np

from tests.processing.fit.nist import NAMES, dataset, digits, fitted
from tests.validation.row import Found

ROUNDED = "Lanczos1"
"""Its residuals are the rounding of the data, so what follows from them has few digits with any solver."""


@cache
def certified() -> dict[str, Found]:
    """Digits of values, standard errors and sums of squares; fits that end elsewhere are counted."""
    values, errors, sums, elsewhere = {}, {}, {}, []
    for name in NAMES:
        data = dataset(name)
        for start in (1, 2):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                solution = fitted(data, start)
            key = f"{name}, start {start}"
            if digits(solution.values, data.certified) < 2:
                elsewhere.append(key)
                continue
            u = np.sqrt(np.diag(solution.covariance) * solution.chi2 / solution.dof)
            values[key] = digits(solution.values, data.certified)
            if name != ROUNDED:
                errors[key] = digits(u, data.standard_error)
                sums[key] = digits(np.array([solution.chi2]), np.array([data.residual_sum]))

    def least(of: dict[str, float]) -> Found:
        worst = min(of, key=lambda key: of[key])
        return Found((of[worst],), f"{len(of)} fits; the fewest, {worst}")

    return {
        "values": least(values),
        "errors": least(errors),
        "sums": least(sums),
        "reached": Found((float(len(values)),), f"ended elsewhere: {', '.join(elsewhere) or 'none'}"),
    }
