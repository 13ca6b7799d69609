"""Preflight checks of the pendulum at rest: noise, vibration, ground, rest position."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.camera import Frame
from calibration import Stability, stability
from processing.arrays import Floats
from processing.balance import BalanceEstimator, BalanceLimits
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.pendulum_at_rest import ground_at_rest
from processing.spot import Spot, SpotModel
from rig.analysis import base_motion, drive_text
from rig.instrument import PLANE_OF_SWING, balance_verdicts
from rig.settings import PendulumSettings, PreflightSettings
from rig.terminal import Verdict, decimals

_MIN_LONG_PREFLIGHT_S = 50.0
NO_LEVER = "no lever: values in px have no limit in arcsec"


@dataclass(frozen=True, slots=True)
class TrialFrames:
    """Some seconds of frames, with the spots and deflections measured in them.

    `resting` is False if the pendulum may be swinging. `model` is the tracker's model of the beam; None
    before it is chosen. `references` are the spots of the reference beam, if there is one.
    """

    frames: Sequence[Frame]
    spots: Sequence[Spot]
    deflections: Deflections
    resting: bool
    model: SpotModel | None = None
    references: Sequence[Spot] = ()


def judged(name: str, ok: bool, wrong: tuple[str, str], measured: str, limit: str) -> Verdict:
    """A verdict; `wrong` is the pair of reason and remedy for the case that it is not ok."""
    reason, remedy = ("", "") if ok else wrong
    return Verdict(name, ok, reason, remedy, measured=measured, limit=limit)


def noise_and_vibration(
    x: Stability | None, y: Stability | None, unit: DeflectionUnit, limits: PreflightSettings
) -> list[Verdict]:
    """Check the noise of one frame and the strongest spectral line of a spot at rest."""
    noise_limit = f"{limits.max_noise_arcsec:g} arcsec"
    line_limit = f"{limits.max_vibration_arcsec:g} arcsec"
    if x is None or y is None:
        return [_too_few_spots("noise floor", noise_limit), _too_few_spots("vibration", line_limit)]
    noise = max(x.noise, y.noise) / unit.shown_size
    lines = sorted([*x.lines, *y.lines], key=lambda line: -line.amplitude)
    strongest = lines[0].amplitude / unit.shown_size if lines else 0.0
    named = f" ({lines[0].name})" if lines and lines[0].name else ""
    words = "none stands out"
    if lines:
        words = f"{strongest:.3f} {unit.shown} at {lines[0].frequency_hz:.1f} Hz{named}"
    noisy = "the spot is too noisy", "more light, a smaller gain; shield the beam from air"
    shakes = "the base shakes", "find what runs at this frequency; decouple the table"
    measured, quiet = f"{noise:.4f} {unit.shown} a frame", noise <= limits.max_noise_arcsec
    verdicts = [
        judged("noise floor", quiet, noisy, measured, noise_limit),
        judged("vibration", strongest <= limits.max_vibration_arcsec, shakes, words, line_limit),
    ]
    return [_against_arcsec(verdict, unit) for verdict in verdicts]


def ground(
    look: TrialFrames, pendulum: PendulumSettings | None, limits: PreflightSettings | None = None
) -> Verdict:
    """The verdict on the motion of the ground at the pendulum's frequency.

    It limits results, and forbids a run only if a limit is stated. Needs eight periods at rest.
    """
    at = look.deflections
    most = None if limits is None else limits.max_ground_rad_per_s2_rthz
    limit = "" if most is None else f"{most:g} rad/s²/√Hz"
    if not look.resting:
        return not_at_rest("ground", limit)
    try:
        found = ground_at_rest(at.times_s, at.y)
    except DataError as error:
        reason = f"{error}{longer_look(at)}"
        if most is None:
            return Verdict("ground", True, reason, measured="not measured", made=False)
        wrong = str(error), longer_look(at).removeprefix("; ")
        return judged("ground", False, wrong, "not measured", limit)
    of_angle = pendulum if at.unit is DeflectionUnit.RAD else None
    base = base_motion(found.density, found.upper_95, found.period_s, of_angle)
    words = drive_text(found.density, found.upper_95, base, seen=found.density.value > 0, unit=at.unit)
    words = f"{words}, in {at.times_s[-1]:.0f} s"
    if most is None:
        return Verdict("ground", True, measured=words)
    wrong = "it moves too much", "wait for a quieter hour, or allow more"
    verdict = judged("ground", found.density.value <= most, wrong, words, limit)
    return verdict if at.unit is DeflectionUnit.RAD else replace(verdict, ok=True, reason=NO_LEVER, remedy="")


def longer_look(at: Deflections) -> str:
    """The remedy for a preflight that was too short, in words; empty if it was long."""
    return "; preflight.duration_s = 60 would measure it" if at.times_s[-1] < _MIN_LONG_PREFLIGHT_S else ""


def rest_position(look: TrialFrames, limits: PreflightSettings) -> Verdict:
    """Check the rest position against the reference of the lever (without one, the sensor's centre)."""
    limit = f"{limits.max_rest_offset_arcsec:g} arcsec"
    at = look.deflections
    if not look.resting:
        return not_at_rest("rest position", limit)
    if not at.found.any():
        wrong = "nothing to measure", "find the spot first"
        return judged("rest position", False, wrong, "no spot", limit)
    x, y = np.nanmedian(at.shown_x), np.nanmedian(at.shown_y)
    remedy = "rig balance says which weight to turn; or move the camera"
    wrong = "the swing will not be centred on the sensor", remedy
    measured = f"X {decimals(x, 1, sign=True)}, Y {decimals(y, 1, sign=True)} {at.unit.shown}"
    ok = math.hypot(x, y) <= limits.max_rest_offset_arcsec
    verdict = judged("rest position", ok, wrong, measured, limit)
    return _against_arcsec(verdict, at.unit)


def plane_of_swing(look: TrialFrames, limits: BalanceLimits) -> list[Verdict]:
    """Check the rotation of the plane of a swinging pendulum, which frames show after five periods.

    No verdict at rest, where there is no rotation; `StartJudge` checks it later.
    """
    if look.resting or not len(look.deflections):
        return []
    found = BalanceEstimator().update(look.deflections)
    verdicts = balance_verdicts(found[-1] if found else None, limits)
    return [one for one in verdicts if one.name == PLANE_OF_SWING]


def stillness(look: TrialFrames, limits: PreflightSettings) -> list[Verdict]:
    """Check noise and vibration of the spot of a pendulum at rest; not made if it may be swinging."""
    at = look.deflections
    if not look.resting:
        names = ("noise floor", limits.max_noise_arcsec), ("vibration", limits.max_vibration_arcsec)
        return [not_at_rest(name, f"{limit:g} arcsec") for name, limit in names]
    return noise_and_vibration(
        _still(at.times_s, at.x, at.u_x), _still(at.times_s, at.y, at.u_y), at.unit, limits
    )


def _too_few_spots(name: str, limit: str) -> Verdict:
    wrong = "too few frames with a spot to judge by", "raise preflight.duration_s; find the spot"
    return judged(name, False, wrong, "not measured", limit)


def not_at_rest(name: str, limit: str) -> Verdict:
    """The verdict of a check that needs the pendulum at rest and was not made: it may be swinging."""
    reason = "the pendulum may be swinging (start.way = 'at once')"
    return Verdict(name, True, reason, measured="not measured", limit=limit, made=False)


def _against_arcsec(verdict: Verdict, unit: DeflectionUnit) -> Verdict:
    """The verdict unchanged, or marked as not made if the value is in px and the limit in arcsec."""
    if unit is DeflectionUnit.RAD:
        return verdict
    return replace(verdict, ok=True, reason=NO_LEVER, remedy="", made=False)


def _still(times_s: Floats, values: Floats, u: Floats) -> Stability | None:
    try:
        return stability(times_s, values, u)
    except DataError:
        return None
