"""How probable a law makes a decay: Laplace's approximation, with normal priors stated alike for every law.

Exponents lie about the middle of their law's range, with the standard deviation of a uniform distribution
over it. Every other parameter of a moment lies about zero; one standard deviation adds a tenth of gravity's
moment at the decay's reference amplitude. Period, first amplitude and its time (over the period) lie about
what was found, within a tenth. The noise is taken as known.
"""

from math import isfinite, log, pi, sqrt

import numpy as np

from processing.contact import AMPLITUDE, DRAG, TIME, PendulumOnBall, weight_moment
from processing.fit.result import FitResult

_SHARE = 0.1
"""What a parameter may do before data: move times and moments by a tenth of the period and of the weight's
moment."""
_LEAST_SHARE = 1e-15
"""Rounding of the eigenvalues of a matrix with ones in its diagonal: what is smaller is not known."""
_PERIOD = "period0_s"


def prior(fit: FitResult, pendulum: PendulumOnBall, name: str) -> tuple[float, float]:
    """Mean and standard deviation of the prior of one parameter, in its unit."""
    parameter, value = fit.law.parameter(name), fit.estimate(name).value
    if isfinite(parameter.lower) and isfinite(parameter.upper):
        return 0.5 * (parameter.lower + parameter.upper), (parameter.upper - parameter.lower) / sqrt(12)
    if name in (TIME.key, _PERIOD):
        return value, _SHARE * fit.mean_period_s.value
    if name == AMPLITUDE.key:
        return value, _SHARE * fit.reference_rad
    if name == DRAG.key:
        return 0.0, _SHARE * fit.mean_period_s.value / (2 * pi)
    values = dict(zip(fit.names, fit.values.tolist(), strict=True))
    u = fit.estimate(name).standard_uncertainty
    step = 1e-3 * max(abs(value), u if isfinite(u) else 0.0, 1e-300)
    phi = np.linspace(-1, 1, 40) * fit.reference_rad
    before, after = (
        fit.law.branch_moments(phi, np.ones_like(phi), {**values, name: value + change}, pendulum)
        for change in (-step, step)
    )
    added = np.abs(np.subtract(after, before)).max() / (2 * step) / weight_moment(pendulum)
    return 0.0, float(_SHARE * fit.reference_rad / added) if added > 0 else 1.0


def log_evidence(fit: FitResult, pendulum: PendulumOnBall) -> float:
    """ln of the evidence of a fitted law, up to a constant of the data.

    With the posterior's covariance over the priors' standard deviations, R, and the distance d of the values
    from the priors' means: ``ln L + (ln det R - ln det(1 + R) - d^T (1 + R)^-1 d) / 2``. A parameter that the
    data do not determine, or that is at a limit, keeps its prior.
    """
    assert fit.ground is not None  # of every exact fit
    u = fit.standard_uncertainty
    known = np.isfinite(u) & (u > 0)
    mean, sd = np.array([prior(fit, pendulum, name) for name in fit.names])[known].T
    posterior = fit.covariance[np.ix_(known, known)] / np.outer(sd, sd)
    distance = (fit.values[known] - mean) / sd
    size = np.sqrt(np.diag(posterior))
    shares = np.maximum(np.linalg.eigvalsh(posterior / np.outer(size, size)), _LEAST_SHARE)
    both = np.eye(len(sd)) + posterior
    log_volume = sum(map(log, shares.tolist())) + 2 * sum(map(log, size.tolist()))
    log_volume -= float(np.linalg.slogdet(both)[1])
    return 0.5 * (log_volume - float(distance @ np.linalg.solve(both, distance)) - fit.ground.unrestricted)
