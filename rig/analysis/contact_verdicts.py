"""Results that follow from a fit: drag verdict, budget, table of results, contact spot, work."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from calibration import Axes, Lever
from processing.arrays import Floats
from processing.contact import ExpectedDrag, Material, PendulumOnBall, adhesive_contacts, weight_moment
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import (
    BOUNDARY_LAYER,
    FIXED_PATTERN,
    MEASUREMENT,
    REST_POSITION,
    Budget,
    Determination,
    Drag,
    FitMethod,
    FitQuality,
    FitResult,
    InputQuantity,
    LinearisedFit,
    RigQuantities,
    Work,
    amplitude_error_effects,
    budgets,
    drag_verdict,
    drift_effects,
    identifiability,
    reported_quantities,
    rolling_moment_nm,
    sensor_derivatives,
    standard_uncertainties,
    works_per_cycle_j,
)
from processing.swing import TurningPoints
from processing.units import ARCSEC_RAD
from rig.analysis.ambient import drift_note
from rig.analysis.result_rows import (
    SURFACE_ENERGY,
    ResultRow,
    plain_row,
    result_rows,
    rows_of_others,
    withheld,
)
from rig.analysis.results import Correlation, Fit
from rig.analysis.series import AnalysedRun
from rig.instrument import balls, material, shutter_of
from rig.settings import Configuration, TimebaseSettings

_UNUSED = Material(1e11, 0.3)
"""Material of bodies whose contact radius is stated, so that nothing depends on it."""
TABLE4_AMPLITUDE_ARCSEC = 3.1
"""Amplitude of the loops in the paper's Table 4."""


def rig_quantities(
    config: Configuration,
    fast_ratio: float = 0.0,
    rest_rad: float = 0.0,
    u_clock: float = 0.0,
    **run_inputs: InputQuantity,
) -> RigQuantities | None:
    """The apparatus with its standard uncertainties; None without [pendulum].

    `fast_ratio` is the fast mode's amplitude over the slow one's, `rest_rad` the mean tilt at rest from the
    lever's reference (see `RigQuantities`), `u_clock` the relative uncertainty of the second by the run
    itself, which counts where it is larger than the calibration's. `run_inputs` are inputs of the run itself.
    """
    pendulum, lever = config.pendulum, config.lever
    if pendulum is None:
        return None
    # with a stated radius the materials may be unknown
    hertz = pendulum.contact_radius_m is None
    bodies = [
        material(config, name) if hertz else _UNUSED
        for name in (pendulum.ball_material, pendulum.flat_material)
    ]
    # the angles of a table have no lever
    lever = lever or Lever(arm_m=1.0, pixel_pitch_m=1e-6)
    timebase = config.timebase or TimebaseSettings()
    axes, shutter = config.axes or Axes(), shutter_of(config)
    return RigQuantities(
        mass_kg=InputQuantity(pendulum.mass_kg, pendulum.u_mass_kg),
        ball_radius_m=InputQuantity(pendulum.ball_radius_m, pendulum.u_ball_radius_m),
        ball=bodies[0],
        flat=bodies[1],
        contact_radius_m=None
        if pendulum.contact_radius_m is None
        else InputQuantity(pendulum.contact_radius_m, pendulum.u_contact_radius_m),
        arm_m=InputQuantity(lever.arm_m, lever.u_arm_m, dof=lever.arm_dof or math.inf),
        pitch_m=InputQuantity(
            lever.pixel_pitch_m, lever.u_pixel_pitch_m, dof=lever.pixel_pitch_dof or math.inf
        ),
        gravity_m_per_s2=InputQuantity(pendulum.gravity_m_per_s2, pendulum.u_gravity_m_per_s2),
        clock=InputQuantity(timebase.camera_rate, max(timebase.u_camera_rate, u_clock)),
        slow_angle_rad=InputQuantity(axes.slow_angle_rad, axes.u_slow_angle_rad),
        non_orthogonality_rad=InputQuantity(axes.non_orthogonality_rad, axes.u_non_orthogonality_rad),
        fast_ratio=fast_ratio,
        skew=InputQuantity(lever.skew, lever.u_skew),
        rest_rad=rest_rad,
        balls=balls(config),
        row_time_s=InputQuantity(shutter.row_time_s, shutter.u_row_time_s),
        **run_inputs,
    )


