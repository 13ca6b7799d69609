"""A measured balance against the configuration: verdicts, effects of the weights, height, advice."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration import Axes, deflections
from processing.balance import (
    Balance,
    BalanceCheck,
    BalanceLimits,
    Room,
    Turn,
    Unreachable,
    WeightResponses,
    balance_checks,
    mass_centre_height_m,
)
from processing.contact import Material, PendulumOnBall, frequency_drop, stiffness_ratio
from processing.contact import material as material_by_name
from processing.contact import pendulum_on_ball as pendulum_after_hertz
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.units import ARCSEC_RAD
from rig.instrument.pipeline import reference_px
from rig.settings import Configuration
from rig.terminal import Verdict, judged_number, percent


def pendulum_on_ball(config: Configuration) -> PendulumOnBall | None:
    """Mass, ball and contact radius (by Hertz's theory if not stated); None without [pendulum]."""
    pendulum = config.pendulum
    if pendulum is None:
        return None
    # the mass that one ball carries, so that moments and energies are those of one contact
    mass_kg = pendulum.mass_kg / balls(config)
    if pendulum.contact_radius_m is not None:
        return PendulumOnBall(
            mass_kg, pendulum.ball_radius_m, pendulum.contact_radius_m, pendulum.gravity_m_per_s2
        )
    return pendulum_after_hertz(
        mass_kg,
        pendulum.ball_radius_m,
        material(config, pendulum.ball_material),
        material(config, pendulum.flat_material),
        gravity_m_per_s2=pendulum.gravity_m_per_s2,
    )


def balls(config: Configuration) -> int:
    """Number of equal balls that share the weight."""
    return config.instrument.description().supports


def material(config: Configuration, name: str) -> Material:
    """A material by name; those of the configuration take precedence over those of the paper."""
    return material_by_name(name, config.materials)


def check_materials(config: Configuration) -> None:
    """Raise ConfigurationError for an unknown material, before anything is measured."""
    if config.pendulum is not None and config.pendulum.contact_radius_m is None:
        try:
            pendulum_on_ball(config)
        except ConfigurationError as error:
            raise ConfigurationError(f"pendulum: {error} under [materials.NAME]") from None


_MAX_SWING_ARCSEC: Final = 1e3
"""Largest limit of the amplitude that is stated; a larger one limits nothing."""
PLANE_OF_SWING: Final = "plane of swing"
"""Name of the condition that the plane of swing must not turn."""
_MIN_EXCESS_U: Final = 2.0
"""Minimum excess over a limit, in standard uncertainties, with which a single period fails its condition."""


_BALANCE: Final = "set the balance with rig balance"
_SETTLE: Final = "let the pendulum settle before the release; rig balance shows the rotation"
_CONDITION_OF_CHECK: Final[Mapping[str, tuple[str, str, str]]] = {
    "transverse motion": (
        "transverse motion",
        "the start pushed it sideways",
        "release along Y; rig balance",
    ),
    "leakage": ("ellipticity", "the slow mode draws an ellipse", _BALANCE),
    "spin": (PLANE_OF_SWING, "it turns about the vertical", _SETTLE),
    "rest position X": ("tilt at rest, X", "it rests askew", _BALANCE),
    "rest position Y": ("tilt at rest, Y", "it rests askew", _BALANCE),
}
"""Name of a condition of a run, what is wrong where it fails, and what to do, by the check of its balance.

The direction of the line is the camera's, and is no condition.
"""

BALANCE_CONDITIONS: Final = frozenset(name for name, _, _ in _CONDITION_OF_CHECK.values())
"""Names of the conditions of a run that its balance decides."""


def balance_verdicts(balance: Balance | None, limits: BalanceLimits) -> list[Verdict]:
    """One verdict for each quantity of the balance that is known and limited; empty without a balance."""
    return [] if balance is None else _verdicts(balance, limits, 0.0)


def run_balance_verdicts(balance: Balance | None, limits: BalanceLimits) -> list[Verdict]:
    """The verdicts of a whole run, with a warning if it is unknown whether the plane of swing turned."""
    verdicts = balance_verdicts(balance, limits)
    if any(verdict.name == PLANE_OF_SWING for verdict in verdicts):
        return verdicts
    remedy = "measure longer, with at least 20 frames in two periods and both axes on the sensor"
    unknown = "whether it turned is not known: too few periods"
    return [*verdicts, Verdict(PLANE_OF_SWING, True, unknown, remedy)]


def balance_failures(balance: Balance, limits: BalanceLimits) -> list[str]:
    """Name, value and limit of each condition that the balance of one period certainly fails."""
    return [
        f"{verdict.name} {verdict.measured}, limit {verdict.limit}"
        for verdict in _verdicts(balance, limits, _MIN_EXCESS_U)
        if not verdict.ok
    ]


def _verdicts(balance: Balance, limits: BalanceLimits, beyond_u: float) -> list[Verdict]:
    if balance.unit is not DeflectionUnit.RAD:
        # ratios and angles need no lever; the limits of the rest position are in arcsec
        balance = replace(balance, unit=DeflectionUnit.RAD, rest_x=math.nan, rest_y=math.nan)
    return [
        _verdict(check, beyond_u)
        for check in balance_checks(balance, (math.nan, math.nan), limits)
        if check.is_known and check.name in _CONDITION_OF_CHECK
    ]


def _verdict(check: BalanceCheck, beyond_u: float) -> Verdict:
    name, *fault = _CONDITION_OF_CHECK[check.name]
    ok = check.ok or not abs(check.value) - beyond_u * check.u_value > check.limit
    if check.unit:
        measured = f"{judged_number(check.value, check.u_value, check.limit)} {check.unit}"
        limit = f"{check.limit:g} {check.unit}"
    else:
        measured, limit = percent(abs(check.value)), f"{100 * check.limit:g} %"
    reason, remedy = ("", "") if ok else fault
    return Verdict(name, ok, reason, remedy, measured=measured, limit=limit)


Floats = NDArray[np.float64]
_U_RATIO = 0.3
"""Ratio of the uncertainty of a weight's effect out of its plane to that in the plane."""
_MIN_EDGE_DISTANCE_PX = 24
"""Smallest distance of a resting spot from the sensor's edges: about its width."""
WEIGHTS = ("x", "y", "height")
DIRECTIONS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "height": (0.0, 0.0, 1.0)}


