"""The simulated pendulum's trimming weights: effect of a turn on rest position and period.

A weight on a screw moves the mass centre. The pendulum, which rolls on its ball, comes to rest with the mass
centre below the ball's centre; the distance of the two determines the period.
"""

import math
from typing import NamedTuple

import numpy as np

from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings


class TrimWeight(NamedTuple):
    """One weight: mass, pitch of its thread, and the direction (X, Y, down) in which a positive turn moves
    it.
    """

    mass_kg: float
    pitch_m: float
    direction: tuple[float, float, float]
    backlash_turns: float = 0.0


class TrimmedPendulum:
    """A pendulum whose mass centre is displaced, and the weights that trim it.

    Parameters
    ----------
    settings
        Rest position and period here are those of the untrimmed pendulum.
    weights
        By name.
    lower_m
        How much further than the ball's radius the mass centre lies below the ball's centre.
    seed
        Of the random errors with which turns are set by hand.
    u_turns
        Standard deviation of such an error, in turns.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        weights: dict[str, TrimWeight],
        lower_m: float = 0.0,
        seed: int = 0,
        u_turns: float = 0.01,
    ) -> None:
        self._settings = settings
        self._weights = weights
        self._random = np.random.default_rng(seed)
        self._u_turns = u_turns
        radius_m = settings.contact.ball_radius_m
        arm_m = radius_m + lower_m
        self._centre_m = np.array(
            [
                arm_m * math.tan(settings.axes.rest_fast_arcsec * ARCSEC_RAD),
                arm_m * math.tan(settings.axes.rest_slow_arcsec * ARCSEC_RAD),
                lower_m,
            ]
        )
        # where the screw stands within the play of its nut is chance, as whoever turned it last left it
        self._screw = {
            name: self._random.uniform() * weight.backlash_turns for name, weight in weights.items()
        }
        self._nut = dict.fromkeys(weights, 0.0)

    def turn(self, name: str, turns: float) -> None:
        """Turn a weight, with the play of its screw and a random error of the turn."""
        weight = self._weights[name]
        self._screw[name] += turns + self._u_turns * self._random.standard_normal()
        screw, before = self._screw[name], self._nut[name]
        self._nut[name] = min(max(before, screw - weight.backlash_turns), screw)
        shift_m = (
            weight.mass_kg / self._settings.contact.mass_kg * weight.pitch_m * (self._nut[name] - before)
        )
        self._centre_m = self._centre_m + shift_m * np.array(weight.direction)

    @property
    def settings(self) -> SimulationSettings:
        """Settings of the simulated rig with the present positions of the weights."""
        x_m, y_m, lower_m = self._centre_m
        contact, axes = self._settings.contact, self._settings.axes
        arm_m = contact.ball_radius_m + lower_m
        rest = {
            "rest_fast_arcsec": math.atan2(x_m, arm_m) / ARCSEC_RAD,
            "rest_slow_arcsec": math.atan2(y_m, arm_m) / ARCSEC_RAD,
        }
        period_s = contact.period0_s * math.sqrt(contact.ball_radius_m / arm_m)
        return self._settings.model_copy(
            update={
                "axes": axes.model_copy(update=rest),
                "contact": contact.model_copy(update={"period0_s": period_s}),
            }
        )


def imperfect_weights(nominal: dict[str, TrimWeight], seed: int) -> dict[str, TrimWeight]:
    """Weights with random deviations from the nominal ones: mass by up to 15 %, direction by some degrees,
    backlash.
    """
    random = np.random.default_rng((seed, 77))
    found = {}
    for name, weight in nominal.items():
        tilted = np.array(weight.direction) + random.uniform(-0.12, 0.12, 3)
        tilted *= np.linalg.norm(weight.direction) / np.linalg.norm(tilted)
        found[name] = TrimWeight(
            mass_kg=weight.mass_kg * random.uniform(0.85, 1.15),
            pitch_m=weight.pitch_m,
            direction=(float(tilted[0]), float(tilted[1]), float(tilted[2])),
            backlash_turns=random.uniform(0.0, 0.05),
        )
    return found
