"""`rig calibrate lever`, `check` and `air`."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

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
from processing.ambient import AmbientConditions, humid_air
from processing.arrays import Floats
from processing.contact import PendulumOnBall, vane_drag_s_per_m2
from processing.errors import ConfigurationError, DataError
from processing.fit import FitMethod, MeasuredAir, VanedRun, air_of_vanes
from rig.analysis import (
    analyse_record,
    drag_at_pressure,
    expected_drag,
    refuse_copies,
    stated_ambient,
)
from rig.instrument import balls, pendulum_on_ball, recorded_configuration
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
    check = check_scale(in_use.at_binning(_binning(ladder, table)), fit)
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


_VANE_DRAG_RATIO = 1.0
"""Drag of the smaller vanes over that expected of the pendulum itself; the larger ones have twice as much."""


@dataclass(frozen=True, slots=True)
class VanesToCut:
    """Vanes that add as much drag as is expected of the pendulum itself, and their position.

    `area_m2` is the sum over all vanes, one face of each; `distance_m` is the distance of their middles from
    the axis, `drag_s` the drag of the pendulum itself.
    """

    area_m2: float
    distance_m: float
    drag_s: float

    @property
    def text(self) -> str:
        """Instructions to cut and mount the vanes."""
        side_mm = 1e3 * (0.5 * self.area_m2) ** 0.5
        return (
            f"Cut two pairs of thin stiff sheets, {side_mm:.0f} x {side_mm:.0f} mm and {side_mm:.0f} x "
            f"{2 * side_mm:.0f} mm. A pair of the first, {1e4 * self.area_m2:.0f} cm² together, adds about "
            f"what air exerts on the pendulum itself ({1e3 * self.drag_s:.2g} ms), one of the second, "
            f"{2e4 * self.area_m2:.0f} cm², twice that. One sheet of a pair goes to each end of the "
            f"pendulum, its middle {1e3 * self.distance_m:.0f} mm from the axis, upright, so that it moves "
            "in its own plane and the mass centre stays. In runs without them, and with the smaller ones, "
            "their weight goes back to the same places in compact pieces: the load on the ball, and with it "
            "the contact, has to stay."
        )


def vanes_to_cut(config: Configuration, period_s: float) -> VanesToCut | None:
    """The vanes for the pendulum of a configuration; None without [pendulum]."""
    pendulum = pendulum_on_ball(config)
    if pendulum is None:
        return None
    found = stated_ambient(config)
    bar = expected_drag(found, pendulum, period_s, config)
    distance_m = 0.5 * bar.length_m
    usual = {"temperature_c": 20.0, "humidity_percent": 50.0, "pressure_pa": 101325.0}
    air = humid_air(**{name: found.known().get(name, value) for name, value in usual.items()})
    per_area = vane_drag_s_per_m2(air, distance_m, pendulum, period_s) / balls(config)
    return VanesToCut(_VANE_DRAG_RATIO * bar.drag_s / per_area, distance_m, bar.drag_s)


def calibrate_air(vanes: Path, filing: Filing) -> Path:
    """Calibrate the drag of the air from a list of runs (see `VaneFile`); returns the file."""
    table = read_input(vanes, VaneFile)
    for listed_run in table.run:
        if not (vanes.parent / listed_run.record).is_file():
            raise ConfigurationError(f"{vanes}: {vanes.parent / listed_run.record}: no such record")
    refuse_copies([vanes.parent / listed_run.record for listed_run in table.run])
    runs, sources, rows, pendulums, configs = [], [vanes], [], [], []
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
        runs.append(VanedRun(run.points, fit, listed_run.exposure, listed_run.u_area_m2))
        pendulums.append(pendulum)
        configs.append(config)
        rows.append(listed_run.exposure)
        sources.append(record)
    by_ratio = table.by_pressure
    if by_ratio:
        runs = _at_ratios(runs, pendulums[0], period_s, configs)
    if len(set(pendulums)) > 1:
        raise DataError(f"{vanes}: its runs are of different pendulums: mass, ball or flat have changed")
    found = air_of_vanes(runs, pendulums[0], by_ratio=by_ratio)
    if not found.drag_s.value > 0:
        raise DataError(
            f"{vanes}: its runs give a drag of {found.drag_s.value:.2g} ± "
            f"{found.drag_s.standard_uncertainty:.2g} s, which no air exerts: larger vanes, "
            "or longer runs, are needed"
        )
    slope, u_slope = found.per_exposure
    if not by_ratio and slope < -2.0 * u_slope:
        raise DataError(
            f"{vanes}: its runs lose {-slope:.2g} ± {u_slope:.2g} s of drag per m² of vanes, and vanes add "
            "some: see which record has which area"
        )
    values = {"drag_s": found.drag_s.value, "u_drag_s": found.drag_s.standard_uncertainty}
    method = f"{len(runs)} runs, {len(set(rows))} " + ("pressures" if by_ratio else "areas of vanes")
    details = _details(found, rows, by_ratio) | shown
    return file_calibration(
        "air", filing, method, values, details, sources, _notes(found, table, as_detected), began
    )


_U_WIDTH, _U_WIDTH_STATED = 0.3, 0.1
"""Relative standard uncertainty of the width of a bar that resists at other pressures as the pendulum does,
where the width is assumed, and where it is stated: ends, mirror and weights are no bar."""


def _at_ratios(
    runs: Sequence[VanedRun], pendulum: PendulumOnBall, period_s: float, configs: Sequence[Configuration]
) -> list[VanedRun]:
    """Runs whose exposures, stated as pressures, are drags relative to that at the highest, the room's.

    A wrong width changes all ratios together. As errors of single runs they are larger by the root of the
    number of ratios, so that together they allow as much of it.
    """
    stated = configs[0].pendulum is not None and configs[0].pendulum.width_m is not None
    u_width = _U_WIDTH_STATED if stated else _U_WIDTH

    def ratios(width_factor: float) -> Floats:
        drags = np.array(
            [
                drag_at_pressure(run.exposure, pendulum, period_s, config, width_factor=width_factor)
                for run, config in zip(runs, configs, strict=True)
            ]
        )
        return np.asarray(drags / drags.max())

    found = ratios(1.0)
    u = 0.5 * np.abs(ratios(1.0 + u_width) - ratios(1.0 - u_width)) * np.sqrt(np.count_nonzero(found < 1.0))
    return [
        replace(run, exposure=ratio, u_exposure=u_ratio)
        for run, ratio, u_ratio in zip(runs, found.tolist(), u.tolist(), strict=True)
    ]


def _air_details(
    air: AmbientConditions | None, pendulum: PendulumOnBall, config: Configuration, period_s: float
) -> dict[str, Any]:
    """The air of the first run, and the drag expected of it."""
    known = AmbientConditions() if air is None else air
    return {**known.known(), "expected_drag_s": expected_drag(known, pendulum, period_s, config).drag_s}


def _details(found: MeasuredAir, exposures: list[float], by_ratio: bool) -> dict[str, Any]:
    contact_details = {
        key: value
        for name, (one, u) in found.contact.items()
        for key, value in ((name, one), (f"u_{name}", u))
    }
    slope = {} if by_ratio else dict(zip(("per_m2_s", "u_per_m2_s"), found.per_exposure, strict=True))
    return {
        **slope,
        "chi2": found.chi2,
        "degrees_of_freedom": found.dof,
        "chance": found.chance,
        "enlarged": found.enlarged,
        **contact_details,
        "pressures_pa" if by_ratio else "areas_m2": exposures,
        "drags_s": [one.value for one in found.of_runs_s],
        "u_drags_s": [one.standard_uncertainty for one in found.of_runs_s],
        "off_drags_s": list(found.off_s),
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
    if len({run.exposure for run in table.run}) < 3:
        notes.append("two exposures do not show whether the drag follows the line: make runs at three")
    if not table.by_pressure and min(run.area_m2 or 0.0 for run in table.run) > 0:
        notes.append("no run is without vanes: the drag of the pendulum alone is extrapolated")
    slope, u_slope = found.per_exposure
    if not table.by_pressure and slope < 2.0 * u_slope:
        notes.append(
            f"the vanes add no drag that is seen ({slope:.2g} ± {u_slope:.2g} s per m²): see which record "
            "has which area"
        )
    return notes