def nominal_effects(config: Configuration) -> dict[str, tuple[Floats, Floats] | None]:
    """Expected effect of one turn of each weight, from its mass and thread, with standard uncertainty.

    An effect is (tilt in x in arcsec, tilt in y in arcsec, height of the mass centre in m); None: unknown.
    Its relative uncertainty is `balance.u_effect` in the plane of its axis, a fraction of that across.
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
        direction = np.array(DIRECTIONS[name])
        u_ratios = [_U_RATIO, _U_RATIO, 1.0] if name == "height" else [1.0, 1.0, _U_RATIO]
        effects[name] = (direction * turn, config.balance.u_effect * np.array(u_ratios) * np.abs(turn))
    return effects


def elastic_drop(config: Configuration, amplitude_rad: float) -> float:
    """Relative reduction of the frequency at an amplitude by the elasticity of the contact (Eq. 6)."""
    pendulum = pendulum_on_ball(config)
    if pendulum is None or config.balance.gamma_pa == 0:
        return 0.0
    kappa = stiffness_ratio(config.balance.gamma_pa, pendulum)
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    return float(frequency_drop(amplitude_rad, config.balance.n, kappa, rho))


def mass_centre_height(config: Configuration, balance: Balance) -> tuple[float, float]:
    """Excess height of the mass centre in m, from the period, and its uncertainty; NaN if unknown.

    `balance` must be in rad, because the period depends on the angle.
    """
    pendulum, inertia = config.pendulum, config.balance.inertia_kg_m2
    if pendulum is None or inertia is None:
        return math.nan, math.nan
    # elasticity lowers the stiffness, relatively by twice as much as the frequency: 3 um of height on steel
    period0_s = balance.period_s * math.sqrt(1.0 - 2.0 * elastic_drop(config, balance.amplitude))
    height_m = mass_centre_height_m(
        period0_s, inertia, pendulum.mass_kg, pendulum.ball_radius_m, pendulum.gravity_m_per_s2
    )
    return height_m, 2.0 * pendulum.ball_radius_m * balance.u_period_s / balance.period_s


def sensor_room(config: Configuration, sensor_shape: tuple[int, int]) -> Room | None:
    """Tilts with the resting spot on a sensor of (ny, nx) pixels, off its edges; None without a lever."""
    if config.lever is None:
        return None
    ny, nx = sensor_shape
    zero_px = reference_px(config.lever, sensor_shape)
    middle_px = np.array([0.5 * (nx - 1), 0.5 * (ny - 1)])
    points_px = middle_px + np.array([[0, 0], [1, 0], [0, 1]])
    zero = np.zeros(3)
    x_px, y_px = points_px.T
    tilts = deflections(config.lever, config.axes or Axes(), x_px, y_px, zero, zero, zero_px)
    middle, right, down = np.column_stack(tilts[:2]) / ARCSEC_RAD
    px_per_arcsec = np.linalg.inv(np.column_stack([right - middle, down - middle]))
    scale = np.linalg.norm(px_per_arcsec, axis=1)
    normals = px_per_arcsec / scale[:, None]
    half_arcsec = np.maximum(middle_px - _MIN_EDGE_DISTANCE_PX, 1.0) / scale
    offset_arcsec = normals @ middle
    return Room(
        np.vstack([normals, -normals]),
        np.concatenate([half_arcsec + offset_arcsec, half_arcsec - offset_arcsec]),
    )


def turn_text(turn: Turn | Unreachable | None, checks: Sequence[BalanceCheck]) -> str:
    """One line that says which weight to turn, by how much and in which direction."""
    if isinstance(turn, Unreachable):
        return f"out of reach: {turn.why}"
    if turn is not None:
        parts = ", then ".join(
            f"{abs(turns):.2f} turns {'clockwise' if turns > 0 else 'anticlockwise'}" for turns in turn.parts
        )
        swing = swing_text(turn.swing_arcsec)
        return f"turn weight {turn.weight}: {parts} ({turn.why}){swing and f'; {swing}'}"
    verdict = _checks_line(checks)
    return verdict if all(check.ok for check in checks) else f"the weights are right; still {verdict}"


def swing_text(swing_arcsec: float) -> str:
    """How far the pendulum may swing after a turn, in words; empty if any swing stays on the sensor."""
    text = f"then let it swing by at most {swing_arcsec:.0f} arcsec"
    return text if swing_arcsec < _MAX_SWING_ARCSEC else ""


def _checks_line(checks: Sequence[BalanceCheck]) -> str:
    failed = ", ".join(check.name for check in checks if not check.ok)
    unknown = ", ".join(check.name for check in checks if not check.is_known)
    verdict = f"out of limits: {failed}" if failed else "balanced: within all limits"
    return f"{verdict} that are known; unknown: {unknown}" if unknown and not failed else verdict


def advice_for(
    config: Configuration, balance: Balance, learned: WeightResponses | None = None, room: Room | None = None
) -> str:
    """The weight to turn and the faults of a balance, as Markdown.

    It is based on the effects that `rig balance` has `learned`, or else on the nominal ones. Empty for a
    balance in px, because the limits are in arcsec, and for a recorded balance without rest position.
    """
    if balance.unit is not DeflectionUnit.RAD or math.isnan(balance.rest_x):
        return ""
    height_m = mass_centre_height(config, balance)
    checks = balance_checks(balance, height_m, config.balance)
    state = np.array([checks[0].value, checks[1].value, height_m[0]])
    effects = {name: effect for name, effect in nominal_effects(config).items() if effect is not None}
    responses = learned or (WeightResponses(effects, config.balance) if effects else None)
    turn = None if responses is None else responses.advise(state, room)
    next_step = _checks_line(checks) if responses is None else turn_text(turn, checks)
    faults = [
        f"- {check.name} {judged_number(check.value, check.u_value, check.limit)} {check.unit} "
        f"(limit {check.limit:g}): {check.meaning}"
        for check in checks
        if not check.ok
    ]
    return "\n".join([f"**{next_step}**", "", *faults])
