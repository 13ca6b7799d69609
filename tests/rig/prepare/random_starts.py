"""Random starts of a balancing on a small sensor, with weights of any strength and direction, and play.

A look is modelled: the true path with the noise of a tracked spot, lost where it leaves the sensor. What
judges it, learns from it and advises is that of `rig balance`.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.simulation.settings import AxesTruth, SensorTruth, SimulationSettings
from acquisition.simulation.true_path import TrimWeight, noisy, true_path
from processing.balance import BalanceEstimator, BalanceLimits, Turn, Unreachable
from processing.deflections import Deflections, DeflectionUnit
from processing.units import ARCSEC_RAD
from rig.instrument import complete
from rig.prepare.balancing import SimulatedOperator
from rig.prepare.learned_turns import BalanceMeasurement, LearnedTurns
from rig.settings import Configuration

SENSOR_PX = 640
LIMITS = BalanceLimits()
_U_RAD = 0.003 * ARCSEC_RAD
_FRAMES_PER_S = 25.0
_HALF_SPOT_PX = 6.0


class Start(NamedTuple):
    """An imbalance and the weights to trim it with."""

    config: Configuration
    weights: dict[str, TrimWeight]


class Ended(NamedTuple):
    """How a start ended: looks and turns made, and the truth."""

    balanced: bool
    looks: int
    turns: int
    off_the_sensor: int
    said_unreachable: bool
    rest_arcsec: tuple[float, float]
    height_m: float

    @property
    def converged(self) -> bool:
        """Whether the session ended within the limits, in truth."""
        within = (
            max(map(abs, self.rest_arcsec)) <= LIMITS.rest_arcsec and abs(self.height_m) <= LIMITS.height_m
        )
        return self.balanced and within


def random_start(seed: int, *, parallel: bool = False) -> Start:
    """Rest position anywhere within 60 arcsec in X and Y, period within 0.5 %, on 640x640 pixels.

    Two weights at 0, 45 or 90 degrees to the camera (seed modulo 3), off by up to 7 degrees; strengths of 0.3
    to 3 times what their drawings say, 0.4 turns of play. `parallel`: x and y work along the same line.
    """
    random = np.random.default_rng((seed, 5))
    rest = random.uniform(-60.0, 60.0, 2)
    period_s = 4.071 * (1.0 + random.uniform(-0.005, 0.005))
    truth = SimulationSettings(
        axes=AxesTruth(rest_fast_arcsec=rest[0], rest_slow_arcsec=rest[1]),
        sensor=SensorTruth(width_px=SENSOR_PX, height_px=SENSOR_PX),
    )
    config = complete(Configuration(camera={"driver": "simulated"}, simulation=truth))
    contact = truth.contact.model_copy(update={"period0_s": period_s})
    config = config.model_copy(update={"simulation": truth.model_copy(update={"contact": contact})})
    turned = math.radians((0.0, 45.0, 90.0)[seed % 3])
    ways = {
        "x": np.array([math.cos(turned), math.sin(turned), 0.0]),
        "y": np.array([-math.sin(turned), math.cos(turned), 0.0]),
        "height": np.array([0.0, 0.0, 1.0]),
    }
    if parallel:
        ways["y"] = ways["x"]
    weights = {}
    for name, way in ways.items():
        nominal = getattr(config.balance, f"weight_{name}")
        askew = way + random.uniform(-0.12, 0.12, 3) * (not parallel)
        gain = math.exp(random.uniform(math.log(0.3), math.log(3.0)))
        direction = askew / np.linalg.norm(askew)
        weights[name] = TrimWeight(
            nominal.mass_kg * gain, nominal.pitch_m, tuple(map(float, direction)), backlash_turns=0.4
        )  # fmt: skip
    return Start(config, weights)


def modelled_look(truth: SimulationSettings, seed: int) -> BalanceMeasurement:
    """What 13.5 s of the spot tell, as far as it is on the sensor."""
    path = noisy(true_path(truth, 13.5, _FRAMES_PER_S), _U_RAD, _U_RAD, seed)
    x, y = path.x_rad.copy(), path.y_rad.copy()
    half_rad = 0.5 * math.atan(
        (0.5 * SENSOR_PX - _HALF_SPOT_PX) * truth.sensor.pixel_pitch_m / truth.optics.arm_m
    )
    lost = (np.abs(x) > half_rad) | (np.abs(y) > half_rad)
    x[lost] = y[lost] = math.nan
    u = np.full(len(x), _U_RAD)
    found = BalanceEstimator().update(Deflections(path.times_ns, x, y, u, u, DeflectionUnit.RAD))
    return BalanceMeasurement(found[-1] if found else None, float(lost.mean()), (SENSOR_PX, SENSOR_PX))


def true_state(truth: SimulationSettings) -> np.ndarray:
    """Rest position in arcsec and height of the mass centre in m, from the simulated rig itself."""
    radius_m = truth.contact.ball_radius_m
    height_m = radius_m * (1.0 - (4.071 / truth.contact.period0_s) ** 2)
    return np.array([truth.axes.rest_fast_arcsec, truth.axes.rest_slow_arcsec, height_m])


def follow(
    start: Start,
    seed: int,
    history: Path,
    most_turns: int = 15,
    hand: Callable[[int, Turn], Turn] = lambda _number, turn: turn,
) -> Ended:
    """Do what is advised until it is to leave it; `hand` says what is done instead of the n-th turn."""
    operator = SimulatedOperator(start.config, seed, start.weights)
    session = LearnedTurns(start.config, history)
    looks = turns = off = 0
    unreachable = balanced = False
    while looks < 5 * most_turns:
        look = modelled_look(operator.simulation, 1000 * seed + looks)
        looks += 1
        rejected = session.take(look)
        advice = session.way_back() if rejected else session.advice()
        if rejected and not session.spot_is_gone and operator.swing_less():
            continue
        balanced = advice is None and not rejected
        unreachable = isinstance(advice, Unreachable)
        if not isinstance(advice, Turn) or turns >= most_turns:
            break
        operator.follow(hand(turns, advice))
        session.note_turns(advice.weight, advice.parts)
        turns += 1
        off += bool(np.max(np.abs(true_state(operator.simulation)[:2])) > 155.0)
    *rest, height_m = map(float, true_state(operator.simulation))
    return Ended(balanced, looks, turns, off, unreachable, (rest[0], rest[1]), height_m)
