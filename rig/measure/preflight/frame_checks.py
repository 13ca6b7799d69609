"""Preflight checks of spot, exposure, frame rate, clock, disk, air, controller, laser, shutter and camera.

Each check turns plain values into one verdict with reason and remedy.
"""

import math
from collections.abc import Sequence

import numpy as np

from acquisition.camera import Frame, ShutterKind
from acquisition.frames.guard import MAX_DRIFT_PPM
from calibration import Axes, Shutter, relate_clocks
from processing.errors import DataError
from processing.spot import FixedLight, Spot, SpotFlag, fixed_light
from processing.units import seconds
from rig.control import LaserReport, SafetyNow
from rig.devices import STAYS_LIT, WIRING_REMEDY, impossible_rate_text
from rig.instrument import beam_quality
from rig.measure.preflight.rest_checks import (
    TrialFrames,
    ground,
    judged,
    plane_of_swing,
    rest_position,
    stillness,
)
from rig.settings import Configuration, PreflightSettings
from rig.terminal import Verdict, with_uncertainty

_RECORDED_SPOT_BYTES = 260
"""Size of the numbers of one frame in the record."""
_LIGHT_FRAMES = 48
"""Number of frames that are searched for light that does not move."""


def spot_found(spots: Sequence[Spot], limits: PreflightSettings) -> Verdict:
    """Check that nearly every frame has a spot."""
    lost = _flagged_fraction(SpotFlag.LOST, spots, empty=1.0)
    fault = "no spot in too many frames", "laser on? beam on the sensor? raise the exposure (exposure_us)"
    measured = f"{100 * (1 - lost):.1f} % of {len(spots)} frames"
    limit = f"{100 * (1 - limits.max_lost_fraction):g} %"
    return judged("spot found", lost <= limits.max_lost_fraction, fault, measured, limit)


def _flagged_fraction(flag: SpotFlag, spots: Sequence[Spot], empty: float) -> float:
    return float(np.mean([bool(spot.flags & flag) for spot in spots])) if spots else empty


def exposure(spots: Sequence[Spot], full_scale_dn: float, limits: PreflightSettings) -> Verdict:
    """Check the peak of the spot against the sensor's full scale."""
    peaks = [spot.amplitude_dn + spot.background_dn for spot in spots if not spot.flags & SpotFlag.LOST]
    low, high = limits.min_peak_fraction, limits.max_peak_fraction
    limit = f"{100 * low:g} to {100 * high:g} % of full scale"
    if not peaks:
        return judged(
            "exposure", False, ("there is nothing to measure", "find the spot first"), "no spot", limit
        )
    peak = float(np.median(peaks)) / full_scale_dn
    fault = "too dark: noisy", "raise the exposure (exposure_us) or the laser"
    if peak > high:
        fault = "too bright: saturates", "lower the exposure (exposure_us) or the laser"
    return judged("exposure", low <= peak <= high, fault, f"peak {100 * peak:.0f} %", limit)


def saturation(spots: Sequence[Spot], limits: PreflightSettings) -> Verdict:
    """Check how many frames have pixels at full scale."""
    fraction, limit = _flagged_fraction(SpotFlag.SATURATED, spots, empty=0.0), limits.max_saturated_fraction
    fault = (
        "pixels at full scale are lost to the fit",
        "lower the exposure (exposure_us) or the laser's power",
    )
    measured = f"{100 * fraction:.1f} % of frames"
    return judged("saturation", fraction <= limit, fault, measured, f"{100 * limit:g} %")


def clock(frames: Sequence[Frame], limits: PreflightSettings, *, on_demand: bool = False) -> Verdict:
    """Check the jitter of the frame times, and the rate of the camera's clock against the host's.

    With frames made `on_demand` the rate has no meaning and is not checked.
    """
    limit = f"jitter {limits.max_clock_jitter_us:g} µs, rate {MAX_DRIFT_PPM:g} ppm"
    if frames and frames[0].device_time_ns < 0:
        return Verdict("clock", True, measured="the camera has none; the host's is used", limit=limit)
    try:
        relation = relate_clocks(
            np.array([frame.device_time_ns for frame in frames]),
            np.array([frame.host_time_ns for frame in frames]),
            np.array([frame.sequence for frame in frames]),
        )
    except DataError as error:
        return judged("clock", False, (str(error), "restart the camera"), "not measured", limit)
    rate = f"{relation.drift_ppm:+.0f} ± {relation.u_drift_ppm:.0f} ppm"
    if on_demand:
        rate = "no rate: made on demand"
    elif reason := impossible_rate_text(relation):
        remedy = "the driver misreads its unit, or the computer's clock was set: see rig doctor"
        return judged("clock", False, (reason, remedy), rate, limit)
    jitter_us = relation.frame_jitter_s * 1e6
    ok = jitter_us <= limits.max_clock_jitter_us
    if ok and not on_demand and 3.0 * relation.u_drift_ppm > MAX_DRIFT_PPM:
        reason = "unknown: these frames came too irregularly, or too few of them, to tell the clock's rate"
        measured = f"jitter {jitter_us:.1f} µs, rate unknown ({rate})"
        return Verdict("clock", True, reason, measured=measured, limit=limit, made=False)
    remedy = "set frame_rate_hz, use the camera's clock, no free-running trigger"
    fault = "frames come unevenly; turning times suffer", remedy
    return judged("clock", ok, fault, f"jitter {jitter_us:.1f} µs, {rate}", limit)


