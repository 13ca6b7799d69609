"""Preflight checks of the pendulum at rest: noise, vibration, ground, rest position, what else is recorded.

The benefit of auxiliary seismometer and reference spot forbids no run: the fit refuses a seismometer that
explains nothing, and frames without the reference spot stay uncorrected. A short look predicts little, and
its verdicts say how little.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from acquisition.camera import Frame
from acquisition.record.topics import RecordedSeismometer
from calibration import Stability, stability
from processing.arrays import Floats
from processing.arrival_times import sample_times
from processing.balance import BalanceEstimator, BalanceLimits
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.fit import Seismogram
from processing.pendulum_at_rest import (
    SeismometerAtRest,
    drive_at_rest,
    rest_oscillation,
    seismometer_at_rest,
)
from processing.reference_gain import ReferenceAtRest, gain_while_swinging, reference_at_rest
from processing.reference_spot import common_motion
from processing.spot import Spot, SpotFlag, SpotModel
from processing.units import seconds
from rig.analysis import drive_text
from rig.control import SeismometerSettings
from rig.instrument import PLANE_OF_SWING, balance_verdicts
from rig.settings import PreflightSettings, ReferenceSettings
from rig.terminal import Verdict, decimals, percent, plain, with_uncertainty

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


def ground(look: TrialFrames, limits: PreflightSettings | None = None) -> Verdict:
    """The verdict on the motion of the ground at the pendulum's frequency.

    It limits results, and forbids a run only if a limit is stated. Needs eight periods at rest.
    """
    at = look.deflections
    most = None if limits is None else limits.max_ground_rad_per_s2_rthz
    limit = "" if most is None else f"{most:g} rad/s²/√Hz"
    if not look.resting:
        return not_at_rest("ground", limit)
    try:
        found = drive_at_rest(at.times_s, at.y)
    except DataError as error:
        reason = f"{error}{longer_look(at)}"
        if most is None:
            return Verdict("ground", True, reason, measured="not measured", made=False)
        wrong = str(error), longer_look(at).removeprefix("; ")
        return judged("ground", False, wrong, "not measured", limit)
    words = drive_text(found.density, found.upper_95, at.unit, seen=found.density.value > 0)
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


_LIMIT = "samples come"
_MIN_SAMPLES = 20
_MAX_OFF_U = 4.0
"""Deviation of the stated from the fitted gain, in standard uncertainties, at which it is called wrong."""
_VALUES = ("first", "second", "third")


def seismometer(
    look: TrialFrames,
    problem: str | None,
    settings: SeismometerSettings,
    samples: Sequence[RecordedSeismometer],
    stated: ReferenceSettings | None,
) -> Verdict:
    """Check that samples of the auxiliary seismometer come and change, and predict its benefit at rest.

    `problem` is why no samples come, None without a seismometer; `samples` were taken during the frames. If a
    reference spot is `stated`, the beam's motion is subtracted first.
    """
    kind, names = settings.kind, settings.components
    if problem is None:
        return Verdict("seismometer", True, measured="none is configured", limit=_LIMIT, made=False)
    if problem:
        return judged(
            "seismometer", False, (problem, "see [seismometer]: its port, rate and columns"), kind, _LIMIT
        )
    if len(samples) < _MIN_SAMPLES:
        return _alive(
            f"{len(samples)} samples are too few to predict its benefit{longer_look(look.deflections)}",
            kind,
        )
    value = np.array([[getattr(one, name) for name in _VALUES[: len(names)]] for one in samples])
    if dead := [name for name, one in zip(names, value.T, strict=True) if not np.ptp(one) > 0]:
        reason = f"{', '.join(dead)}: constant over {len(samples)} samples: dead, or its scale is wrong"
        return judged("seismometer", False, (reason, "check its power, cable and range"), kind, _LIMIT)
    if not look.resting:
        return not_at_rest("seismometer", _LIMIT)
    at = look.deflections
    arrived_ns = np.array([one.time_ns for one in samples])
    if np.any(np.diff(arrived_ns) <= 0):
        order = np.concatenate([[True], np.diff(np.maximum.accumulate(arrived_ns)) > 0])
        arrived_ns, value = arrived_ns[order], value[order]
        samples = [one for one, kept in zip(samples, order.tolist(), strict=True) if kept]
    times_ns, _ = sample_times(arrived_ns, np.array([one.own_time_s for one in samples]))
    record = Seismogram(seconds(times_ns - at.times_ns[0]), value, tuple(names))
    try:
        found = seismometer_at_rest(at.times_s, _without_beam_motion(look, stated), record)
        ground_seen = drive_at_rest(at.times_s, at.y).density.value > 0
    except DataError as error:
        return _alive(f"{error}{longer_look(look.deflections)}", kind)
    return _benefit_verdict(found, ground_seen, kind)


def _without_beam_motion(look: TrialFrames, stated: ReferenceSettings | None) -> Floats:
    """The slow deflections minus the beam's motion that the reference spot shows."""
    at = look.deflections
    if stated is None or not look.references:
        return at.y
    spots, refs = _positions(look.spots), _positions(look.references)
    # deflection per px, fitted to the frames themselves
    use = at.found & np.all(np.isfinite(spots), axis=0)
    columns = np.column_stack([*spots[:2, use], np.ones(np.count_nonzero(use))])
    per_px = np.linalg.lstsq(columns, at.y[use], rcond=None)[0]
    beam = np.zeros(len(at.y))
    for axis in (0, 1):
        gain = stated.gain
        if gain is None:
            fitted = gain_while_swinging(
                at.times_ns, spots[axis], spots[2 + axis], refs[axis], refs[2 + axis]
            )
            gain = fitted.value if fitted.value > _MAX_OFF_U * fitted.standard_uncertainty else 0.0
        beam += gain * per_px[axis] * common_motion(at.times_ns, refs[axis], refs[2 + axis]).value
    return np.asarray(at.y - beam)


