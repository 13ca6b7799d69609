"""What some seconds of frames say before a run: spot, exposure, noise, rest position, rate, clock, disk.

Each check turns plain values into one verdict with reason and remedy.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.frame import Frame
from calibration import Stability, relate_clocks, stability
from processing.arrays import Floats
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.ground_at_rest import ground_at_rest
from processing.spot import Spot, SpotFlag, SpotModel
from processing.ticks import seconds
from rig.analysis import base_motion, drive_text
from rig.devices import MOST_PPM, wrong_rate
from rig.instrument import beam_quality
from rig.presentation import Verdict
from rig.settings import Configuration, PendulumSettings, PreflightSettings

_SPOT_BYTES = 260
_SHORT_S = 50.0
NO_LEVER = "no lever: values in px have no limit in arcsec"


@dataclass(frozen=True, slots=True)
class TrialFrames:
    """Some seconds of frames, with the spots and deflections measured in them.

    `resting` is False if the pendulum may be swinging. `model` is what the tracker has chosen for the beam;
    None while it has not. `references` are the reference's spots, where the frames have one.
    """

    frames: Sequence[Frame]
    spots: Sequence[Spot]
    deflections: Deflections
    resting: bool
    model: SpotModel | None = None
    references: Sequence[Spot] = ()


def spot_found(spots: Sequence[Spot], limits: PreflightSettings) -> Verdict:
    """Check that nearly every frame has a spot."""
    lost = float(np.mean([bool(spot.flags & SpotFlag.LOST) for spot in spots])) if spots else 1.0
    ok = lost <= limits.max_lost_fraction
    return Verdict(
        "spot found",
        ok,
        "" if ok else "no spot in too many frames",
        "" if ok else "laser on? beam on the sensor? raise the exposure (exposure_us)",
        measured=f"{100 * (1 - lost):.1f} % of {len(spots)} frames",
        limit=f"{100 * (1 - limits.max_lost_fraction):g} %",
    )


def exposure(spots: Sequence[Spot], full_scale_dn: float, limits: PreflightSettings) -> Verdict:
    """Check the peak of the spot against the sensor's full scale."""
    peaks = [s.amplitude_dn + s.background_dn for s in spots if not s.flags & SpotFlag.LOST]
    limit = f"{100 * limits.min_peak_fraction:g} to {100 * limits.max_peak_fraction:g} % of full scale"
    if not peaks:
        return Verdict(
            "exposure",
            False,
            "there is nothing to measure",
            "find the spot first",
            measured="no spot",
            limit=limit,
        )
    peak = float(np.median(peaks)) / full_scale_dn
    dark, bright = peak < limits.min_peak_fraction, peak > limits.max_peak_fraction
    reason = "too dark: noisy" if dark else "too bright: saturates" if bright else ""
    remedy = (
        "raise the exposure (exposure_us) or the laser"
        if dark
        else "lower the exposure (exposure_us) or the laser"
        if bright
        else ""
    )
    return Verdict("exposure", not reason, reason, remedy, measured=f"peak {100 * peak:.0f} %", limit=limit)


def saturation(spots: Sequence[Spot], limits: PreflightSettings) -> Verdict:
    """Check how many frames have pixels at full scale."""
    part = float(np.mean([bool(spot.flags & SpotFlag.SATURATED) for spot in spots])) if spots else 0.0
    ok = part <= limits.max_saturated_fraction
    return Verdict(
        "saturation",
        ok,
        "" if ok else "pixels at full scale are lost to the fit",
        "" if ok else "lower the exposure (exposure_us) or the laser's power",
        measured=f"{100 * part:.1f} % of frames",
        limit=f"{100 * limits.max_saturated_fraction:g} %",
    )


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
    words = (
        f"{strongest:.3f} {unit.shown} at {lines[0].frequency_hz:.1f} Hz{named}"
        if lines
        else "none stands out"
    )
    quiet, still = noise <= limits.max_noise_arcsec, strongest <= limits.max_vibration_arcsec
    verdicts = [
        Verdict(
            "noise floor",
            quiet,
            "" if quiet else "the spot is too noisy",
            "" if quiet else "more light, a smaller gain; shield the beam from air",
            measured=f"{noise:.4f} {unit.shown} a frame",
            limit=noise_limit,
        ),
        Verdict(
            "vibration",
            still,
            "" if still else "the base shakes",
            "" if still else "find what runs at this frequency; decouple the table",
            measured=words,
            limit=line_limit,
        ),
    ]
    return [_against_arcsec(verdict, unit) for verdict in verdicts]