def with_contact(
    run: AnalysedRun,
    pendulum: PendulumOnBall,
    plane_errors: Floats | None = None,
    air_drag: ExpectedDrag | None = None,
) -> AnalysedRun:
    """A run with the results of its fits: their numbers and rows, and verdicts and budget of the exact one.

    `run` has its fits and, for a budget, its apparatus (`rig`). `plane_errors` (points, terms) are
    independent errors of the amplitudes by the uncertain plane of swing; None if there are none. `air_drag`
    is the drag expected of the air, if it is known. Nothing is raised for a missing part: `notes` name it.
    """
    points, fits, rig, name = run.points, run.fitted, run.rig, Path(run.record).stem
    exact = fits[FitMethod.EXACT]
    notes: list[str] = []
    drag: Drag | None = None
    tables: Mapping[str, Budget] = {}
    contact: FitResult | None = None
    determinations: tuple[Determination, ...] = ()
    try:
        drag = replace(drag_verdict(points, pendulum, exact), of_air=air_drag)
        if drag.significant and not exact.has_drag:
            notes.append("the reported fit leaves that drag out: fit.drag = 'vacuum' asks for it")
    except DataError as error:
        notes.append(f"no drag verdict: {error}")
    try:
        determinations = identifiability(points, pendulum, exact)
    except DataError as error:
        notes.append(f"no identifiability verdict: {error}")
    if rig is not None:
        linearised = LinearisedFit.of(points, pendulum, exact)
        drifts = drift_effects(linearised)
        by_inputs = {**drifts, **sensor_derivatives(linearised, rig)}
        if plane_errors is not None and rig.plane_of_swing_rad.u > 0:
            plane_effects = amplitude_error_effects(linearised, plane_errors)
            by_inputs["plane_of_swing_rad"] = plane_effects / rig.plane_of_swing_rad.u
        contact = replace(exact, by_inputs=by_inputs)
        notes += filter(None, [drift_note(drifts, {name: rig.inputs()[name].u for name in drifts}, exact)])
        tables = budgets(contact, rig)
        if all(quantity.u == 0 for quantity in rig.inputs().values()):
            notes.append(
                "the configuration states no type B uncertainty (u_mass_kg, u_ball_radius_m, u_arm_m, "
                "u_youngs_modulus_pa, ...): budgets contain only the scatter of the swings"
            )
    rows = result_rows(name, exact, determinations, tables, pendulum)
    c_is_determined = any(row.quantity == "c" and row.determined for row in rows)
    adhesion, spots = "", tuple[ResultRow, ...]()
    if rig is not None and rig.contact_radius_m is None and c_is_determined:
        adhesion, spots = _adhesion(name, exact.estimate("c").value, pendulum, rows)
    return replace(
        run,
        fits={method: fit_results(fit) for method, fit in fits.items()},
        pendulum=pendulum,
        adhesion=adhesion,
        drag=drag,
        table=(*rows, *spots, *rows_of_others(name, fits, rows)),
        budget=withheld(tables, rows),
        work_per_cycle=tuple(
            _work(amplitude_arcsec, exact, pendulum, contact, rig, c_is_determined=c_is_determined)
            for amplitude_arcsec in _work_amplitudes_arcsec(points)
        ),
        notes=(*notes, *run.notes),
    )


def fit_results(fit: FitResult) -> Fit:
    """The reported results of one fit."""
    shared = {item.name: getattr(fit, item.name) for item in fields(FitQuality)}
    if fit.ground is not None:
        shared["ground"] = replace(fit.ground, widening=_widening(fit))
    return Fit(
        law=fit.law.name,
        parameters=fit.estimates(),
        correlation=Correlation(tuple(fit.names), tuple(map(tuple, fit.correlation.tolist()))),
        **shared,
    )


def _widening(fit: FitResult) -> dict[str, float]:
    """Standard uncertainties of the contact parameters over those on ground at rest."""
    if MEASUREMENT not in fit.terms:
        return {}
    covariance = fit.covariance_by(MEASUREMENT, FIXED_PATTERN, BOUNDARY_LAYER, REST_POSITION)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = fit.standard_uncertainty / np.sqrt(np.diag(covariance))
    return {name: float(ratio[fit.names.index(name)]) for name in fit.contact_names}


def _adhesion(
    run: str, c: float, pendulum: PendulumOnBall, rows: Sequence[ResultRow]
) -> tuple[str, tuple[ResultRow, ...]]:
    """Name of the adhesion theory that holds, and radius and surface energy by each theory, for a given c."""
    if not c > 0:
        return "", ()
    contacts = adhesive_contacts(c, pendulum)
    # values depend on the same inputs as Hertz's, and have the same relative uncertainties
    hertz_rows = {row.quantity: row for row in rows}
    spots = [plain_row("tabor", contacts.tabor, run, "adhesion")]
    for theory, spot in (("JKR", contacts.jkr), ("Maugis-Dugdale", contacts.maugis), ("DMT", contacts.dmt)):
        values = {"contact_radius_m": spot.radius_m, SURFACE_ENERGY: spot.surface_energy_j_per_m2}
        for name, value in values.items():
            hertz, row = hertz_rows[name], plain_row(name, value, run, theory)
            ratio = value / hertz.value
            spots.append(replace(row, u=ratio * hertz.u, u_total=ratio * hertz.u_total))
    return contacts.holds, tuple(spots)


def _work_amplitudes_arcsec(points: TurningPoints) -> Sequence[float]:
    """Amplitudes of the work in arcsec: that of Table 4, or the nearest measured, and the first."""
    amplitude_arcsec = points.amplitude / ARCSEC_RAD
    largest, smallest = float(amplitude_arcsec.max()), float(amplitude_arcsec.min())
    if largest <= max(TABLE4_AMPLITUDE_ARCSEC, smallest):
        return (largest,)
    return (max(TABLE4_AMPLITUDE_ARCSEC, smallest), float(amplitude_arcsec[0]))


def _work(
    amplitude_arcsec: float,
    exact: FitResult,
    pendulum: PendulumOnBall,
    contact: FitResult | None,
    rig: RigQuantities | None,
    *,
    c_is_determined: bool,
) -> Work:
    """Work per cycle, with its u by fit and apparatus (NaN without); that of adhesion only with a known c."""
    amplitude_rad = amplitude_arcsec * ARCSEC_RAD
    parameters = {name: np.array(value) for name, value in exact.named_values.items()}
    work = works_per_cycle_j(amplitude_rad, parameters, np.array(weight_moment(pendulum)))
    u = dict.fromkeys(work, math.nan)
    if rig is not None and contact is not None:
        u = standard_uncertainties(
            contact,
            rig,
            lambda inputs: works_per_cycle_j(
                amplitude_rad, reported_quantities(contact, inputs, rig), rolling_moment_nm(inputs, rig)
            ),
        )
    return Work(
        amplitude_arcsec,
        Estimate(float(work["dissipated"]), u["dissipated"]),
        Estimate(float(work["adhesive"]), u["adhesive"]) if c_is_determined else NOT_DETERMINED,
        float(work["drag"]),
    )
