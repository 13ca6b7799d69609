"""Random imbalances of the simulated rig, trimmed by following the advice."""

import math
from typing import NamedTuple

import numpy as np

from acquisition.simulation.settings import AxesTruth, SimulationSettings
from acquisition.simulation.true_path import TrimmedPendulum, TrimWeight, imperfect_weights, noisy, true_path
from processing.balance import Balance, BalanceEstimator, BalanceLimits, WeightResponses, mass_centre_height_m
from processing.deflections import Deflections, DeflectionUnit
from processing.units import ARCSEC_RAD
from rig.instrument import complete
from rig.instrument.balance import elastic_drop, nominal_effects
from rig.settings import Configuration

CONFIG = complete(Configuration(camera={"driver": "simulated"}))
LIMITS = BalanceLimits()
_U_RAD = 0.003 * ARCSEC_RAD


class Followed(NamedTuple):
    """How a case ended: moves made, and the true state then (arcsec, arcsec, m)."""

    moves: int
    rest_x_arcsec: float
    rest_y_arcsec: float
    height_m: float

    @property
    def within_limits(self) -> bool:
        return (
            max(abs(self.rest_x_arcsec), abs(self.rest_y_arcsec)) <= LIMITS.rest_arcsec
            and abs(self.height_m) <= LIMITS.height_m
        )


def trimmed_pendulum(seed: int) -> TrimmedPendulum:
    """Rest position anywhere within 10 arcmin, mass centre up to 50 um off, weights not as their drawings."""
    random = np.random.default_rng((seed, 1))
    offset_arcsec, angle = 600.0 * math.sqrt(random.uniform()), random.uniform(0, 2 * math.pi)
    axes = AxesTruth(
        rest_fast_arcsec=offset_arcsec * math.cos(angle), rest_slow_arcsec=offset_arcsec * math.sin(angle)
    )
    weights = CONFIG.balance
    nominal = {
        "x": TrimWeight(weights.weight_x.mass_kg, weights.weight_x.pitch_m, (1.0, 0.0, 0.0)),
        "y": TrimWeight(weights.weight_y.mass_kg, weights.weight_y.pitch_m, (0.0, 1.0, 0.0)),
        "height": TrimWeight(weights.weight_height.mass_kg, weights.weight_height.pitch_m, (0.0, 0.0, 1.0)),
    }
    return TrimmedPendulum(
        SimulationSettings(axes=axes), imperfect_weights(nominal, seed), random.uniform(-5e-5, 5e-5), seed
    )


def seen(settings: SimulationSettings, seed: int) -> Balance:
    """What three periods of noisy deflections tell."""
    samples = noisy(true_path(settings, 13.5, 25.0), _U_RAD, _U_RAD, seed)
    u = np.full(len(samples.times_ns), _U_RAD)
    deflections = Deflections(samples.times_ns, samples.x_rad, samples.y_rad, u, u, DeflectionUnit.RAD)
    return BalanceEstimator().update(deflections)[-1]


def state_of(balance: Balance) -> np.ndarray:
    """(rest X, rest Y, height) as the advice takes it."""
    pendulum = CONFIG.pendulum
    assert pendulum is not None
    period0_s = balance.period_s * (1.0 - elastic_drop(CONFIG, balance.amplitude))
    inertia = CONFIG.balance.inertia_kg_m2
    assert inertia is not None
    height_m = mass_centre_height_m(
        period0_s, inertia, pendulum.mass_kg, pendulum.ball_radius_m, pendulum.gravity_m_per_s2
    )
    return np.array([balance.rest_x / ARCSEC_RAD, balance.rest_y / ARCSEC_RAD, height_m])


def follow_advice(seed: int, *, nominal_known: bool = True, most: int = 12) -> Followed:
    """Turn what is advised until the advice is to leave it; moves counted one weight at a time."""
    rig = trimmed_pendulum(seed)
    effects = nominal_effects(CONFIG) if nominal_known else dict.fromkeys(("x", "y", "height"))
    responses = WeightResponses(effects, LIMITS)
    u_state = np.array([0.01, 0.01, 1e-8])
    state = state_of(seen(rig.settings, 1000 * seed))
    moves = 0
    while moves < most and (turn := responses.advise(state)) is not None:
        rig.turn(turn.weight, turn.turns)
        moves += 1
        after = state_of(seen(rig.settings, 1000 * seed + moves))
        responses.learn(turn.weight, turn.turns, state, after, u_state)
        state = after
    truth = rig.settings
    arm = CONFIG.simulation.contact.ball_radius_m * (4.071 / truth.contact.period0_s) ** 2
    return Followed(
        moves,
        truth.axes.rest_fast_arcsec,
        truth.axes.rest_slow_arcsec,
        CONFIG.simulation.contact.ball_radius_m - arm,
    )
