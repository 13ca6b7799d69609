"""`rig calibrate lever` and `check`: the scale from tilt or shift to the motion of the spot."""

import datetime
from pathlib import Path
from typing import Any

from calibration import (
    LadderFit,
    Lever,
    check_scale,
    fit_ladder,
    lever_from_geometry,
    lever_from_shifts,
    lever_from_tilts,
    read_calibration,
    require_rest,
)
from processing.errors import ConfigurationError, DataError
from rig.prepare.calibration_inputs import (
    Filing,
    LadderFile,
    details_of,
    file_calibration,
    read_input,
)
from rig.prepare.record_calibrations import binning_of_record, mean_spot, spots_of_record
from rig.terminal import percent, signed_percent


def calibrate_lever(ladder: Path, filing: Filing) -> Path:
    """Calibrate the lever from its geometry, or from a ladder of tilts or shifts (see `LadderFile`)."""
    table = read_input(ladder, LadderFile)
    if table.geometry is not None:
        traced = lever_from_geometry(table.geometry)
        details = {"u_scale_relative": traced.lever.u_scale_relative, **details_of(traced, "lever")}
        values = traced.lever.model_dump(exclude_none=True)
        exact = [name for name in ("u_arm_m", "u_pixel_pitch_m") if not getattr(table.geometry, name)]
        notes = [f"{' and '.join(exact)} not stated: counted as exact in every budget"] if exact else []
        return file_calibration("lever", filing, "geometry, traced", values, details, [ladder], notes)
    fit, sources, last_began = _fit_of_ladder(ladder, table)
    binning = _binning(ladder, table)
    if table.kind == "tilt":
        pitch_m = table.required_value("pixel_pitch_m", ladder) * binning
        doubts = _scale_doubts(ladder, table, "arm", fit.scale * pitch_m, _USUAL_ARM_M)
        lever = lever_from_tilts(fit, pitch_m)
    else:
        doubts = _scale_doubts(ladder, table, "pixel pitch", 1.0 / fit.scale, _USUAL_PITCH_M)
        lever = lever_from_shifts(fit, table.required_value("arm_m", ladder), table.u_arm_m)
    lever = lever.model_copy(update={"binning": binning})
    details = {**_ladder_details(fit, table), "u_scale_relative": lever.u_scale_relative}
    method = f"ladder of {len(table.step)} {table.kind}s"
    values = lever.model_dump(exclude_none=True)
    return file_calibration(
        "lever", filing, method, values, details, sources, [*fit.notes, *doubts], last_began
    )


_USUAL_ARM_M = (0.1, 10.0)
_USUAL_PITCH_M = (0.5e-6, 50e-6)
"""Ranges of the arm and of the pitch of image pixels; outside them a wrong unit is more probable."""


def _scale_doubts(
    ladder: Path, table: LadderFile, name: str, value_m: float, usual_m: tuple[float, float]
) -> list[str]:
    """A note if the arm, or pixel pitch, that a ladder gives lies outside the usual range.

    Raises ConfigurationError if it lies outside by more than a factor of ten, as when milliradians are stated
    as arc seconds.
    """
    min_m, max_m = usual_m
    if min_m <= value_m <= max_m:
        return []
    doubt = (
        f"from these {table.kind}s the {name} is {value_m:.3g} m, which is hardly that of a rig: check "
        f"unit = {table.unit!r}, {'pixel_pitch_m' if table.kind == 'tilt' else 'the readings'}"
    )
    if not 0.1 * min_m < value_m < 10.0 * max_m:
        raise ConfigurationError(f"{ladder}: {doubt}")
    return [doubt]


def check_known_angle(ladder: Path, lever: Path, filing: Filing) -> Path:
    """Compare a calibrated lever with known tilts; returns the file of the check."""
    table = read_input(ladder, LadderFile)
    if table.kind != "tilt" or not table.step:
        raise ConfigurationError(f"{ladder}: known tilts are needed for a check (kind = 'tilt')")
    present = Lever.model_validate(read_calibration(lever, "lever").values)
    fit, sources, last_began = _fit_of_ladder(ladder, table)
    check = check_scale(present.with_binning(_binning(ladder, table)), fit)
    details = {**details_of(check), **_ladder_details(fit, table)}
    notes = list(fit.notes)
    if check.moved:
        notes.append(
            f"scale off by {signed_percent(check.ratio - 1, 3)}, u = {percent(check.u_both)}: calibrate again"
        )
    method = f"{len(table.step)} known tilts against {lever.name}"
    return file_calibration("check", filing, method, {}, details, [*sources, lever], notes, last_began)


def _fit_of_ladder(path: Path, table: LadderFile) -> tuple[LadderFit, list[Path], datetime.datetime | None]:
    """The fit of a ladder, the files used, and the time at which the last of its records began."""
    sources, last_began = [path], None
    rows = []
    for number, step in enumerate(table.step, 1):
        if step.record is None:
            rows.append((step.x_px, step.y_px, step.u_px, step.u_px))
            continue
        record = path.parent / step.record
        spots, step_began = spots_of_record(record)
        require_rest(spots.times_s, spots.x, spots.y, f"step {number}, {record}")
        sources.append(record)
        last_began = step_began if last_began is None else max(last_began, step_began)
        rows.append(mean_spot(spots))
    try:
        fit = fit_ladder(table.steps(rows), table.kind, u_reference_relative=table.u_reference_relative)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    return fit, sources, last_began


def _binning(path: Path, table: LadderFile) -> int:
    """The camera's binning during a ladder, as its records, or else its file, state it."""
    binnings = {
        binning_of_record(path.parent / step.record) for step in table.step if step.record is not None
    }
    if len(binnings) > 1:
        raise ConfigurationError(f"{path}: its records have different binnings: {sorted(binnings)}")
    return binnings.pop() if binnings else table.binning


def _ladder_details(fit: LadderFit, table: LadderFile) -> dict[str, Any]:
    return {
        "reference": [table.in_si(step.reference) for step in table.step],
        "u_reference_relative": table.u_reference_relative,
        **details_of(fit, "notes"),
    }
