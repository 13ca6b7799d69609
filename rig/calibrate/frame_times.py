"""`rig calibrate clock` and `shutter`: the camera's clock against the host's; the row time of a shutter."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import ShutterKind
from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import RecordedCamera
from calibration import (
    FRAME_JITTER_LIMIT_S,
    ClockRelation,
    PulsedShutterFit,
    ShutterFit,
    fit_row_time,
    fit_row_time_of_pulses,
    relate_clocks,
    unwrap_counter,
)
from processing.errors import DataError
from processing.robust import robust_scatter
from processing.units import S_PER_NS, seconds
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.spots import whole_spots
from rig.devices import U_QUARTZ, ntp_state
from rig.instrument import frame_shape, recorded_configuration
from rig.presentation import percent
from rig.settings import Configuration

_PARTS = 24
_FEWEST_IN_PART = 10
_OF_MEDIAN = math.sqrt(math.pi / 2.0)
"""Standard uncertainty of a median over that of a mean, of normal deviates."""
_ROUNDING_S = S_PER_NS / math.sqrt(12.0)


def calibrate_clock(record: Path, filing: Filing, counter_bits: int | None) -> Path:
    """Camera clock against the host's monotonic clock."""
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        if config.simulated and config.on_demand:
            raise DataError(
                f"{record}: its frames were made on demand; simulation.real_time = true paces them"
            )
        if RecordedCamera.of(reader.metadata).has_clock is False:
            raise DataError(f"{record}: its camera has no clock of its own to compare")
        table = reader.spots()
        began = reader.utc(int(table["time_ns"][0]) if len(table) else 0)
    device = table["device_time_ns"].astype(np.int64)
    if counter_bits is not None:
        device = unwrap_counter(device, counter_bits)
    relation = relate_clocks(
        device, table["host_time_ns"].astype(np.int64), table["sequence"].astype(np.int64)
    )
    ntp = ntp_state()
    notes = [f"clock jump of {jump.step_s:.3g} s at frame {jump.frame}" for jump in relation.jumps]
    if relation.frame_jitter_s > FRAME_JITTER_LIMIT_S:
        notes.append(
            f"frame times jitter by {relation.frame_jitter_s * 1e6:.3g} µs, swings need "
            f"{FRAME_JITTER_LIMIT_S * 1e6:g} µs"
        )
    if not ntp.synchronised:
        notes.append(f"the host's clock is not known to be synchronised with UTC ({ntp.text})")
    values = {
        "camera_rate": relation.rate,
        "u_camera_rate": u_camera_rate(relation, ntp.u_rate),
    }
    details = {
        "drift_ppm": relation.drift_ppm,
        "u_drift_ppm": relation.u_drift_ppm,
        **details_of(relation, "rate", "u_rate", "device_reference_ns", "host_reference_ns"),
        **off_line(relation, device, table["host_time_ns"].astype(np.int64), table["sequence"]),
    }
    details["frame_jitter_limit_s"] = FRAME_JITTER_LIMIT_S
    details["ntp"] = ntp.text
    details["ntp_synchronised"] = ntp.synchronised
    return file_calibration(
        "clock", filing, "camera against host, robust line", values, details, [record], notes, began
    )


def u_camera_rate(relation: ClockRelation, u_host_rate: float) -> float:
    """Relative standard uncertainty of the camera's rate at other times than the record's."""
    return math.hypot(relation.u_rate, u_host_rate, U_QUARTZ)