def ground(
    look: TrialFrames, pendulum: PendulumSettings | None, limits: PreflightSettings | None = None
) -> Verdict:
    """What the ground does at the pendulum's frequency: it limits results, and forbids a measurement only
    where a limit is stated.

    Needs eight periods at rest, in `preflight.duration_s`.
    """
    at = look.deflections
    most = None if limits is None else limits.max_ground_rad_per_s2_rthz
    limit = "" if most is None else f"{most:g} rad/s²/√Hz"
    if not look.resting:
        return not_at_rest("ground", limit)
    try:
        found = ground_at_rest(at.times_s, at.y)
    except DataError as error:
        reason = f"{error}{longer(at)}"
        if most is None:
            return Verdict("ground", True, reason, measured="not measured", made=False)
        return Verdict(
            "ground", False, str(error), longer(at).removeprefix("; "), measured="not measured", limit=limit
        )
    of_angle = pendulum if at.unit is DeflectionUnit.RAD else None
    base = base_motion(found.density, found.upper_95, found.period_s, of_angle)
    words = drive_text(found.density, found.upper_95, base, seen=found.density.value > 0, unit=at.unit)
    words = f"{words}, in {at.times_s[-1]:.0f} s"
    if most is None:
        return Verdict("ground", True, measured=words)
    quiet = found.density.value <= most
    verdict = Verdict(
        "ground",
        quiet,
        "" if quiet else "it moves too much",
        "" if quiet else "wait for a quieter hour, or allow more",
        measured=words,
        limit=limit,
    )
    return verdict if at.unit is DeflectionUnit.RAD else replace(verdict, ok=True, reason=NO_LEVER, remedy="")


def longer(at: Deflections) -> str:
    """What a longer preflight would give; empty where it was long."""
    return "; preflight.duration_s = 60 would measure it" if at.times_s[-1] < _SHORT_S else ""


def rest_position(look: TrialFrames, limits: PreflightSettings) -> Verdict:
    """Check the rest position against the reference of the lever (without one, the sensor's centre)."""
    limit = f"{limits.max_rest_offset_arcsec:g} arcsec"
    at = look.deflections
    if not look.resting:
        return not_at_rest("rest position", limit)
    if not at.found.any():
        return Verdict(
            "rest position",
            False,
            "nothing to measure",
            "find the spot first",
            measured="no spot",
            limit=limit,
        )
    x, y = np.nanmedian(at.shown_x), np.nanmedian(at.shown_y)
    ok = math.hypot(x, y) <= limits.max_rest_offset_arcsec
    verdict = Verdict(
        "rest position",
        ok,
        "" if ok else "the swing will not be centred on the sensor",
        "" if ok else "rig balance says which weight to turn; or move the camera",
        measured=f"X {x:+.1f}, Y {y:+.1f} {at.unit.shown}",
        limit=limit,
    )
    return _against_arcsec(verdict, at.unit)


def clock(frames: Sequence[Frame], limits: PreflightSettings, *, on_demand: bool = False) -> Verdict:
    """Check the jitter of the frame times, and the rate of the camera's clock against the host's.

    The clock of frames that are made on demand has no rate in real time.
    """
    limit = f"jitter {limits.max_clock_jitter_us:g} us, rate {MOST_PPM:g} ppm"
    if frames and frames[0].device_time_ns < 0:
        return Verdict("clock", True, measured="the camera has none; the host's is used", limit=limit)
    try:
        relation = relate_clocks(
            np.array([frame.device_time_ns for frame in frames]),
            np.array([frame.host_time_ns for frame in frames]),
            np.array([frame.sequence for frame in frames]),
        )
    except DataError as error:
        return Verdict("clock", False, str(error), "restart the camera", measured="not measured", limit=limit)
    rate = f"{relation.drift_ppm:+.0f} ± {relation.u_drift_ppm:.0f} ppm"
    if on_demand:
        rate = "no rate: made on demand"
    elif wrong := wrong_rate(relation):
        return Verdict(
            "clock",
            False,
            wrong,
            "the driver misreads its unit, or the computer's clock was set: see rig doctor",
            measured=rate,
            limit=limit,
        )
    jitter_us = relation.frame_jitter_s * 1e6
    ok = jitter_us <= limits.max_clock_jitter_us
    if ok and not on_demand and 3.0 * relation.u_drift_ppm > MOST_PPM:
        return Verdict(
            "clock",
            True,
            "unknown: these frames came too irregularly, or too few of them, to tell the clock's rate",
            measured=f"jitter {jitter_us:.1f} us, rate unknown ({rate})",
            limit=limit,
            made=False,
        )
    return Verdict(
        "clock",
        ok,
        "" if ok else "frames come unevenly; turning times suffer",
        "" if ok else "a fixed frame_rate_hz, the camera's own clock, no free-running trigger",
        measured=f"jitter {jitter_us:.1f} us, {rate}",
        limit=limit,
    )


