"""`rig calibrate lever`, `check` and `air`."""

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from acquisition.record.reader import RecordReader
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
from processing.ambient import AmbientConditions
from processing.contact import PendulumOnBall
from processing.errors import ConfigurationError, DataError
from processing.fit import FitMethod, MeasuredAir, VanedRun, air_of_vanes
from rig.analysis import (
    analyse_record,
    expected_drag,
    refuse_copies,
)
from rig.instrument import recorded_configuration
from rig.prepare.calibration_inputs import (
    Filing,
    LadderFile,
    VaneFile,
    details_of,
    file_calibration,
    read_input,
)
from rig.prepare.frame_times import binning_of_record, mean_spot, spots_of_record
from rig.settings import Configuration
from rig.terminal import percent, signed_percent


def calibrate_lever(ladder: Path, filing: Filing) -> Path:
    """Calibrate the lever from its geometry, or from a ladder of tilts or shifts (see `LadderFile`)."""
    table = read_input(ladder, LadderFile)
    if table.geometry is not None:
        found = lever_from_geometry(table.geometry)
        details = {"u_scale_relative": found.lever.u_scale_relative, **details_of(found, "lever")}
        values = found.lever.model_dump(exclude_none=True)
        exact = [name for name in ("u_arm_m", "u_pixel_pitch_m") if not getattr(table.geometry, name)]
        notes = [f"{' and '.join(exact)} not stated: counted as exact in every budget"] if exact else []
        return file_calibration("lever", filing, "geometry, traced", values, details, [ladder], notes)
    fit, sources, began = _fit_of_ladder(ladder, table)
    binning = _binning(ladder, table)
    if table.kind == "tilt":
        pitch_m = table.required_value("pixel_pitch_m", ladder) * binning
        odd = _odd_scale(ladder, table, "arm", fit.scale * pitch_m, _ARM_M)
        lever = lever_from_tilts(fit, pitch_m)
    else:
        odd = _odd_scale(ladder, table, "pixel pitch", 1.0 / fit.scale, _PITCH_M)
        lever = lever_from_shifts(fit, table.required_value("arm_m", ladder), table.u_arm_m)
    lever = lever.model_copy(update={"binning": binning})
    details = {**_ladder_details(fit, table), "u_scale_relative": lever.u_scale_relative}
    method = f"ladder of {len(table.step)} {table.kind}s"
    values = lever.model_dump(exclude_none=True)
    notes = [*fit.notes, *odd]
    return file_calibration("lever", filing, method, values, details, sources, notes, began)


_ARM_M = (0.1, 10.0)
_PITCH_M = (0.5e-6, 50e-6)
"""Arms, and pitches of image pixels, outside of which a wrong unit is more probable than such a rig."""


def _odd_scale(
    ladder: Path, table: LadderFile, name: str, value_m: float, usual_m: tuple[float, float]
) -> list[str]:
    """A note if the arm, or pixel pitch, that a ladder gives is not a usual one.

    Raises ConfigurationError if it is ten times farther off, as with milliradians called arc seconds.
    """
    least_m, most_m = usual_m
    if least_m <= value_m <= most_m:
        return []
    doubt = (
        f"from these {table.kind}s the {name} is {value_m:.3g} m, which is hardly that of a rig: check "
        f"unit = {table.unit!r}, {'pixel_pitch_m' if table.kind == 'tilt' else 'the numbers'}"
    )
    if not 0.1 * least_m < value_m < 10.0 * most_m:
        raise ConfigurationError(f"{ladder}: {doubt}")
    return [doubt]


def check_known_angle(ladder: Path, lever: Path, filing: Filing) -> Path:
    """Compare a calibrated lever with known tilts; returns the file of the check."""
    table = read_input(ladder, LadderFile)
    if table.kind != "tilt" or not table.step:
        raise ConfigurationError(f"{ladder}: known tilts are needed for a check (kind = 'tilt')")
    in_use = Lever.model_validate(read_calibration(lever, "lever").values)
    fit, sources, began = _fit_of_ladder(ladder, table)
    check = check_scale(in_use.with_binning(_binning(ladder, table)), fit)
    details = {**details_of(check), **_ladder_details(fit, table)}
    notes = list(fit.notes)
    if check.moved:
        notes.append(
            f"scale off by {signed_percent(check.ratio - 1, 3)}, u = {percent(check.u_both)}: calibrate again"
        )
    method = f"{len(table.step)} known tilts against {lever.name}"
    return file_calibration("check", filing, method, {}, details, [*sources, lever], notes, began)


def _fit_of_ladder(path: Path, table: LadderFile) -> tuple[LadderFit, list[Path], datetime.datetime | None]:
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
    try:
        fit = fit_ladder(table.steps(rows), table.kind, u_reference_relative=table.u_reference_relative)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    return fit, sources, began


def _binning(path: Path, table: LadderFile) -> int:
    """The camera's binning during a ladder, as its records state it, or else the ladder's file."""
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


