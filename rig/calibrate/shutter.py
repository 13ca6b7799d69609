"""`rig calibrate shutter`: the row time of a rolling shutter, from the second harmonic of a run."""

from pathlib import Path

import numpy as np

from calibration import fit_row_time
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.spots import whole_spots

_SIGNIFICANT = 4.0


def calibrate_shutter(record: Path, filing: Filing) -> Path:
    """Row time and first row, from a run in which the spot swings across the rows."""
    spots, began = whole_spots(record)
    # the times of the frames, whatever shutter the record was corrected for
    has_clock = spots["device_time_ns"] >= 0
    frame_times_ns = np.where(has_clock, spots["device_time_ns"], spots["host_time_ns"])
    found = fit_row_time((frame_times_ns - frame_times_ns[0]) * 1e-9, spots["y_px"].astype(np.float64))
    rolls = abs(found.row_time_s) > _SIGNIFICANT * found.u_row_time_s
    values = {
        "row_time_s": abs(found.row_time_s) if rolls else 0.0,
        "u_row_time_s": found.u_row_time_s,
        "first_row": "bottom" if rolls and found.row_time_s < 0 else "top",
    }
    notes = []
    if rolls:
        notes.append(
            f"half-periods differed by {4e3 * abs(found.row_time_s) * found.amplitude_px:.3g} ms at "
            f"{found.amplitude_px:.4g} px; with the slow axis along the rows they would not"
        )
    else:
        notes.append("all rows are exposed at once, as far as this run can tell (a global shutter)")
    if found.u_row_time_s > 0.03 * abs(found.row_time_s) and rolls:
        notes.append("uncertain by more than 3 %: a longer run with a larger swing would be better")
    return file_calibration(
        "shutter",
        filing,
        "second harmonic of a swing across the rows",
        values,
        {"fitted_row_time_s": found.row_time_s, **details_of(found, "row_time_s", "u_row_time_s")},
        [record],
        notes,
        began,
    )
