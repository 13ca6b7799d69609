"""Preflight checks of the pendulum at rest: noise, vibration, ground, rest position, auxiliary measurements.

A useless auxiliary seismometer or reference spot forbids no run: the fit refuses a seismometer that explains
nothing, and frames without the reference spot stay uncorrected. A short preflight predicts little, and its
verdicts say how little.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.camera import Frame
from acquisition.record.topics import RecordedSeismometer
from calibration import stability
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

MIN_GROUND_S = 60.0
"""Shortest preflight that holds the eight periods at rest which the ground's drive needs."""
_MIN_LONG_PREFLIGHT_S = 50.0
"""Shortest time span of frames that needs no longer preflight: some of `MIN_GROUND_S` may be missing."""
NO_LEVER = "no lever: values in px have no limit in arcsec"


@dataclass(frozen=True, slots=True)
class TrialFrames:
    """Some seconds of frames, with the spots and deflections measured in them."""

    frames: Sequence[Frame]
    """The newest frames, as many as memory holds."""
    spots: Sequence[Spot]
    deflections: Deflections
    resting: bool
    """Whether the pendulum is at rest; False if it may be swinging."""
    model: SpotModel | None = None
    """The tracker's model of the beam; None before it is chosen."""
    references: Sequence[Spot] = ()
    """The spots of the reference beam; empty without one."""


def judged(name: str, ok: bool, fault: tuple[str, str], measured: str, limit: str) -> Verdict:
    """A verdict; `fault` is the pair of reason and remedy for the case that it is not ok."""
    reason, remedy = ("", "") if ok else fault
    return Verdict(name, ok, reason, remedy, measured=measured, limit=limit)


def stillness(trial: TrialFrames, limits: PreflightSettings) -> list[Verdict]:
    """Check the noise of one frame and the strongest spectral line of the spot of a pendulum at rest.

    Not made if it may be swinging.
    """
    noise_limit = f"{limits.max_noise_arcsec:g} arcsec"
    line_limit = f"{limits.max_vibration_arcsec:g} arcsec"
    checks = ("noise floor", noise_limit), ("vibration", line_limit)
    if not trial.resting:
        return [not_at_rest(name, limit) for name, limit in checks]
    deflections, unit = trial.deflections, trial.deflections.unit
    try:
        x = stability(deflections.times_s, deflections.x, deflections.u_x)
        y = stability(deflections.times_s, deflections.y, deflections.u_y)
    except DataError:
        fault = "too few frames with a spot to judge by", "raise preflight.duration_s; find the spot"
        return [judged(name, False, fault, "not measured", limit) for name, limit in checks]
    noise = max(x.noise, y.noise) / unit.shown_size
    noise_text = f"{noise:.4f} {unit.shown} a frame"
    noise_fault = "the spot is too noisy", "more light, a smaller gain; shield the beam from air"
    amplitude, line_text = 0.0, "none stands out"
    if strongest := max([*x.lines, *y.lines], key=lambda line: line.amplitude, default=None):
        amplitude = strongest.amplitude / unit.shown_size
        name = f" ({strongest.name})" if strongest.name else ""
        line_text = f"{amplitude:.3f} {unit.shown} at {strongest.frequency_hz:.1f} Hz{name}"
    line_fault = "the base shakes", "find what runs at this frequency; decouple the table"
    is_quiet, is_still = noise <= limits.max_noise_arcsec, amplitude <= limits.max_vibration_arcsec
    return [
        _against_arcsec(judged("noise floor", is_quiet, noise_fault, noise_text, noise_limit), unit),
        _against_arcsec(judged("vibration", is_still, line_fault, line_text, line_limit), unit),
    ]


