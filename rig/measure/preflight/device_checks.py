"""What controller, laser, camera and air say of themselves before a run, as verdicts."""

import math
from collections.abc import Sequence

from acquisition.camera import ShutterKind
from calibration import Axes, Shutter
from rig.control import DevicesNow, LaserNow
from rig.devices import STAYS_LIT, WIRE_IT
from rig.presentation import Verdict, with_uncertainty
from rig.settings import PreflightSettings

_ANY_HUMIDITY = (0.0, 100.0)
_ALONG_ROWS = 0.1
"""Part of the slow swing that may go across the rows of a sensor whose slow axis lies along them."""


def air(
    environment: tuple[float, float, float],
    expected: bool,
    limits: PreflightSettings,
    *,
    optional: bool = False,
) -> Verdict:
    """Check temperature and humidity, if a sensor is configured; the controller's own is `optional`."""
    temperature_c, humidity_percent, pressure_pa = environment
    limit = f"{limits.min_temperature_c:g} to {limits.max_temperature_c:g} °C"
    damp = limits.min_humidity_percent, limits.max_humidity_percent
    asks_humidity = damp != _ANY_HUMIDITY
    if asks_humidity:
        limit += f", {damp[0]:g} to {damp[1]:g} %"
    if not expected:
        return Verdict("environment", True, measured="no sensor is configured", limit=limit, made=False)
    if math.isnan(temperature_c) and optional and not asks_humidity:
        reason, remedy = (
            "the controller has none, or it is silent",
            "plug a BME280 in, or state [environment]",
        )
        return Verdict("environment", True, reason, remedy, measured="no reading", limit=limit)
    if math.isnan(temperature_c):
        return Verdict(
            "environment", False, "the sensor is silent", "see rig doctor", measured="no reading", limit=limit
        )
    words = f"{temperature_c:.1f} °C, {humidity_percent:.0f} %, {pressure_pa / 100:.0f} hPa"
    if asks_humidity and math.isnan(humidity_percent):
        reason, remedy = "it does not report humidity", "a sensor that does, or no limits of it"
        return Verdict("environment", False, reason, remedy, measured=words, limit=limit)
    ok = limits.min_temperature_c <= temperature_c <= limits.max_temperature_c
    ok = ok and (not asks_humidity or damp[0] <= humidity_percent <= damp[1])
    return Verdict(
        "environment",
        ok,
        "" if ok else "out of range",
        "" if ok else "wait, or widen",
        measured=words,
        limit=limit,
    )


def controller(now: DevicesNow, wanted: bool) -> Verdict:
    """Check that the controller answers and its interlock is closed."""
    if not wanted:
        return Verdict("controller", True, measured="none is configured", limit="answers", made=False)
    ok = now.interlock_closed
    return Verdict(
        "controller",
        ok,
        "" if ok else "it does not answer, or its interlock is open",
        "" if ok else "see rig doctor; close the cover",
        measured=now.text,
        limit="answers, interlock closed",
    )


def laser(now: LaserNow | None, goes_dark_by_itself: bool) -> Verdict:
    """Check that the laser is on; warns if only this program can switch it off."""
    if now is None:
        return Verdict("laser", True, measured="none is configured", limit="lit", made=False)
    if not now.on:
        remedy = "run rig doctor; close the interlock, turn its key"
        return Verdict(
            "laser", False, "there is no light for the measurement", remedy, measured=now.text, limit="lit"
        )
    if goes_dark_by_itself:
        return Verdict("laser", True, measured=now.text, limit="lit")
    return Verdict("laser", True, STAYS_LIT, WIRE_IT, measured=now.text, limit="lit")


def shutter(word: str, known: Shutter | None, axes: Axes | None, *, pulsed: bool = False) -> Verdict:
    """Check that the row time of a rolling shutter is known where the spot swings across the rows.

    `word` is the camera's own for its shutter. Without `axes` the slow axis is taken along the columns. A
    `pulsed` laser lights all rows at one time.
    """
    limit = "global, or its row time known"
    kind = ShutterKind.of(word)
    if kind is not ShutterKind.ROLLING:
        words = word.lower() or "the camera does not say which"
        return Verdict("shutter", True, measured=words, limit=limit, made=kind is not ShutterKind.UNKNOWN)
    if pulsed:
        return Verdict("shutter", True, measured="rolling, all rows see the laser's pulse", limit=limit)
    across = abs(math.cos(0.0 if axes is None else axes.slow_angle_rad))
    if known is not None:
        row_us = with_uncertainty(1e6 * known.row_time_s, 1e6 * known.u_row_time_s)
        return Verdict("shutter", True, measured=f"rolling, {row_us} µs a row", limit=limit)
    if across < _ALONG_ROWS:
        return Verdict("shutter", True, measured="rolling, the slow axis lies along the rows", limit=limit)
    return Verdict(
        "shutter",
        True,
        "each row is exposed at its own time: half-periods differ, [shutter] does not say by how much",
        "turn the camera so that the slow axis lies along the rows, or set a global reset, or rig calibrate "
        "shutter",
        measured="rolling, row time unknown",
        limit=limit,
    )


def camera(driver: str, notes: Sequence[str]) -> Verdict:
    """Check that the camera accepted the requested settings."""
    return Verdict(
        "camera",
        not notes,
        "; ".join(notes),
        "request only what the camera supports" if notes else "",
        measured=driver,
        limit="settings as requested",
    )
