"""`rig calibrate pointing`: noise, drift and vibration of a spot that should be at rest."""

from pathlib import Path
from typing import Any

from calibration import Stability, require_rest, stability
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.spots import spots_of_record


def calibrate_pointing(record: Path, filing: Filing) -> Path:
    """Noise, drift and spectral lines of a spot that should be at rest."""
    spots, began = spots_of_record(record)
    require_rest(spots.times_s, spots.x, spots.y, str(record))
    details: dict[str, Any] = {}
    notes = []
    for name, values, u in (("x", spots.x, spots.u_x), ("y", spots.y, spots.u_y)):
        found = stability(spots.times_s, values, u)
        details[name] = _stability_details(found)
        notes += [
            f"{name}: {line.amplitude:.3g} px at {line.frequency_hz:.4g} Hz {line.name}".rstrip()
            for line in found.lines[:3]
        ]
        if not 0.7 < found.claimed_ratio < 1.4:
            notes.append(
                f"{name}: the tracker's uncertainty is {found.claimed_ratio:.2f} of the actual noise"
            )
    return file_calibration("pointing", filing, "pendulum at rest", {}, details, [record], notes, began)


def _stability_details(found: Stability) -> dict[str, Any]:
    details = details_of(found, "claimed_ratio", "allan", "lines", "frequency_hz", "density")
    return {
        **{f"{name}_px": value for name, value in details.items()},
        "claimed_ratio": found.claimed_ratio,
        "allan_tau_s": found.allan.tau_s.tolist(),
        "allan_px": found.allan.deviation.tolist(),
        "u_allan_px": found.allan.u_deviation.tolist(),
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude_px": line.amplitude, "name": line.name}
            for line in found.lines
        ],
    }