def frame_rate(frames: Sequence[Frame], asked_hz: float | None, limits: PreflightSettings) -> Verdict:
    """Check the measured frame rate against the requested one, and the losses."""
    limit = f"{100 * limits.max_frame_rate_error:g} %, losses {100 * limits.max_dropped_fraction:g} %"
    span_s = seconds(frames[-1].time_ns - frames[0].time_ns) if len(frames) > 1 else 0.0
    if span_s <= 0:
        return Verdict(
            "frame rate",
            False,
            "the camera hardly delivers",
            "see the camera",
            measured="too few frames",
            limit=limit,
        )
    numbers = frames[-1].sequence - frames[0].sequence
    rate_hz = numbers / span_s
    lost = 1.0 - (len(frames) - 1) / numbers
    wrong = asked_hz is not None and abs(rate_hz / asked_hz - 1.0) > limits.max_frame_rate_error
    lossy = lost > limits.max_dropped_fraction
    return Verdict(
        "frame rate",
        not (wrong or lossy),
        f"{asked_hz:g} Hz was requested" if wrong else "frames are being lost" if lossy else "",
        "exposure too long, or the bus too slow" if wrong else "another port or cable" if lossy else "",
        measured=f"{rate_hz:.2f} Hz, {100 * lost:.2f} % lost",
        limit=limit,
    )


def disk(
    free_bytes: int, bytes_per_frame: float, rate_hz: float, duration_s: float, *, windows: bool = True
) -> Verdict:
    """Check the free space for the longest run allowed; `windows`: raw pixels are recorded too."""
    need = bytes_per_frame * rate_hz * duration_s
    ok = free_bytes >= need
    return Verdict(
        "disk space",
        ok,
        "" if ok else "a run of full length does not fit",
        "" if ok else f"free space, or another -o{', or record.windows = false' if windows else ''}",
        measured=f"{_room(free_bytes)} free",
        limit=f"{_room(need)} for {duration_s:g} s",
    )


def _room(size_bytes: float) -> str:
    """In GB, or, where that would be next to nothing, in MB."""
    return f"{size_bytes / 1e9:.1f} GB" if size_bytes >= 1e9 else f"{size_bytes / 1e6:.1f} MB"


def check_look(
    look: TrialFrames, config: Configuration, full_scale_dn: float, window_bytes: float, free_bytes: int
) -> list[Verdict]:
    """All checks that are made from some seconds of frames."""
    limits, at = config.preflight, look.deflections
    span_s = max(float(at.times_s[-1]), 1e-9) if len(at) else 1.0
    rate_hz = len(look.frames) / span_s
    bytes_per_frame = _SPOT_BYTES + (window_bytes if config.record.windows else 0.0)
    bytes_per_frame += look.frames[0].image.nbytes / (config.record.full_frame_interval_s * rate_hz)
    return [
        spot_found(look.spots, limits),
        exposure(look.spots, full_scale_dn, limits),
        saturation(look.spots, limits),
        beam_quality(
            [frame.image for frame in look.frames],
            look.spots,
            look.model,
            full_scale_dn,
            limits,
            noise_is_known=config.sensor is not None,
        ),
        *stillness(look, limits),
        rest_position(look, limits),
        ground(look, config.pendulum, limits),
        frame_rate(look.frames, config.camera.frame_rate_hz, limits),
        clock(look.frames, limits, on_demand=config.on_demand),
        disk(
            free_bytes,
            bytes_per_frame,
            rate_hz,
            config.session.max_duration_s,
            windows=config.record.windows,
        ),
    ]


def stillness(look: TrialFrames, limits: PreflightSettings) -> list[Verdict]:
    """Check noise and vibration of the spot of a pendulum at rest; one that may swing has neither."""
    at = look.deflections
    if not look.resting:
        names = ("noise floor", limits.max_noise_arcsec), ("vibration", limits.max_vibration_arcsec)
        return [not_at_rest(name, f"{limit:g} arcsec") for name, limit in names]
    return noise_and_vibration(
        _still(at.times_s, at.x, at.u_x), _still(at.times_s, at.y, at.u_y), at.unit, limits
    )


def _too_few_spots(name: str, limit: str) -> Verdict:
    return Verdict(
        name,
        False,
        "too few frames with a spot to judge by",
        "raise preflight.duration_s; find the spot",
        measured="not measured",
        limit=limit,
    )


def not_at_rest(name: str, limit: str) -> Verdict:
    """Of a check that needs the pendulum at rest, where it may be swinging."""
    reason = "the pendulum may be swinging (start.way = 'at once')"
    return Verdict(name, True, reason, measured="not measured", limit=limit, made=False)


def _against_arcsec(verdict: Verdict, unit: DeflectionUnit) -> Verdict:
    """The verdict on a limit in arcsec; marked as not made if the value is in px."""
    if unit is DeflectionUnit.RAD:
        return verdict
    return replace(verdict, ok=True, reason=NO_LEVER, remedy="", made=False)


def _still(times_s: Floats, values: Floats, u: Floats) -> Stability | None:
    try:
        return stability(times_s, values, u)
    except DataError:
        return None
