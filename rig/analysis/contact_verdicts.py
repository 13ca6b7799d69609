"""What stands behind a fit's numbers: drag, identifiability, budget, Monte Carlo, contact, work."""

import math
from collections.abc import Mapping
from dataclasses import asdict, astuple, replace

import numpy as np

from calibration import Axes, Lever
from processing.angle import ARCSEC_RAD
from processing.contact import (
    AdhesiveContact,
    HertzContact,
    Material,
    PendulumOnBall,
    adhesive_contacts,
    cycle_work,
    hertz_contact,
)
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import Budget as GumBudget
from processing.fit import Determination as Identified
from processing.fit import (
    DragVerdict,
    FitResult,
    Quantity,
    RigQuantities,
    budgets,
    by_row_time,
    drag_verdict,
    draw_fitted,
    fitted_contact,
    identifiability,
    monte_carlo,
    reported_quantities,
    strong_correlations,
    work_per_cycle_j,
)
from processing.fit import Ground as MovingGround
from processing.fit import Propagated as Sampled
from processing.swing import TurningPoints
from rig.analysis.base_acceleration import base_motion
from rig.analysis.contact_results import (
    Adhesion,
    AdhesiveSpot,
    Budget,
    BudgetSource,
    Correlation,
    Determination,
    Drag,
    Fit,
    Ground,
    Hertz,
    MonteCarlo,
    Propagated,
    Whiteness,
    Work,
)
from rig.analysis.results import RunResults
from rig.instrument import balls, material, shutter_of
from rig.settings import Configuration, PendulumSettings, TimebaseSettings

DRAWS = 10_000
_UNUSED = Material(1e11, 0.3)
_SEEN = 2.0
"""Least c, in standard uncertainties, for which adhesion is accounted for."""
TABLE4_AMPLITUDE_ARCSEC = 3.1
"""Amplitude at which the paper's Table 4 draws its loops."""


def rig_quantities(
    config: Configuration, fast_ratio: float = 0.0, rest_rad: float = 0.0
) -> RigQuantities | None:
    """The apparatus with its standard uncertainties; None without [pendulum].

    `fast_ratio` is the fast mode's amplitude over the slow one's, `rest_rad` the mean tilt at rest from the
    lever's reference (see `RigQuantities`).
    """
    pendulum, lever = config.pendulum, config.lever
    if pendulum is None:
        return None
    # what a stated radius does not need may be unknown
    hertz = pendulum.contact_radius_m is None
    bodies = [
        material(config, name) if hertz else _UNUSED
        for name in (pendulum.ball_material, pendulum.flat_material)
    ]
    # a table's angles are taken as they are
    lever = lever or Lever(arm_m=1.0, pixel_pitch_m=1e-6)
    timebase = config.timebase or TimebaseSettings()
    axes, shutter = config.axes or Axes(), shutter_of(config)
    return RigQuantities(
        mass_kg=Quantity(pendulum.mass_kg, pendulum.u_mass_kg),
        ball_radius_m=Quantity(pendulum.ball_radius_m, pendulum.u_ball_radius_m),
        ball=bodies[0],
        flat=bodies[1],
        contact_radius_m=None
        if pendulum.contact_radius_m is None
        else Quantity(pendulum.contact_radius_m, pendulum.u_contact_radius_m),
        arm_m=Quantity(lever.arm_m, lever.u_arm_m, dof=lever.arm_dof or math.inf),
        pitch_m=Quantity(lever.pixel_pitch_m, lever.u_pixel_pitch_m, dof=lever.pixel_pitch_dof or math.inf),
        gravity_m_per_s2=Quantity(pendulum.gravity_m_per_s2, pendulum.u_gravity_m_per_s2),
        clock=Quantity(timebase.camera_rate, timebase.u_camera_rate),
        slow_angle_rad=Quantity(axes.slow_angle_rad, axes.u_slow_angle_rad),
        non_orthogonality_rad=Quantity(axes.non_orthogonality_rad, axes.u_non_orthogonality_rad),
        fast_ratio=fast_ratio,
        skew=Quantity(lever.skew, lever.u_skew),
        rest_rad=rest_rad,
        balls=balls(config),
        row_time_s=Quantity(shutter.row_time_s, shutter.u_row_time_s),
    )