def ground(trial: TrialFrames, limits: PreflightSettings) -> Verdict:
    """The verdict on the motion of the ground at the pendulum's frequency.

    It limits results, and forbids a run only if a limit is stated. Needs eight periods at rest.
    """
    deflections = trial.deflections
    max_density = limits.max_ground_rad_per_s2_rthz
    limit = "" if max_density is None else f"{max_density:g} rad/s²/√Hz"
    if not trial.resting:
        return not_at_rest("ground", limit)
    try:
        drive = drive_at_rest(deflections.times_s, deflections.y)
    except DataError as error:
        remedy = longer_preflight(deflections)
        if max_density is None:
            return Verdict("ground", True, f"{error}{remedy}", measured="not measured", made=False)
        fault = str(error), remedy.removeprefix("; ")
        return judged("ground", False, fault, "not measured", limit)
    text = drive_text(drive.density, drive.upper_95, deflections.unit, seen=drive.density.value > 0)
    text = f"{text}, in {deflections.times_s[-1]:.0f} s"
    if max_density is None:
        return Verdict("ground", True, measured=text)
    fault = "it moves too much", "wait for a quieter hour, or allow more"
    verdict = judged("ground", drive.density.value <= max_density, fault, text, limit)
    if deflections.unit is DeflectionUnit.RAD:
        return verdict
    return replace(verdict, ok=True, reason=NO_LEVER, remedy="")


def longer_preflight(deflections: Deflections) -> str:
    """The remedy for a preflight that was too short, in words; empty if it was long."""
    is_long = deflections.times_s[-1] >= _MIN_LONG_PREFLIGHT_S
    return "" if is_long else f"; preflight.duration_s = {MIN_GROUND_S:g} would measure it"


def rest_position(trial: TrialFrames, limits: PreflightSettings) -> Verdict:
    """Check the rest position against the reference of the lever (without one, the sensor's centre)."""
    limit = f"{limits.max_rest_offset_arcsec:g} arcsec"
    deflections = trial.deflections
    if not trial.resting:
        return not_at_rest("rest position", limit)
    if not deflections.found.any():
        return judged("rest position", False, ("nothing to measure", "find the spot first"), "no spot", limit)
    x, y = np.nanmedian(deflections.shown_x), np.nanmedian(deflections.shown_y)
    remedy = "rig balance says which weight to turn; or move the camera"
    fault = "the swing will not be centred on the sensor", remedy
    measured = f"X {decimals(x, 1, sign=True)}, Y {decimals(y, 1, sign=True)} {deflections.unit.shown}"
    ok = math.hypot(x, y) <= limits.max_rest_offset_arcsec
    verdict = judged("rest position", ok, fault, measured, limit)
    return _against_arcsec(verdict, deflections.unit)


def plane_of_swing(trial: TrialFrames, limits: BalanceLimits) -> list[Verdict]:
    """Check the rotation of the plane of a swinging pendulum, which frames show after five periods.

    No verdict at rest, where there is no rotation; `StartJudge` checks it later.
    """
    if trial.resting or not len(trial.deflections):
        return []
    balances = BalanceEstimator().update(trial.deflections)
    verdicts = balance_verdicts(balances[-1] if balances else None, limits)
    return [verdict for verdict in verdicts if verdict.name == PLANE_OF_SWING]


def not_at_rest(name: str, limit: str) -> Verdict:
    """The verdict of a check that needs the pendulum at rest and was not made: it may be swinging."""
    reason = "the pendulum may be swinging (start.way = 'at once')"
    return Verdict(name, True, reason, measured="not measured", limit=limit, made=False)


def _against_arcsec(verdict: Verdict, unit: DeflectionUnit) -> Verdict:
    """The verdict unchanged, or marked as not made if the value is in px and the limit in arcsec."""
    if unit is DeflectionUnit.RAD:
        return verdict
    return replace(verdict, ok=True, reason=NO_LEVER, remedy="", made=False)


_LIMIT = "samples come"
_MIN_SAMPLES = 20
_MAX_DEVIATION_SIGMA = 4.0
"""Deviation of a gain from that stated, or from 0, in standard uncertainties, above which it is real."""
_VALUES = ("first", "second", "third")
"""Fields of a recorded sample, in the order of the components."""