def frame_rate(frames: Sequence[Frame], requested_hz: float | None, limits: PreflightSettings) -> Verdict:
    """Check the measured frame rate against that requested, and the losses."""
    limit = f"rate {100 * limits.max_frame_rate_error:g} %, losses {100 * limits.max_dropped_fraction:g} %"
    span_s = seconds(frames[-1].time_ns - frames[0].time_ns) if len(frames) > 1 else 0.0
    if span_s <= 0:
        fault = "hardly a frame arrives", "check cable and trigger"
        return judged("frame rate", False, fault, "too few frames", limit)
    intervals = frames[-1].sequence - frames[0].sequence
    rate_hz = intervals / span_s
    lost_fraction = 1.0 - (len(frames) - 1) / intervals
    ok = lost_fraction <= limits.max_dropped_fraction
    fault = "frames are being lost", "close other programs; use another port or cable"
    if requested_hz is not None and abs(rate_hz / requested_hz - 1.0) > limits.max_frame_rate_error:
        ok = False
        fault = f"{requested_hz:g} Hz was requested", "exposure too long, or the bus too slow"
    return judged("frame rate", ok, fault, f"{rate_hz:.2f} Hz, {100 * lost_fraction:.2f} % lost", limit)


def disk(
    free_bytes: int, bytes_per_frame: float, rate_hz: float, duration_s: float, *, windows: bool = True
) -> Verdict:
    """Check the free space for the longest run allowed; with `windows` raw pixels are recorded, too."""
    needed_bytes = bytes_per_frame * rate_hz * duration_s
    remedy = f"free space, or another -o{', or record.windows = false' if windows else ''}"
    fault = "a run of full length does not fit", remedy
    limit = f"{_size_text(needed_bytes)} for {duration_s:g} s"
    return judged("disk space", free_bytes >= needed_bytes, fault, f"{_size_text(free_bytes)} free", limit)


def _size_text(size_bytes: float) -> str:
    return f"{size_bytes / 1e9:.1f} GB" if size_bytes >= 1e9 else f"{size_bytes / 1e6:.1f} MB"