def contact_of(rig: RigQuantities) -> HertzContact:
    """Contact with the uncertainties of load, radius and elastic constants, or of a stated radius."""
    stated = rig.contact_radius_m
    if stated is not None:
        ball = rig.ball_radius_m
        return HertzContact(
            stated.value,
            stated.value**2 / ball.value,
            stated.value / ball.value,
            stated.u,
            stated.value**2 / ball.value * math.hypot(2 * stated.u / stated.value, ball.u / ball.value),
            stated.value / ball.value * math.hypot(stated.u / stated.value, ball.u / ball.value),
        )
    mass, gravity, radius = rig.mass_kg, rig.gravity_m_per_s2, rig.ball_radius_m
    force = mass.value * gravity.value / rig.balls
    return hertz_contact(
        force,
        radius.value,
        rig.ball,
        rig.flat,
        u_force_n=force * math.hypot(mass.u / mass.value, gravity.u / gravity.value),
        u_ball_radius_m=radius.u,
    )


def evaluate(
    run: RunResults,
    points: TurningPoints,
    pendulum: PendulumOnBall,
    exact: FitResult,
    rig: RigQuantities | None,
    seed: int,
) -> RunResults:
    """The run with everything that is said about its exact fit beyond the fit's own numbers.

    Parameters
    ----------
    rig
        None without [pendulum]: there is no budget and no Monte Carlo then.
    seed
        Of the Monte Carlo draws, so that the same record gives the same intervals.

    Notes
    -----
    What cannot be had (a comparison fit that does not converge, a parameter that the data leave
    open) is said in `notes`; nothing is raised for it.
    """
    notes: list[str] = []
    drag: Drag | None = None
    determinations: tuple[Determination, ...] = ()
    try:
        found = drag_verdict(points, pendulum, loss=exact.loss, without=None if exact.has_drag else exact)
        drag = _drag(found)
        if found.significant and not exact.has_drag:
            notes.append("the reported fit leaves that drag out; fit.drag = true reports the fit with it")
    except DataError as error:
        notes.append(f"no drag verdict: {error}")
    try:
        determinations = tuple(_determination(item) for item in identifiability(points, pendulum, exact))
    except DataError as error:
        notes.append(f"no identifiability verdict: {error}")
    tables: Mapping[str, GumBudget] = {}
    propagated: Mapping[str, Sampled] = {}
    if rig is not None:
        try:
            by_row = by_row_time(points, pendulum, exact, rig)
        except DataError as error:
            by_row = None
            notes.append(f"the budget has no line for the shutter's row time: {error}")
        contact = replace(fitted_contact(exact), by_row_time=by_row)
        tables = budgets(contact, rig)
        if all(quantity.u == 0 for quantity in rig.inputs().values()):
            notes.append(
                "the configuration states no type B uncertainty (u_mass_kg, u_ball_radius_m, u_arm_m, "
                "u_youngs_modulus_pa, ...): budgets hold the scatter of the swings alone"
            )
        try:
            rng = np.random.default_rng(seed)
            propagated = monte_carlo(contact, rig, rng, draws=DRAWS, against=tables)
        except DataError as error:
            notes.append(f"no Monte Carlo: {error}")
    return replace(
        run,
        pendulum=pendulum,
        hertz=None if rig is None else _hertz(contact_of(rig)),
        adhesion=None if rig is None else _adhesion(exact.estimate("c"), pendulum, rig),
        drag=drag,
        identifiability=determinations,
        strong_correlations=tuple(strong_correlations(exact)),
        budget=budget_results(tables),
        monte_carlo=MonteCarlo(DRAWS, seed, {name: _propagated(item) for name, item in propagated.items()})
        if propagated
        else None,
        work_per_cycle=tuple(
            _work(amplitude, exact, pendulum, rig if propagated else None, seed)
            for amplitude in (TABLE4_AMPLITUDE_ARCSEC, float(points.amplitude[0]) / ARCSEC_RAD)
        ),
        notes=tuple(notes),
    )


def fit_results(fit: FitResult, pendulum: PendulumSettings | None = None) -> Fit:
    """What is reported of one fit; `pendulum` states the height of the mass centre, if it is known."""
    return Fit(
        law=fit.law.name,
        parameters=fit.estimates(),
        mean_period_s=fit.mean_period_s,
        arae_decay=fit.arae_decay,
        arae_period=fit.arae_period,
        chi2_per_dof=fit.chi2_per_dof,
        degrees_of_freedom=fit.dof,
        correlation=Correlation(tuple(fit.names), tuple(map(tuple, fit.correlation.tolist()))),
        ground=None if fit.ground is None else _ground(fit, fit.ground, pendulum),
        whiteness=None if fit.whiteness is None else Whiteness(**asdict(fit.whiteness)),
        bias=fit.bias,
        outliers=fit.outliers,
        warnings=fit.warnings,
    )


def _ground(fit: FitResult, found: MovingGround, pendulum: PendulumSettings | None) -> Ground:
    return Ground(
        density_rad_per_s2_rthz=found.density,
        upper_95=found.upper_95,
        seen=found.seen,
        measurement_scale=found.noise.scale,
        left_out_half_cycles=found.left_out,
        widening=_widening(fit),
        base=base_motion(found.density, found.upper_95, fit.mean_period_s.value, pendulum),
    )