def calibrate_air(vanes: Path, filing: Filing) -> Path:
    """Calibrate the drag of the air from a list of runs (see `VaneFile`); returns the file."""
    table = read_input(vanes, VaneFile)
    for listed_run in table.run:
        if not (vanes.parent / listed_run.record).is_file():
            raise ConfigurationError(f"{vanes}: {vanes.parent / listed_run.record}: no such record")
    refuse_copies([vanes.parent / listed_run.record for listed_run in table.run])
    runs, sources, areas_m2, pendulums = [], [vanes], [], []
    as_detected: list[int] = []
    began: datetime.datetime | None = None
    shown: dict[str, Any] = {}
    period_s = 0.0
    for number, listed_run in enumerate(table.run, 1):
        record = vanes.parent / listed_run.record
        run = analyse_record(record, air_known=False)
        fit, pendulum = run.fitted.get(FitMethod.EXACT), run.pendulum
        if fit is None or pendulum is None:
            raise DataError(f"run {number}, {record}: {run.problem}")
        if fit.evidence.waveform is None:
            raise DataError(
                f"run {number}, {record}: it is too short for the waveform, without which drag and friction "
                "look the same; measure a longer run"
            )
        with RecordReader(record) as reader:
            config, at = recorded_configuration(reader), reader.utc(int(reader.spots()["time_ns"][0]))
        began = at if began is None else max(began, at)
        # one period, as it stands for the pendulum's length: means of runs differ by their amplitudes
        period_s = period_s or fit.mean_period_s.value
        shown = shown or _air_details(run.ambient, pendulum, config, period_s)
        if run.measured_again_on is None:
            as_detected.append(number)
        runs.append(VanedRun(run.points, fit, listed_run.area_m2))
        pendulums.append(pendulum)
        areas_m2.append(listed_run.area_m2)
        sources.append(record)
    if len(set(pendulums)) > 1:
        raise DataError(f"{vanes}: its runs are of different pendulums: mass, ball or flat have changed")
    found = air_of_vanes(runs, pendulums[0])
    if not found.drag_s.value > 0:
        raise DataError(
            f"{vanes}: its runs give a drag of {found.drag_s.value:.2g} ± "
            f"{found.drag_s.standard_uncertainty:.2g} s, which no air exerts: larger vanes, "
            "or longer runs, are needed"
        )
    slope, u_slope = found.per_m2_s
    if slope < -2.0 * u_slope:
        raise DataError(
            f"{vanes}: its runs lose {-slope:.2g} ± {u_slope:.2g} s of drag per m² of vanes, and vanes add "
            "some: see which record has which area"
        )
    values = {"drag_s": found.drag_s.value, "u_drag_s": found.drag_s.standard_uncertainty}
    method = f"{len(runs)} runs, {len(set(areas_m2))} areas of vanes"
    details = _details(found, areas_m2) | shown
    return file_calibration(
        "air", filing, method, values, details, sources, _notes(found, table, as_detected), began
    )


def _air_details(
    air: AmbientConditions | None, pendulum: PendulumOnBall, config: Configuration, period_s: float
) -> dict[str, Any]:
    """The air of the first run, and the drag expected of it."""
    known = AmbientConditions() if air is None else air
    return {**known.known(), "expected_drag_s": expected_drag(known, pendulum, period_s, config).drag_s}


def _details(found: MeasuredAir, areas_m2: list[float]) -> dict[str, Any]:
    contact_details = {
        key: value
        for name, (one, u) in found.contact.items()
        for key, value in ((name, one), (f"u_{name}", u))
    }
    return {
        **dict(zip(("per_m2_s", "u_per_m2_s"), found.per_m2_s, strict=True)),
        "chi2": found.chi2,
        "degrees_of_freedom": found.dof,
        "chance": found.chance,
        "enlarged": found.enlarged,
        **contact_details,
        "areas_m2": areas_m2,
        "drags_s": [one.value for one in found.of_runs_s],
        "u_drags_s": [one.standard_uncertainty for one in found.of_runs_s],
    }


def _notes(found: MeasuredAir, table: VaneFile, as_detected: Sequence[int]) -> list[str]:
    notes = []
    if as_detected:
        notes.append(
            f"the turning points of run {', '.join(map(str, as_detected))} could not be measured a second "
            "time: its first half-cycles share an error of time that is not in the uncertainties, which may "
            "be a third too small; replace that run (rig report says what is wrong with it)"
        )
    if found.disagree:
        notes.append(
            f"the runs do not agree on one contact and one line (chance {found.chance:.2g}): uncertainties "
            f"are enlarged {found.enlarged:.2g} times; check which run deviates and if the load was the same"
        )
    if len({run.area_m2 for run in table.run}) < 3:
        notes.append("two areas do not show whether the drag follows the line: make runs at three")
    if min(run.area_m2 for run in table.run) > 0:
        notes.append("no run is without vanes: the drag of the pendulum alone is extrapolated")
    slope, u_slope = found.per_m2_s
    if slope < 2.0 * u_slope:
        notes.append(
            f"the vanes add no drag that is seen ({slope:.2g} ± {u_slope:.2g} s per m²): see which record "
            "has which area"
        )
    return notes
