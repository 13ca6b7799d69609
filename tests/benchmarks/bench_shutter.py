"""Rolling shutter: row time found, and what the correction leaves of its effect.

Run as ``python -m tests.benchmarks shutter [--quick]``.
"""

from typing import Any

import numpy as np

from tests.rig.calibrate.rolling_measurement import compare

ROW_TIMES_US = (10.0, 15.0, 30.0)


def run(quick: bool = False) -> dict[str, Any]:
    """Six seeds (one quick) for each row time and both directions of the slow axis."""
    results: dict[str, Any] = {}
    for along_rows in (False, True):
        for row_time_us in ROW_TIMES_US:
            title = f"{row_time_us:g} us a row, slow axis along the {'rows' if along_rows else 'columns'}"
            found = [
                compare(1e-6 * row_time_us, along_rows=along_rows, seed=seed, duration_s=1500.0)
                for seed in range(1, 2 if quick else 7)
            ]
            names = list(found[0].corrected)
            entry: dict[str, Any] = {
                "mean_shift_u": {
                    name: float(np.mean([one.corrected[name] for one in found])) for name in names
                },
                "largest_shift_u": max(abs(shift) for one in found for shift in one.corrected.values()),
                "largest_uncorrected_u": max(
                    abs(shift) for one in found for shift in one.uncorrected.values()
                ),
                "chi2_corrected": float(np.mean([one.chi2_corrected for one in found])),
                "chi2_uncorrected": float(np.mean([one.chi2_uncorrected for one in found])),
            }
            fits = [one.fitted for one in found if one.fitted is not None]
            if fits:
                errors = [1e6 * fit.row_time_s / row_time_us - 1.0 for fit in fits]
                entry["row_time_relative_error"] = [float(error) for error in errors]
                entry["row_time_error_u"] = [
                    (fit.row_time_s - 1e-6 * row_time_us) / fit.u_row_time_s for fit in fits
                ]
            print(title)
            for name, value in entry.items():
                print(f"  {name:26} {value}")
            results[title] = entry
    return results
