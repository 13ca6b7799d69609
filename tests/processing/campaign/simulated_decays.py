"""Likelihoods of decays between two amplitudes, by a formula of their own: what planned campaigns measure.

The amplitude a (over 60 arcsec) falls as da/dt = -(B a^p + C + D a); every half-swing measures it with
the same noise, and D is the air, of which something is known beside the run.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.campaign import CompressedRun
from processing.estimate import Estimate

Floats = NDArray[np.float64]
NAMES = ("b", "p", "c")
TRUTH = (float(np.log(3e-3)), 0.944, float(np.log(1e-5)))
AIR_PER_S, U_AIR_PER_S = 4e-4, 4e-6
NOISE = 4e-4
HALF_PERIOD_S = 2.0
_STEPS = 4000


class Decay(NamedTuple):
    """How long it lasts, covariance of ln B, p, ln C, and what one u of the air does to them."""

    duration_s: float
    covariance: Floats
    by_air: Floats
    by_growth: Floats


def _times(
    at: Floats, truth: tuple[float, ...], air: float, growth: float = 0.0, whole_s: float = 1.0
) -> Floats:
    """Times at which amplitudes `at`, which fall, are passed."""
    log_b, p, log_c = truth
    contact = np.exp(log_b) * at**p + np.exp(log_c)
    rate = contact + air * at
    time = np.concatenate([[0.0], np.cumsum(0.5 * (1 / rate[1:] + 1 / rate[:-1]) * -np.diff(at))])
    if growth:
        rate = rate + contact * growth * (time / whole_s - 0.5)
        time = np.concatenate([[0.0], np.cumsum(0.5 * (1 / rate[1:] + 1 / rate[:-1]) * -np.diff(at))])
    return np.asarray(time)


@cache
def decay(first_arcsec: float, last_arcsec: float, truth: tuple[float, ...] = TRUTH) -> Decay:
    """The likelihood of a run, from the derivatives of its amplitudes; the first amplitude is its own."""
    at = np.geomspace(first_arcsec / 60, last_arcsec / 60 * 0.8, _STEPS)
    plain = _times(at, truth, AIR_PER_S)
    lasting_s = float(np.interp(-last_arcsec / 60, -at, plain))
    seen_s = np.arange(0.0, lasting_s, HALF_PERIOD_S)

    def seen(changed: tuple[float, ...], air: float, growth: float = 0.0) -> Floats:
        return np.asarray(np.interp(seen_s, _times(at, changed, air, growth, lasting_s), at))

    step, columns = 1e-4, []
    for place in range(3):
        up, down = list(truth), list(truth)
        up[place] += step
        down[place] -= step
        columns.append((seen(tuple(up), AIR_PER_S) - seen(tuple(down), AIR_PER_S)) / (2 * step))
    by_air = (seen(truth, AIR_PER_S + U_AIR_PER_S) - seen(truth, AIR_PER_S - U_AIR_PER_S)) / 2
    grown = (seen(truth, AIR_PER_S, 0.02) - seen(truth, AIR_PER_S, -0.02)) / 0.04
    middle = seen(truth, AIR_PER_S)
    rate = np.gradient(middle, seen_s)
    # a later begin: the run's own
    jacobian = np.column_stack([*columns, rate / np.abs(rate[0])]) / NOISE
    covariance: Floats = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    to = (covariance @ jacobian.T) / NOISE
    return Decay(lasting_s, covariance[:3, :3], (to @ by_air)[:3], (to @ grown)[:3])


def expected(
    first_arcsec: float, last_arcsec: float, *, contact: str = "sample", truth: tuple[float, ...] = TRUTH
) -> CompressedRun:
    """A run that has not been made: its values are those that it is made for."""
    one = decay(first_arcsec, last_arcsec, truth)
    return CompressedRun(
        label=f"{first_arcsec:g} to {last_arcsec:g} arcsec",
        contact=contact,
        names=NAMES,
        values=np.array(truth),
        covariance=one.covariance,
        shared={"air": one.by_air},
        covariates={"first_amplitude_rad": Estimate(first_arcsec * 4.848e-6, 0.0)},
        by_growth=one.by_growth,
        duration_s=one.duration_s,
    )


def measured(
    planned: CompressedRun,
    own: Floats,
    air: float,
    rng: np.random.Generator,
    *,
    truth: tuple[float, ...],
    number: int,
    began_s: float,
    growth_per_s: float = 0.0,
) -> CompressedRun:
    """The run as it came out, with these values of its own; its likelihood is that of what is true."""
    first, last = (float(word) for word in planned.label.removesuffix(" arcsec").split(" to "))
    one = decay(first, last, tuple(truth))
    values = own + air * one.by_air + growth_per_s * one.duration_s * one.by_growth
    return CompressedRun(
        label=f"run-{number}",
        contact=planned.contact,
        names=NAMES,
        values=values + np.linalg.cholesky(one.covariance) @ rng.normal(size=3),
        covariance=one.covariance,
        shared={"air": one.by_air},
        covariates={
            **planned.covariates, "age_s": Estimate(began_s + 0.5 * one.duration_s, 0.0),
        },
        by_growth=one.by_growth,
        duration_s=one.duration_s,
    )  # fmt: skip