def _widening(fit: FitResult) -> dict[str, float]:
    if fit.reading_covariance is None:
        return {}
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = fit.standard_uncertainty / np.sqrt(np.diag(fit.reading_covariance))
    known = dict(zip(fit.names, ratio.tolist(), strict=True))
    return {name: known[name] for name in fit.contact_names}


def budget_results(found: Mapping[str, GumBudget]) -> dict[str, Budget]:
    """What is reported of uncertainty budgets, by quantity."""
    return {
        name: Budget(
            unit=budget.unit,
            value=budget.value,
            standard_uncertainty=budget.standard_uncertainty,
            degrees_of_freedom=budget.dof,
            coverage_factor_95=budget.coverage_factor,
            expanded_uncertainty_95=budget.expanded,
            sources=tuple(BudgetSource(*astuple(line)) for line in budget.lines),
        )
        for name, budget in found.items()
    }


def _hertz(contact: HertzContact) -> Hertz:
    return Hertz(
        Estimate(contact.radius_m, contact.u_radius_m),
        Estimate(contact.depth_m, contact.u_depth_m),
        Estimate(contact.angle_rad, contact.u_angle_rad),
    )


def _adhesion(c: Estimate, pendulum: PendulumOnBall, rig: RigQuantities) -> Adhesion | None:
    """The spot with adhesion; None where c is not seen or the spot's radius was stated."""
    if rig.contact_radius_m is not None or not c.value > _SEEN * c.standard_uncertainty:
        return None
    hertz, found = contact_of(rig), adhesive_contacts(c.value, pendulum)
    u_radius, u_c = hertz.u_radius_m / hertz.radius_m, c.standard_uncertainty / c.value

    def spot(contact: AdhesiveContact) -> AdhesiveSpot:
        radius_m, energy = contact.radius_m, contact.surface_energy_j_per_m2
        return AdhesiveSpot(
            radius_m=Estimate(radius_m, u_radius * radius_m),
            surface_energy_j_per_m2=Estimate(energy, u_c * energy),
        )

    return Adhesion(
        tabor=found.tabor,
        holds=found.holds,
        jkr=spot(found.jkr),
        dmt=spot(found.dmt),
        maugis_dugdale=spot(found.maugis),
    )


def _drag(found: DragVerdict) -> Drag:
    return Drag(
        drag_s=found.drag_s,
        f_statistic=found.f_statistic,
        p_value=found.p_value,
        aic_difference=found.aic_difference,
        relative_shift_b=found.shift_b,
        relative_shift_c=found.shift_c,
        significant=found.significant,
        text=found.text,
        with_drag=found.with_drag.estimates(),
    )


def _determination(item: Identified) -> Determination:
    return Determination(
        name=item.name,
        verdict=item.verdict,
        value=item.value,
        standard_uncertainty=item.standard_uncertainty,
        lower_95=item.lower,
        upper_95=item.upper,
        profile_likelihood=item.profiled,
        text=item.text,
    )


def _propagated(item: Sampled) -> Propagated:
    return Propagated(item.mean, item.standard_uncertainty, item.lower, item.upper, item.gum_holds)


def _work(
    amplitude_arcsec: float, exact: FitResult, pendulum: PendulumOnBall, rig: RigQuantities | None, seed: int
) -> Work:
    """Work per cycle with the scatter that fit and apparatus leave it; NaN uncertainty where unknown."""
    amplitude_rad = amplitude_arcsec * ARCSEC_RAD
    work = cycle_work(amplitude_rad, exact.parameters, pendulum)
    u_dissipated = u_adhesive = math.nan
    if rig is not None:
        rng = np.random.default_rng(seed)
        found = fitted_contact(exact)
        # draws of what the data hardly determine overflow: their spread is then stated as infinite or NaN
        with np.errstate(over="ignore", invalid="ignore"):
            values = draw_fitted(found, rng, DRAWS)
            inputs = {name: quantity.draw(rng, DRAWS) for name, quantity in rig.inputs().items()}
            reported = reported_quantities(found, values, inputs, rig)
            without_drag = {name: sample for name, sample in reported.items() if name != "drag_s"}
            moment = inputs["mass_kg"] * inputs["gravity_m_per_s2"] * inputs["ball_radius_m"]
            u_dissipated = float(np.std(work_per_cycle_j(amplitude_rad, without_drag, inputs), ddof=1))
            u_adhesive = float(np.std(4 * moment * reported["c"] * amplitude_rad, ddof=1))
    return Work(
        amplitude_arcsec,
        Estimate(work.dissipated_j, u_dissipated),
        Estimate(work.adhesive_j, u_adhesive),
        work.drag_j,
    )
