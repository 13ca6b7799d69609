"""Applies the configuration to a measured balance: effects of the weights, height, advice to the operator."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.balance import (
    Balance,
    Fault,
    Turn,
    WeightResponses,
    find_faults,
    mass_centre_height_m,
)
from processing.contact import frequency_drop, stiffness_ratio
from processing.deflections import DeflectionUnit
from rig.instrument.pendulum import pendulum_on_ball
from rig.presentation import with_uncertainty
from rig.settings import Configuration

Floats = NDArray[np.float64]
_U_NOMINAL = 0.2
WEIGHTS = ("x", "y", "height")
DIRECTIONS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "height": (0.0, 0.0, 1.0)}


def nominal_effects(config: Configuration) -> dict[str, tuple[Floats, Floats] | None]:
    """Expected effect of one turn of each weight, from its mass and thread, with standard uncertainty.

    An effect is (tilt in x in arcsec, tilt in y in arcsec, height of the mass centre in m); None: unknown.
    Its uncertainty is a fifth of the shift in every direction, since no screw is exactly along its axis.
    """
    pendulum = config.pendulum
    effects: dict[str, tuple[Floats, Floats] | None] = {}
    for name in WEIGHTS:
        weight = getattr(config.balance, f"weight_{name}")
        if pendulum is None or weight.mass_kg == 0 or weight.sense == 0:
            effects[name] = None
            continue
        shift_m = weight.sense * weight.mass_kg / pendulum.mass_kg * weight.pitch_m
        tilt_arcsec = shift_m / pendulum.ball_radius_m / ARCSEC_RAD
        # a positive turn moves the height weight down, and the mass centre with it
        turn = np.array([tilt_arcsec, tilt_arcsec, -shift_m])
        effects[name] = (np.array(DIRECTIONS[name]) * turn, _U_NOMINAL * np.abs(turn))
    return effects


def elastic_drop(config: Configuration, amplitude_rad: float) -> float:
    """Relative reduction of the frequency by the elasticity of the contact at an amplitude (Eq. 6)."""
    pendulum = pendulum_on_ball(config)
    if pendulum is None or config.balance.gamma_pa == 0:
        return 0.0
    kappa = stiffness_ratio(config.balance.gamma_pa, pendulum)
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    return float(frequency_drop(amplitude_rad, config.balance.n, kappa, rho))


def height_of(config: Configuration, balance: Balance) -> tuple[float, float]:
    """Excess height of the mass centre in m, from the period, and its uncertainty; NaN if unknown.

    `balance` must be in rad, because the period depends on the angle.
    """
    pendulum, inertia = config.pendulum, config.balance.inertia_kg_m2
    if pendulum is None or inertia is None:
        return math.nan, math.nan
    period0_s = balance.period_s * (1.0 - elastic_drop(config, balance.amplitude))
    height_m = mass_centre_height_m(
        period0_s, inertia, pendulum.mass_kg, pendulum.ball_radius_m, pendulum.gravity_m_per_s2
    )
    return height_m, 2.0 * pendulum.ball_radius_m * balance.u_period_s / balance.period_s


def turn_text(turn: Turn | None, faults: Sequence[Fault]) -> str:
    """One line that says which weight to turn, by how much and in which direction."""
    if turn is not None:
        way = "clockwise" if turn.turns > 0 else "anticlockwise"
        return f"turn weight {turn.weight}: {abs(turn.turns):.2f} turns {way} ({turn.why})"
    verdict = _verdict(faults)
    return verdict if all(fault.ok for fault in faults) else f"the weights are right; still {verdict}"


def _verdict(faults: Sequence[Fault]) -> str:
    rest = ", ".join(fault.name for fault in faults if not fault.ok)
    return f"out of limits: {rest}" if rest else "balanced: within all limits"


def advice_text(config: Configuration, balance: Balance, learned: WeightResponses | None = None) -> str:
    """Faults of a balance and the weight to turn, in Markdown.

    Uses the effects `learned` by `rig balance` if given, else the expected ones. Empty for a balance in px,
    because the limits are in arcsec, and for a recorded one without the rest position.
    """
    if balance.unit is not DeflectionUnit.RAD or math.isnan(balance.rest_x):
        return ""
    height_m = height_of(config, balance)
    faults = find_faults(balance, height_m, config.balance)
    state = np.array([faults[0].value, faults[1].value, height_m[0]])
    effects = {name: effect for name, effect in nominal_effects(config).items() if effect is not None}
    responses = learned or (WeightResponses(effects, config.balance) if effects else None)
    head = _verdict(faults) if responses is None else turn_text(responses.advise(state), faults)
    lines = [f"**{head}**", ""]
    lines += [
        f"- {fault.name} {with_uncertainty(fault.value, fault.u_value, signed=True)} {fault.unit} "
        f"(limit {fault.limit:g}): {fault.meaning}"
        for fault in faults
        if not fault.ok
    ]
    return "\n".join(lines)