def _alive(reason: str, kind: str) -> Verdict:
    return Verdict("seismometer", True, reason, measured=f"{kind}, alive", limit=_LIMIT, made=False)


def _benefit_verdict(found: SeismometerAtRest, ground_seen: bool, kind: str) -> Verdict:
    in_all = f"squared coherence {plain(found.coherence, 3)} in {found.steps} periods"
    if not found.related:
        chance = f"{in_all}; unrelated records reach {plain(found.chance_coherence, 2)}"
        if not ground_seen:
            hidden = "the ground does not exceed the noise of the spot, so its benefit is unknown"
            return _alive(f"{hidden} ({chance})", kind)
        reason = f"it does not show what moves the pendulum: {chance}"
        remedy = "check its place, columns and clock; a fit refuses one that explains nothing"
        return Verdict(
            "seismometer", True, reason, remedy, measured=f"{kind}, unrelated so far", limit=_LIMIT
        )
    falls = f"{plain(found.factor, 2)} ({plain(found.lower_95, 2)} to {plain(found.upper_95, 2)})"
    measured = f"{in_all}: the swing at rest would fall by {falls}, "
    measured += f"the ground's part of it by {plain(found.lower_95, 2)} at least"
    return Verdict("seismometer", True, measured=measured, limit=_LIMIT)


class _ReferenceAxis(NamedTuple):
    name: str
    found: ReferenceAtRest


def reference(look: TrialFrames, stated: ReferenceSettings | None, limits: PreflightSettings) -> Verdict:
    """Check that the reference spot is seen, and predict how much of the spot's motion it would remove."""
    limit = f"found in {percent(1 - limits.max_lost_fraction, 3)}"
    if stated is None or not look.references:
        return Verdict("reference", True, measured="none is configured", limit=limit, made=False)
    lost = float(np.mean([bool(spot.flags & SpotFlag.LOST) for spot in look.references]))
    seen = f"found in {percent(1 - lost, 3)} of {len(look.references)} frames"
    if lost > limits.max_lost_fraction:
        reason = "frames without it keep the beam's motion"
        remedy = f"let its beam fall below row {stated.from_row_px}"
        return Verdict("reference", True, reason, remedy, measured=seen, limit=limit)
    if not look.resting:
        return not_at_rest("reference", limit)
    at = look.deflections
    try:
        period_s = rest_oscillation(at.times_s, at.y).period_s
        spots, refs = _positions(look.spots), _positions(look.references)
        axes = []
        for axis, name in enumerate("xy"):
            both = spots[axis], spots[2 + axis], refs[axis], refs[2 + axis]
            found = reference_at_rest(at.times_ns, *both, gain=stated.gain, period_s=period_s)
            axes.append(_ReferenceAxis(name, found))
    except DataError as error:
        return Verdict(
            "reference",
            True,
            f"{error}{longer_look(look.deflections)}",
            measured=seen,
            limit=limit,
            made=False,
        )
    return _judged_axes(axes, stated, seen, limit)


def _judged_axes(axes: Sequence[_ReferenceAxis], stated: ReferenceSettings, seen: str, limit: str) -> Verdict:
    texts, deviations, useless = [], [], True
    for name, found in axes:
        if not found.share > 0:
            texts.append(f"{name}: it shows no motion above its own noise")
            continue
        useless = useless and not found.factor.value - 3 * found.factor.standard_uncertainty > 1
        texts.append(f"{name}: {plain(found.before_px, 2)} px fall by {with_uncertainty(*found.factor)}")
        if stated.gain is None:
            continue
        off = abs(found.gain.value - stated.gain)
        if off > _MAX_OFF_U * np.hypot(found.gain.standard_uncertainty, stated.u_gain):
            deviations.append(f"{name} shows a gain of {with_uncertainty(*found.gain)}")
    measured = f"{seen}; {', '.join(texts)}"
    if deviations:
        reason = f"{', '.join(deviations)}, and reference.gain = {stated.gain:g} is stated"
        remedy = "state the gain of the two arms, with its u_gain"
        return Verdict("reference", True, reason, remedy, measured=measured, limit=limit)
    if useless:
        reason = "it does not make the spot at rest quieter, as far as this short record shows"
        return Verdict("reference", True, reason, measured=measured, limit=limit)
    return Verdict("reference", True, measured=measured, limit=limit)


def _positions(spots: Sequence[Spot]) -> Floats:
    """Positions x, y and their standard uncertainties in px, (4, n); NaN where the spot is lost."""
    table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4).T
    table[:, [bool(spot.flags & SpotFlag.LOST) for spot in spots]] = np.nan
    return table
