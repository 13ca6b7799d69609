"""Advice for balancing: which quantities exceed their limits, which weight to turn, which way and how far.

The effect of turning each weight is estimated from the states before and after earlier turns; the nominal
effect (from mass, thread and axis of the weight) serves as the prior.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.balance.balance import Balance
from processing.deflections import DeflectionUnit

Floats = NDArray[np.float64]
_U_TURN = 0.02


@dataclass(frozen=True)
class BalanceLimits:
    """Limits within which the rig counts as balanced; units as in the names, ratios without a unit."""

    rest_arcsec: float = field(default=10.0, metadata={"gt": 0})
    height_m: float = field(default=20e-6, metadata={"gt": 0})
    line_angle_deg: float = field(default=0.5, metadata={"gt": 0})
    transverse_ratio: float = field(default=0.01, metadata={"gt": 0})
    width_ratio: float = field(default=0.01, metadata={"gt": 0})
    spin_deg_per_min: float = field(default=0.2, metadata={"gt": 0})


class Fault(NamedTuple):
    """A quantity that describes the balance, with its limit and the meaning of its sign."""

    name: str
    value: float
    u_value: float
    unit: str
    limit: float
    meaning: str

    @property
    def ok(self) -> bool:
        """Whether the value is within its limit; True also for a value that was not determined."""
        return not abs(self.value) > self.limit


class Turn(NamedTuple):
    """The next adjustment: the weight, the number of turns (positive: clockwise) and the reason (`why`)."""

    weight: str
    turns: float
    why: str


def mass_centre_height_m(
    period0_s: float, inertia_kg_m2: float, mass_kg: float, ball_radius_m: float, gravity_m_per_s2: float
) -> float:
    """Height of the centre of mass above the contact spot in m, from I = m g l T0^2 / (4 pi^2).

    l is the distance from the ball's centre down to the centre of mass; it equals the ball's radius if the
    centre of mass lies at the contact spot (Eq. 4). Negative: the centre of mass is below the contact spot.
    """
    arm_m = 4.0 * math.pi**2 * inertia_kg_m2 / (mass_kg * gravity_m_per_s2 * period0_s**2)
    return ball_radius_m - arm_m


def find_faults(balance: Balance, height: tuple[float, float], limits: BalanceLimits) -> list[Fault]:
    """All quantities of the balance with their limits. `height` is (value, standard uncertainty) in m.

    Raises ValueError for a balance in px: its limits are in arcsec.
    """
    if balance.unit is not DeflectionUnit.RAD:
        raise ValueError(
            f"a balance in {balance.unit} has no limits: they are in arcsec, calibrate the lever"
        )
    arcsec, degree = ARCSEC_RAD, math.pi / 180.0
    b = balance
    per_min = 60.0 / degree
    return [
        Fault(
            "rest position X", b.rest_x / arcsec, b.u_rest_x / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+X" if b.rest_x > 0 else "-X"),
        ),
        Fault(
            "rest position Y", b.rest_y / arcsec, b.u_rest_y / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+Y" if b.rest_y > 0 else "-Y"),
        ),
        Fault(
            "mass centre", height[0] * 1e6, height[1] * 1e6, "um", limits.height_m * 1e6,
            "too high: the period is long" if height[0] > 0 else "too low: the period is short",
        ),
        Fault(
            "angle of the line", b.line_angle_rad / degree, b.u_line_angle_rad / degree, "deg",
            limits.line_angle_deg, "turn the camera, or the mirror, "
            + ("back from X towards Y" if b.line_angle_rad > 0 else "from Y towards X"),
        ),
        Fault(
            "transverse motion", b.transverse_ratio, b.u_transverse_ratio, "", limits.transverse_ratio,
            "the start pushes sideways: release along Y",
        ),
        Fault(
            "leakage (width)", b.width_ratio, b.u_width_ratio, "", limits.width_ratio,
            "the slow mode leaks into X: the axes of inertia lie askew to the contact",
        ),
        Fault(
            "spin", b.rotation_rad_per_s * per_min, b.u_rotation_rad_per_s * per_min, "deg/min",
            limits.spin_deg_per_min, "turns about the vertical: let it settle before the release",
        ),
    ]  # fmt: skip


class WeightResponses:
    """Effect of one turn of each weight on (rest X in arcsec, rest Y in arcsec, height in m).

    Each effect has a normal distribution, which every pair of states before and after a turn narrows (linear
    regression with a prior). `nominal` gives the prior of each weight: effects and their standard
    uncertainties, or None if nothing is known; a test turn is advised first then.
    """

    def __init__(self, nominal: Mapping[str, tuple[Floats, Floats] | None], limits: BalanceLimits) -> None:
        self._scale = np.array([limits.rest_arcsec, limits.rest_arcsec, limits.height_m])
        self._mean: dict[str, Floats] = {}
        self._variance: dict[str, Floats] = {}
        self.pairs = dict.fromkeys(nominal, 0)
        for name, known in nominal.items():
            effect, u_effect = known if known is not None else (np.zeros(3), 1e3 * self._scale)
            self._mean[name] = np.asarray(effect, dtype=np.float64) / self._scale
            self._variance[name] = (np.asarray(u_effect, dtype=np.float64) / self._scale) ** 2

    def learn(self, weight: str, turns: float, before: Floats, after: Floats, u_state: Floats) -> None:
        """Update with the states before and after `turns` of one weight; NaN for a component not known."""
        if turns == 0.0:
            return
        step = (after - before) / self._scale
        size = max(float(np.linalg.norm(np.nan_to_num(step))) / abs(turns), 1e-12)
        # a turn is made by hand: the uncertainty of its effect is proportional to it
        noise = 2.0 * (u_state / self._scale) ** 2 + (size * _U_TURN) ** 2 + (0.01 * size * turns) ** 2
        mean, variance = self._mean[weight], self._variance[weight]
        seen = np.isfinite(step)
        gain = np.where(seen, variance * turns / (turns**2 * variance + noise), 0.0)
        self._mean[weight] = mean + gain * np.where(seen, step - turns * mean, 0.0)
        self._variance[weight] = np.maximum(variance * (1.0 - gain * turns), 1e-30)
        self.pairs[weight] += 1

    def effect(self, weight: str) -> tuple[Floats, Floats]:
        """Effect of one turn of a weight and its standard uncertainties, in (arcsec, arcsec, m)."""
        return self._mean[weight] * self._scale, np.sqrt(self._variance[weight]) * self._scale

    def advise(self, state: Floats, test_turns: float = 1.0) -> Turn | None:
        """The next turn of one weight; None if the state is within the limits.

        Least squares gives the turns of all weights that together would bring the state to zero. The weight
        that has been turned least often is advised first, because all later turns benefit from what
        is learned about it; among equals the one whose effect is the most uncertain. Turns with an
        effect of less than half a limit are omitted. If one turn alone suffices, it is advised.
        """
        wanted = np.nan_to_num(state / self._scale)
        if np.all(np.abs(wanted) <= 1.0):
            return None
        known = [name for name in self._mean if np.linalg.norm(self._mean[name]) > 0]
        unknown = [name for name in self._mean if name not in known]
        for name in known:
            effect, variance = self._mean[name], self._variance[name]
            alone = -float(effect @ wanted) / float(effect @ effect)
            left = np.abs(wanted + alone * effect) + 2.0 * abs(alone) * np.sqrt(variance)
            if np.all(left <= 0.9):
                return Turn(name, float(round(alone, 2)), _words(name, self.pairs))
        turns = np.zeros(0)
        if known:
            effects = np.column_stack([self._mean[name] for name in known])
            turns, *_ = np.linalg.lstsq(effects, -wanted, rcond=1e-3)
            left = wanted + effects @ turns
            gains = [abs(t) * float(np.linalg.norm(self._mean[n])) for t, n in zip(turns, known, strict=True)]
            doubts = [
                abs(t) * math.sqrt(float(np.sum(self._variance[n])))
                for t, n in zip(turns, known, strict=True)
            ]
            if not unknown or np.all(np.abs(left) <= 1.0):
                needed = [k for k, gain in enumerate(gains) if gain > 0.5]
                best = min(
                    needed or [int(np.argmax(gains))], key=lambda k: (self.pairs[known[k]], -doubts[k])
                )
                return Turn(known[best], float(round(turns[best], 2)), _words(known[best], self.pairs))
        name = unknown[0]
        return Turn(name, test_turns, "a test turn: nothing is known of this weight yet")


def _words(weight: str, pairs: Mapping[str, int]) -> str:
    count = pairs[weight]
    return f"learned from {count} turn{'s' if count > 1 else ''}" if count else "from its mass and thread"
