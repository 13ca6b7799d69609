"""Commands `rig calibrate lever` and `check`: pixels to radians, from geometry, known tilts or shifts."""

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
from processing.errors import ConfigurationError
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.inputs import LadderFile, read_ladder
from rig.calibrate.spots import binning_of_record, mean_spot, spots_of_record
from rig.presentation import percent, signed_percent


def calibrate_lever(ladder: Path, filing: Filing) -> Path:
    """Calibrate the lever from its geometry, or from a ladder of tilts or shifts (see `read_ladder`)."""
    table = read_ladder(ladder)
    if table.geometry is not None:
        found = lever_from_geometry(table.geometry)
        details = {"u_scale_relative": found.lever.u_scale_relative, **details_of(found, "lever")}
        values = found.lever.model_dump(exclude_none=True)
        return file_calibration("lever", filing, "geometry, traced", values, details, [ladder])
    fit, sources, began = _climb(ladder, table)
    binning = _binning(ladder, table)
    if table.kind == "tilt":
        lever = lever_from_tilts(fit, table.needed("pixel_pitch_m") * binning)
    else:
        lever = lever_from_shifts(fit, table.needed("arm_m"), table.u_arm_m)
    lever = lever.model_copy(update={"binning": binning})
    details = {**_ladder_details(fit, table), "u_scale_relative": lever.u_scale_relative}
    method = f"ladder of {len(table.step)} {table.kind}s"
    values = lever.model_dump(exclude_none=True)
    return file_calibration("lever", filing, method, values, details, sources, fit.notes, began)


def check_known_angle(ladder: Path, lever: Path, filing: Filing) -> Path:
    """Compare a calibrated lever with known tilts."""
    table = read_ladder(ladder)
    if table.kind != "tilt" or not table.step:
        raise ConfigurationError(f"{ladder}: known tilts are needed for a check (kind = 'tilt')")
    in_use = Lever.model_validate(read_calibration(lever, "lever").values)
    fit, sources, began = _climb(ladder, table)
    check = check_scale(in_use.at_binning(_binning(ladder, table)), fit)
    details = {**details_of(check), **_ladder_details(fit, table)}
    notes = list(fit.notes)
    if check.moved:
        notes.append(
            f"scale off by {signed_percent(check.ratio - 1, 3)}, u = {percent(check.u_both)}: calibrate again"
        )
    method = f"{len(table.step)} known tilts against {lever.name}"
    return file_calibration("check", filing, method, {}, details, [*sources, lever], notes, began)


def _climb(path: Path, table: LadderFile) -> tuple[LadderFit, list[Path], datetime.datetime | None]:
    """The fit of a ladder, the files used, and the time of the measurement."""
    sources, began = [path], None
    rows = []
    for number, step in enumerate(table.step, 1):
        if step.record is None:
            rows.append((step.x_px, step.y_px, step.u_px, step.u_px))
            continue
        record = path.parent / step.record
        spots, step_began = spots_of_record(record)
        require_rest(spots.times_s, spots.x, spots.y, f"step {number}, {record}")
        sources.append(record)
        began = step_began if began is None else max(began, step_began)
        rows.append(mean_spot(spots))
    return (
        fit_ladder(table.steps(rows), table.kind, u_reference_relative=table.u_reference_relative),
        sources,
        began,
    )


def _binning(path: Path, table: LadderFile) -> int:
    """The camera's binning when the ladder was measured, as its records state it, or the file without one."""
    found = {binning_of_record(path.parent / step.record) for step in table.step if step.record is not None}
    if len(found) > 1:
        raise ConfigurationError(f"{path}: its records have different binnings: {sorted(found)}")
    return found.pop() if found else table.binning


def _ladder_details(fit: LadderFit, table: LadderFile) -> dict[str, Any]:
    return {
        "reference": [table.in_si(step.reference) for step in table.step],
        "u_reference_relative": table.u_reference_relative,
        **details_of(fit, "notes"),
    }
