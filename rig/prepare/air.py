"""`rig calibrate air`: the drag of the air from runs with vanes of several areas."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from acquisition.record.reader import RecordReader
from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError, DataError
from processing.fit import FitMethod, MeasuredAir, VanedRun, air_of_vanes
from rig.analysis import analyse_record, expected_drag, refuse_copies
from rig.instrument import recorded_configuration
from rig.prepare.calibration_inputs import Filing, VaneFile, file_calibration, read_input


def calibrate_air(run_list: Path, filing: Filing) -> Path:
    """Calibrate the drag of the air from a list of runs (see `VaneFile`); returns the file."""
    table = read_input(run_list, VaneFile)
    records = [run_list.parent / listed_run.record for listed_run in table.run]
    areas_m2 = [listed_run.area_m2 for listed_run in table.run]
    for record in records:
        if not record.is_file():
            raise ConfigurationError(f"{run_list}: {record}: no such record")
    refuse_copies(records)
    runs, pendulums, starts = [], [], []
    runs_not_refined: list[int] = []
    expected: dict[str, Any] = {}
    for number, (record, area_m2) in enumerate(zip(records, areas_m2, strict=True), 1):
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
            starts.append(reader.utc(int(reader.spots()["time_ns"][0])))
            config = recorded_configuration(reader)
        if not expected:
            # of the first run: the air, and the drag that is expected of it
            ambient = run.ambient or AmbientConditions()
            drag = expected_drag(ambient, pendulum, fit.mean_period_s.value, config)
            expected = {**ambient.known(), "expected_drag_s": drag.drag_s}
        if run.measured_again_on is None:
            runs_not_refined.append(number)
        runs.append(VanedRun(run.points, fit, area_m2))
        pendulums.append(pendulum)
    if len(set(pendulums)) > 1:
        raise DataError(f"{run_list}: its runs are of different pendulums: mass, ball or flat have changed")
    air = air_of_vanes(runs, pendulums[0])
    if not air.drag_s.value > 0:
        raise DataError(
            f"{run_list}: its runs give a drag of {air.drag_s.value:.2g} ± "
            f"{air.drag_s.standard_uncertainty:.2g} s, which no air exerts: larger vanes, "
            "or longer runs, are needed"
        )
    slope, u_slope = air.drag_per_area_s_per_m2
    if slope < -2.0 * u_slope:
        raise DataError(
            f"{run_list}: its drags fall by {-slope:.2g} ± {u_slope:.2g} s per m² of vanes, but vanes add "
            "drag: check which record has which area"
        )
    values = {"drag_s": air.drag_s.value, "u_drag_s": air.drag_s.standard_uncertainty}
    method = f"{len(runs)} runs, {len(set(areas_m2))} areas of vanes"
    details = _details(air, areas_m2) | expected
    notes = _notes(air, areas_m2, runs_not_refined)
    sources = [run_list, *records]
    return file_calibration("air", filing, method, values, details, sources, notes, max(starts))


def _details(air: MeasuredAir, areas_m2: list[float]) -> dict[str, Any]:
    contact_details: dict[str, float] = {}
    for name, (value, u) in air.contact.items():
        contact_details |= {name: value, f"u_{name}": u}
    return {
        **dict(zip(("per_m2_s", "u_per_m2_s"), air.drag_per_area_s_per_m2, strict=True)),
        "chi2": air.chi2,
        "degrees_of_freedom": air.dof,
        "chance": air.p_value,
        "enlarged": air.u_inflation,
        **contact_details,
        "areas_m2": areas_m2,
        "drags_s": [drag_s for drag_s, _ in air.run_drags_s],
        "u_drags_s": [u_drag_s for _, u_drag_s in air.run_drags_s],
    }


def _notes(air: MeasuredAir, areas_m2: Sequence[float], runs_not_refined: Sequence[int]) -> list[str]:
    notes = []
    if runs_not_refined:
        notes.append(
            f"the turning points of run {', '.join(map(str, runs_not_refined))} could not be measured a "
            "second time: its first half-cycles share an error of time that is not in the uncertainties, "
            "which may be a third too small; replace that run (rig report says what is wrong with it)"
        )
    if air.disagree:
        notes.append(
            f"the runs do not agree on one contact and one line (chance {air.p_value:.2g}): uncertainties "
            f"are enlarged {air.u_inflation:.2g} times; check which run deviates and if the load was the same"
        )
    if len(set(areas_m2)) < 3:
        notes.append("two areas do not show whether the drag follows the line: make runs at three")
    if min(areas_m2) > 0:
        notes.append("no run is without vanes: the drag of the pendulum alone is extrapolated")
    slope, u_slope = air.drag_per_area_s_per_m2
    if slope < 2.0 * u_slope:
        notes.append(
            f"the vanes add no significant drag ({slope:.2g} ± {u_slope:.2g} s per m²): check which record "
            "has which area"
        )
    return notes