def seismometer(
    trial: TrialFrames,
    problem: str | None,
    settings: SeismometerSettings,
    samples: Sequence[RecordedSeismometer],
    stated: ReferenceSettings | None,
) -> Verdict:
    """Check that samples of the auxiliary seismometer come and change, and predict its benefit at rest.

    `problem` is why no samples come, empty if they come, None without a seismometer; `samples` were taken
    during the frames. If a reference spot is `stated`, the beam's motion is subtracted first.
    """
    kind, components = settings.kind, settings.components
    if problem is None:
        return Verdict("seismometer", True, measured="none is configured", limit=_LIMIT, made=False)
    if problem:
        return judged(
            "seismometer", False, (problem, "see [seismometer]: its port, rate and columns"), kind, _LIMIT
        )
    if len(samples) < _MIN_SAMPLES:
        return _alive(
            f"{len(samples)} samples are too few to predict its benefit{longer_preflight(trial.deflections)}",
            kind,
        )
    fields = _VALUES[: len(components)]
    values = np.array([[getattr(sample, field) for field in fields] for sample in samples])
    if dead := [name for name, column in zip(components, values.T, strict=True) if not np.ptp(column) > 0]:
        reason = f"{', '.join(dead)}: constant over {len(samples)} samples: dead, or its scale is wrong"
        return judged("seismometer", False, (reason, "check its power, cable and range"), kind, _LIMIT)
    if not trial.resting:
        return not_at_rest("seismometer", _LIMIT)
    deflections = trial.deflections
    arrived_ns, own_times_s = (
        np.array([getattr(sample, field) for sample in samples]) for field in ("time_ns", "own_time_s")
    )
    # samples that arrived out of order are left out
    is_later = np.concatenate([[True], np.diff(np.maximum.accumulate(arrived_ns)) > 0])
    times_ns, _ = sample_times(arrived_ns[is_later], own_times_s[is_later])
    seismogram = Seismogram(seconds(times_ns - deflections.times_ns[0]), values[is_later], tuple(components))
    try:
        benefit = seismometer_at_rest(deflections.times_s, _without_beam_motion(trial, stated), seismogram)
        ground_seen = drive_at_rest(deflections.times_s, deflections.y).density.value > 0
    except DataError as error:
        return _alive(f"{error}{longer_preflight(deflections)}", kind)
    return _benefit_verdict(benefit, ground_seen, kind)


def _without_beam_motion(trial: TrialFrames, stated: ReferenceSettings | None) -> Floats:
    """The slow deflections minus the beam's motion that the reference spot shows."""
    deflections = trial.deflections
    if stated is None or not trial.references:
        return deflections.y
    spots, references = _positions(trial.spots), _positions(trial.references)
    # deflection per px, fitted to the frames themselves
    is_usable = deflections.found & np.all(np.isfinite(spots), axis=0)
    design = np.column_stack([*spots[:2, is_usable], np.ones(np.count_nonzero(is_usable))])
    per_px = np.linalg.lstsq(design, deflections.y[is_usable], rcond=None)[0]
    beam = np.zeros(len(deflections.y))
    for axis in (0, 1):
        reference_px = references[axis], references[2 + axis]
        gain = stated.gain
        if gain is None:
            fitted = gain_while_swinging(deflections.times_ns, spots[axis], spots[2 + axis], *reference_px)
            gain = fitted.value if fitted.value > _MAX_DEVIATION_SIGMA * fitted.standard_uncertainty else 0.0
        beam += gain * per_px[axis] * common_motion(deflections.times_ns, *reference_px).value
    return np.asarray(deflections.y - beam)


def _alive(reason: str, kind: str) -> Verdict:
    return Verdict("seismometer", True, reason, measured=f"{kind}, alive", limit=_LIMIT, made=False)