def off_line(
    relation: ClockRelation,
    device_ns: NDArray[np.int64],
    host_ns: NDArray[np.int64],
    sequence: NDArray[np.integer],
) -> dict[str, list[float]]:
    """Arrivals minus the line and its jumps: medians over equal parts of the record.

    Medians, because single frames arrive much later than the others.
    """
    off_s = seconds((host_ns - relation.host_ns(device_ns)).astype(np.float64))
    for jump in relation.jumps:
        off_s[sequence >= jump.frame] -= jump.step_s
    at_s = seconds(device_ns - device_ns[0])
    count = max(1, min(_PARTS, len(off_s) // _FEWEST_IN_PART))
    rows = []
    for at, off in zip(np.array_split(at_s, count), np.array_split(off_s, count), strict=True):
        u_s = _OF_MEDIAN * robust_scatter(off) / math.sqrt(len(off))
        rows.append((float(at.mean()), float(np.median(off)), max(u_s, _ROUNDING_S)))
    return dict(
        zip(("parts_at_s", "off_line_s", "u_off_line_s"), map(list, zip(*rows, strict=True)), strict=True)
    )


_SHORTEST_ROW_S = 0.5e-6
"""Sensors with a rolling shutter read a row in a microsecond and more."""
_SIGNIFICANT = 4.0
"""Standard uncertainties of a row time: noise alone makes a global shutter roll once in 16,000 runs."""


def calibrate_shutter(record: Path, filing: Filing) -> Path:
    """Row time and first row, from a run in which the spot swings across the rows.

    They come from the brightness of the spot in a run with a pulsed laser, otherwise from its times.
    """
    spots, began = whole_spots(record)
    # the times of the frames, whatever shutter the record was corrected for
    has_clock = spots["device_time_ns"] >= 0
    frame_times_ns = np.where(has_clock, spots["device_time_ns"], spots["host_time_ns"])
    times_s, y_px = seconds(frame_times_ns - frame_times_ns[0]), spots["y_px"].astype(np.float64)
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        stated = reader.metadata.get("camera_settings", {}).get("exposure_us", "")
        rows = frame_shape(reader)[0]
        is_global = RecordedCamera.of(reader.metadata).shutter is ShutterKind.GLOBAL
    found: ShutterFit | PulsedShutterFit
    if config.laser.pulse_us:
        found, method = (
            _of_pulses(record, spots, times_s, rows, stated, config),
            "brightness of a pulsed spot",
        )
        notes = [f"at one end of its path the spot was darker by {percent(found.ramp, 3)}"]
        rolls = True
    else:
        found, method = fit_row_time(times_s, y_px), "second harmonic of a swing across the rows"
        row_time_s = abs(found.row_time_s)
        # a camera's word is taken where the swing says nearly the same, not against the swing
        is_global = is_global and row_time_s < _SHORTEST_ROW_S
        rolls = row_time_s > _SIGNIFICANT * found.u_row_time_s and not is_global
        if rolls:
            notes = [_of_harmonic(found)]
        elif is_global:
            notes = ["the camera reports a global shutter: the fitted value is not a row time"]
        else:
            notes = ["all rows are exposed at once, as far as this run can tell (a global shutter)"]
    values = {
        "row_time_s": abs(found.row_time_s) if rolls else 0.0,
        "u_row_time_s": found.u_row_time_s,
        "first_row": "bottom" if rolls and found.row_time_s < 0 else "top",
    }
    if found.u_row_time_s > 0.03 * abs(found.row_time_s) and rolls:
        notes.append("uncertain by more than 3 %: a longer run with a larger swing would be better")
    return file_calibration(
        "shutter",
        filing,
        method,
        values,
        {"fitted_row_time_s": found.row_time_s, **details_of(found, "row_time_s", "u_row_time_s")},
        [record],
        notes,
        began,
    )


def _of_harmonic(found: ShutterFit) -> str:
    return (
        f"half-periods differed by {4e3 * abs(found.row_time_s) * found.amplitude_px:.3g} ms at "
        f"{found.amplitude_px:.4g} px; with the slow axis along the rows they would not"
    )


def _of_pulses(
    record: Path,
    spots: NDArray[Any],
    times_s: NDArray[np.float64],
    rows: int,
    exposure_us: str,
    config: Configuration,
) -> PulsedShutterFit:
    if not exposure_us:
        raise DataError(f"{record}: does not say how long its frames were exposed; the pulses cannot be used")
    return fit_row_time_of_pulses(
        times_s,
        spots["y_px"].astype(np.float64),
        spots["amplitude_dn"] * spots["sigma_x_px"] * spots["sigma_y_px"],
        rows,
        1e-6 * float(exposure_us),
        1e-6 * config.laser.pulse_us,
        1e-6 * config.laser.pulse_delay_us,
    )
