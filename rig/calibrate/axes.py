"""`rig calibrate axes`: directions of the pendulum's two modes on the sensor."""

from pathlib import Path

from acquisition.record.reader import RecordReader
from calibration import Sign, fit_axes
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.spots import spots_of_record
from rig.instrument import recorded_configuration


def calibrate_axes(record: Path, filing: Filing, slow_began: Sign | None, fast_began: Sign | None) -> Path:
    """Directions of both modes from a record in which both swing."""
    spots, began = spots_of_record(record)
    with RecordReader(record) as reader:
        before = recorded_configuration(reader).axes
    fit = fit_axes(
        spots.times_s,
        spots.x,
        spots.y,
        slow_began=slow_began,
        fast_began=fast_began,
        mirrored=before.mirrored if before is not None else False,
    )
    details = details_of(fit, "axes", "notes")
    return file_calibration(
        "axes", filing, "both modes fitted", fit.axes.model_dump(), details, [record], fit.notes, began
    )