def _fixed_light(trial: TrialFrames) -> FixedLight | None:
    pairs = list(zip(trial.frames, trial.spots[-len(trial.frames) :], strict=True))
    return fixed_light([(frame.image, spot) for frame, spot in pairs[:: max(1, len(pairs) // _LIGHT_FRAMES)]])


def check_trial_frames(
    trial: TrialFrames, config: Configuration, full_scale_dn: float, window_bytes: float, free_bytes: int
) -> list[Verdict]:
    """All checks of some seconds of frames; `window_bytes` is the size of the window kept of each frame."""
    limits, deflections = config.preflight, trial.deflections
    span_s = max(float(deflections.times_s[-1]), 1e-9) if len(deflections) else 1.0
    # memory may hold fewer whole frames than there are deflections
    rate_hz, max_duration_s = len(deflections) / span_s, config.session.max_duration_s
    bytes_per_frame = _RECORDED_SPOT_BYTES + (window_bytes if config.record.windows else 0.0)
    bytes_per_frame += trial.frames[0].image.nbytes / (config.record.full_frame_interval_s * rate_hz)
    return [
        spot_found(trial.spots, limits),
        exposure(trial.spots, full_scale_dn, limits),
        saturation(trial.spots, limits),
        beam_quality(
            [frame.image for frame in trial.frames],
            trial.spots,
            trial.model,
            full_scale_dn,
            limits,
            noise_is_known=config.sensor is not None,
            light=None if trial.resting else _fixed_light(trial),
        ),
        *stillness(trial, limits),
        rest_position(trial, limits),
        *plane_of_swing(trial, config.balance),
        ground(trial, limits),
        frame_rate(trial.frames, config.camera.frame_rate_hz, limits),
        clock(trial.frames, limits, on_demand=config.on_demand),
        disk(free_bytes, bytes_per_frame, rate_hz, max_duration_s, windows=config.record.windows),
    ]


_ANY_HUMIDITY_PERCENT = (0.0, 100.0)
_MAX_COS_TO_ROW_NORMAL = 0.1
"""Largest |cos(slow_angle_rad)| for which the slow axis is taken to lie along the rows."""


def air(
    environment: tuple[float, float, float],
    configured: bool,
    limits: PreflightSettings,
    *,
    optional: bool = False,
) -> Verdict:
    """Check temperature and humidity, if a sensor is `configured`; `environment` is (°C, %, Pa).

    The controller's own sensor is `optional`: it need not exist.
    """
    temperature_c, humidity_percent, pressure_pa = environment
    limit = f"{limits.min_temperature_c:g} to {limits.max_temperature_c:g} °C"
    min_percent, max_percent = limits.min_humidity_percent, limits.max_humidity_percent
    needs_humidity = (min_percent, max_percent) != _ANY_HUMIDITY_PERCENT
    if needs_humidity:
        limit += f", {min_percent:g} to {max_percent:g} %"
    if not configured:
        return Verdict("environment", True, measured="no sensor is configured", limit=limit, made=False)
    if math.isnan(temperature_c) and optional and not needs_humidity:
        reason = "the controller has no sensor, or no reading"
        remedy = "plug a BME280 in, or state [environment]"
        return Verdict("environment", True, reason, remedy, measured="no reading", limit=limit)
    if math.isnan(temperature_c):
        return judged("environment", False, ("the sensor is silent", "see rig doctor"), "no reading", limit)
    measured = f"{temperature_c:.1f} °C, {humidity_percent:.0f} %, {pressure_pa / 100:.0f} hPa"
    if needs_humidity and math.isnan(humidity_percent):
        fault = "it does not report humidity", "use one that does, or no humidity limits"
        return judged("environment", False, fault, measured, limit)
    ok = limits.min_temperature_c <= temperature_c <= limits.max_temperature_c
    ok = ok and (not needs_humidity or min_percent <= humidity_percent <= max_percent)
    return judged("environment", ok, ("out of range", "wait, or widen the limits"), measured, limit)


def controller(safety: SafetyNow, configured: bool) -> Verdict:
    """Check that the controller, if one is `configured`, answers and its interlock is closed."""
    if not configured:
        return Verdict("controller", True, measured="none is configured", limit="answers", made=False)
    fault = "it does not answer, or its interlock is open", "see rig doctor; close the cover"
    ok = safety.controller_interlock_closed
    return judged("controller", ok, fault, safety.devices_text, "answers, interlock closed")


def laser(report: LaserReport | None, goes_dark_by_itself: bool) -> Verdict:
    """Check that the laser is on; warns if only this program can switch it off."""
    if report is None:
        return Verdict("laser", True, measured="none is configured", limit="lit", made=False)
    if report.on and not goes_dark_by_itself:
        return Verdict("laser", True, STAYS_LIT, WIRING_REMEDY, measured=report.text, limit="lit")
    fault = "there is no light for the measurement", "run rig doctor; close the interlock, turn its key"
    return judged("laser", report.on, fault, report.text, "lit")


def shutter(
    stated_kind: str, calibrated: Shutter | None, axes: Axes | None, *, pulsed: bool = False
) -> Verdict:
    """Check that the row time of a rolling shutter is known where the spot swings across the rows.

    `stated_kind` is the camera's name of its shutter. Without `axes` the slow axis is assumed to lie along
    the columns. A `pulsed` laser lights all rows at the same time.
    """
    limit = "global, or its row time known"
    kind = ShutterKind.of(stated_kind)
    if kind is not ShutterKind.ROLLING:
        measured = stated_kind.lower() or "the camera does not say which"
        return Verdict("shutter", True, measured=measured, limit=limit, made=kind is not ShutterKind.UNKNOWN)
    if pulsed:
        return Verdict("shutter", True, measured="rolling, all rows see the laser's pulse", limit=limit)
    if calibrated is not None:
        row_us = with_uncertainty(1e6 * calibrated.row_time_s, 1e6 * calibrated.u_row_time_s)
        return Verdict("shutter", True, measured=f"rolling, {row_us} µs a row", limit=limit)
    if axes is not None and abs(math.cos(axes.slow_angle_rad)) < _MAX_COS_TO_ROW_NORMAL:
        return Verdict("shutter", True, measured="rolling, the slow axis lies along the rows", limit=limit)
    reason = "each row is exposed at its own time: half-periods differ, [shutter] does not say by how much"
    remedy = "turn the camera so that the slow axis lies along the rows, or set a global reset, "
    remedy += "or rig calibrate shutter"
    return Verdict("shutter", True, reason, remedy, measured="rolling, row time unknown", limit=limit)


def camera(driver: str, notes: Sequence[str]) -> Verdict:
    """Check that the camera accepted the requested settings."""
    fault = "; ".join(notes), "request only what the camera supports"
    return judged("camera", not notes, fault, driver, "settings as requested")