def _benefit_verdict(benefit: SeismometerAtRest, ground_seen: bool, kind: str) -> Verdict:
    coherence = f"squared coherence {plain(benefit.coherence, 3)} in {benefit.steps} periods"
    if not benefit.related:
        chance = f"{coherence}; unrelated records reach {plain(benefit.chance_coherence, 2)}"
        if not ground_seen:
            hidden = "the ground does not exceed the noise of the spot, so its benefit is unknown"
            return _alive(f"{hidden} ({chance})", kind)
        reason = f"it does not show what moves the pendulum: {chance}"
        remedy = "check its place, columns and clock; a fit refuses one that explains nothing"
        return Verdict(
            "seismometer", True, reason, remedy, measured=f"{kind}, unrelated so far", limit=_LIMIT
        )
    lower, upper = plain(benefit.lower_95, 2), plain(benefit.upper_95, 2)
    fall = f"the swing at rest would fall by {plain(benefit.factor, 2)} ({lower} to {upper})"
    measured = f"{coherence}: {fall}, the ground's part of it by {lower} at least"
    return Verdict("seismometer", True, measured=measured, limit=_LIMIT)


def reference(trial: TrialFrames, stated: ReferenceSettings | None, limits: PreflightSettings) -> Verdict:
    """Check that the reference spot is seen, and predict how much of the spot's motion it would remove."""
    limit = f"found in {percent(1 - limits.max_lost_fraction, 3)}"
    if stated is None or not trial.references:
        return Verdict("reference", True, measured="none is configured", limit=limit, made=False)
    lost_fraction = float(np.mean([bool(spot.flags & SpotFlag.LOST) for spot in trial.references]))
    measured = f"found in {percent(1 - lost_fraction, 3)} of {len(trial.references)} frames"
    if lost_fraction > limits.max_lost_fraction:
        reason = "frames without it keep the beam's motion"
        remedy = f"let its beam fall below row {stated.from_row_px}"
        return Verdict("reference", True, reason, remedy, measured=measured, limit=limit)
    if not trial.resting:
        return not_at_rest("reference", limit)
    deflections = trial.deflections
    try:
        period_s = rest_oscillation(deflections.times_s, deflections.y).period_s
        spots, references = _positions(trial.spots), _positions(trial.references)
        benefits = {}
        for axis, name in enumerate("xy"):
            positions = spots[axis], spots[2 + axis], references[axis], references[2 + axis]
            benefits[name] = reference_at_rest(
                deflections.times_ns, *positions, gain=stated.gain, period_s=period_s
            )
    except DataError as error:
        reason = f"{error}{longer_preflight(deflections)}"
        return Verdict("reference", True, reason, measured=measured, limit=limit, made=False)
    return _reference_verdict(benefits, stated, measured, limit)


def _reference_verdict(
    benefits: Mapping[str, ReferenceAtRest], stated: ReferenceSettings, measured: str, limit: str
) -> Verdict:
    """The verdict from the benefit along each axis, by the axis's name."""
    texts, deviations, is_useless = [], [], True
    for name, benefit in benefits.items():
        if not benefit.share > 0:
            texts.append(f"{name}: it shows no motion above its own noise")
            continue
        is_useless = is_useless and not benefit.factor.value - 3 * benefit.factor.standard_uncertainty > 1
        texts.append(f"{name}: {plain(benefit.before_px, 2)} px fall by {with_uncertainty(*benefit.factor)}")
        if stated.gain is None:
            continue
        deviation, gain = abs(benefit.gain.value - stated.gain), benefit.gain
        if deviation > _MAX_DEVIATION_SIGMA * np.hypot(gain.standard_uncertainty, stated.u_gain):
            deviations.append(f"{name} shows a gain of {with_uncertainty(*gain)}")
    reason = remedy = ""
    if deviations:
        reason = f"{', '.join(deviations)}, and reference.gain = {stated.gain:g} is stated"
        remedy = "state the gain of the two arms, with its u_gain"
    elif is_useless:
        reason = "it does not make the spot at rest quieter, as far as this short record shows"
    measured = f"{measured}; {', '.join(texts)}"
    return Verdict("reference", True, reason, remedy, measured=measured, limit=limit)


def _positions(spots: Sequence[Spot]) -> Floats:
    """Positions x, y and their standard uncertainties in px, (4, n); NaN where the spot is lost."""
    table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4).T
    table[:, [bool(spot.flags & SpotFlag.LOST) for spot in spots]] = np.nan
    return table
