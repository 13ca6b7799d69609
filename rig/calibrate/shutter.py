"""`rig calibrate shutter`: the row time of a rolling shutter, from a run."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import ShutterKind
from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import RecordedCamera
from calibration import PulsedShutterFit, ShutterFit, fit_row_time, fit_row_time_of_pulses
from processing.errors import DataError
from processing.ticks import seconds
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.spots import whole_spots
from rig.instrument import frame_shape, recorded_configuration
from rig.presentation import percent
from rig.settings import Configuration

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
