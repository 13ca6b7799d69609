"""Second measurement of a run's half-cycles with the fitted motion, and both fits of their decay."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from processing.contact import PendulumOnBall
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.fit import (
    DISCREPANCY,
    FIXED_PATTERN,
    NO_EVIDENCE,
    DecayFit,
    Evidence,
    FitMethod,
    FitResult,
    LinearisedFit,
    PositionErrorFit,
    Refinement,
    Seismogram,
    SeismometerUse,
    boundary_layer_drag,
    describes_as_well,
    domain_warnings,
    drift_term,
    fit_asymptotic,
    fit_position_errors,
    fit_with_knocks,
    fit_with_seismometer,
    judge_refinement,
    known_motion,
    measurement_shift,
    second_measurement,
    time_alternation,
    up_to_rest_step,
    with_boundary_layer_drag,
    with_changes,
    with_discrepancy,
    without_alternation,
)
from processing.least_squares import Loss
from processing.position_map import PositionMap, PositionMapSearch
from processing.swing import (
    CycleWatch,
    HalfCycle,
    HarmonicsMeasurement,
    KnownMotion,
    SwingHarmonics,
    TurningPoints,
    with_learned_weights,
)
from rig.analysis.ambient import FREE_DRAG, FittedDrag, evidence_of
from rig.settings import FitSettings


def refined_half_cycles(
    swings: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    clock_rate: float = 1.0,
    drag: FittedDrag = FREE_DRAG,
) -> Refinement:
    """Half-cycles measured a second time with the motion that was fitted to all of them.

    `blocks` are consecutive deflections, in `unit`, in which the half-cycles were detected; they pass once
    for the harmonics of the swing, once for the motion, and again where the run shows position errors: the
    harmonics are then those of the corrected deflections.

    Half-cycles stay as detected where the laws cannot be fitted, which need deflections in rad, and where the
    laws describe the second measurement worse than the first; their uncertainties then contain the difference
    of both. One repetition is enough: a second one shifts them by some hundredths of an uncertainty.
    """
    if pendulum is None or unit is not DeflectionUnit.RAD:
        return Refinement(swings, None)
    swings = with_learned_weights(swings)
    harmonics = _harmonics_of(blocks, swings)
    fit = DecayFit(pendulum, clock_rate, drag.fitted, evidence_of(drag, harmonics), loss_of(settings))
    moved = ""
    try:
        first = fit.of(swings)
        swings, moved = up_to_rest_step(swings, first.evidence.knocks)
        if moved:
            first = fit.of(swings)
        motion = fit.motion(first, swings)
    except DataError:
        return Refinement(swings, None, doubt=moved, harmonics=harmonics)
    watch = CycleWatch(swings, motion)
    turned = [swing.centre + swing.side * swing.amplitude for swing in swings if not swing.flags]
    search = PositionMapSearch(min(turned), max(turned), watch.cycles)
    again = second_measurement(swings, _watched(blocks, watch, search), motion)
    refined = judge_refinement(swings, again, motion, first, fit)
    doubt = "; ".join(filter(None, [moved, refined.doubt]))
    refined = refined._replace(doubt=doubt, harmonics=harmonics)
    found = search.position_map()
    if found is None:
        return refined
    corrected = _without_position_errors(swings, blocks, motion, refined.exact or first, found, fit, drag)
    if corrected is None:
        doubt = (
            "the residuals show errors of position that are fixed on the sensor, but correcting them does "
            "not improve the fit of the laws: they are left uncorrected"
        )
        return refined._replace(doubt="; ".join(filter(None, [refined.doubt, doubt])))
    return corrected._replace(doubt=moved)


def _watched(
    blocks: Iterable[Deflections], watch: CycleWatch, search: PositionMapSearch
) -> Iterator[Deflections]:
    for block in blocks:
        for cycle in watch.update(block):
            search.add(cycle)
        yield block


def _without_position_errors(
    swings: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    motion: KnownMotion,
    before: FitResult,
    found: PositionMap,
    fit: DecayFit,
    drag: FittedDrag,
) -> Refinement | None:
    """Half-cycles measured in deflections without the map's errors; None where the laws describe them worse.

    The motion was fitted to deflections with the errors, so that motion and search for errors are repeated
    without them. The part of the map that the residuals leave open is then adjusted by the fitted law.
    """
    exact, final, again = before, found, swings
    harmonics: SwingHarmonics | None = None
    try:
        for step in range(3):
            if step == 1:
                found = final = _with_remaining_errors(found, blocks, again, motion)
                harmonics = _harmonics_of(map(found.corrected, blocks), again)
                fit = fit._replace(evidence=evidence_of(drag, harmonics))
            if step == 2:
                errors = _position_errors(found, again, exact, fit)
                final = found.adjusted(errors.values, errors.covariance)
            again = second_measurement(swings, map(final.corrected, blocks), motion)
            if not measurement_shift(swings, again).complete:
                return None
            exact = fit.of(again, exact)
            if step < 2:
                motion = known_motion(exact.parameters, fit.pendulum, motion.reference, fit.clock_rate)
        if not describes_as_well(exact, before):
            return None
        left = _position_errors(found, again, exact, fit).of_parameters
    except DataError:
        return None
    return Refinement(again, motion, exact.with_term(FIXED_PATTERN, left), "", final, harmonics)


def _with_remaining_errors(
    found: PositionMap, blocks: Iterable[Deflections], swings: Sequence[HalfCycle], motion: KnownMotion
) -> PositionMap:
    """The map with the errors that the corrected deflections still show.

    It was found at places that the errors themselves had moved, far where the scale is not linear.
    """
    watch = CycleWatch(swings, motion)
    search = PositionMapSearch(*found.limits, watch.cycles)
    for _ in _watched(map(found.corrected, blocks), watch, search):
        pass
    more = search.position_map()
    return found if more is None else found.plus(more)


def _harmonics_of(blocks: Iterable[Deflections], swings: Sequence[HalfCycle]) -> SwingHarmonics:
    watch = HarmonicsMeasurement(swings)
    for block in blocks:
        watch.update(block)
    return watch.harmonics()


def _position_errors(
    found: PositionMap, swings: Sequence[HalfCycle], exact: FitResult, fit: DecayFit
) -> PositionErrorFit:
    """The position errors that the residuals leave open, by the fit."""
    good = [swing for swing in swings if not swing.flags]
    amplitude, centre, side = np.array([(one.amplitude, one.centre, one.side) for one in good]).T
    errors = found.amplitude_errors(amplitude, centre, side)
    return fit_position_errors(LinearisedFit.of(fit.points(swings), fit.pendulum, exact), errors)


def loss_of(settings: FitSettings) -> Loss:
    """The loss function of the settings."""
    return "soft_l1" if settings.robust else "linear"


def fit_decay(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    exact: FitResult | None = None,
    *,
    drag: bool = True,
    evidence: Evidence = NO_EVIDENCE,
    drifts: Mapping[str, float] | None = None,
    seismometer: tuple[Seismogram, bool] | None = None,
) -> tuple[Mapping[str, FitResult], TurningPoints, SeismometerUse | None]:
    """Asymptotic and exact fit of turning points, by name; the points fitted; the use of a seismometer.

    `exact` is an exact fit of these points, if there is one; otherwise `drag` is whether a drag is fitted,
    and `evidence` restrains the fit. `seismometer` is its record on the clock of the points, and whether
    that clock is known; Eqs. 5 and 6 keep the paper's procedure.
    Raises DataError for a decay that cannot be fitted.
    """
    if pendulum is None:
        raise DataError(
            "no [pendulum] in the configuration: state mass_kg and ball_radius_m to fit the contact"
        )
    loss, printed_curvature = loss_of(settings), settings.printed_055
    if exact is None:
        exact = fit_with_knocks(points, pendulum, drag=drag, evidence=evidence, loss=loss)
    exact, points = _without_rolling_shutter(points, pendulum, exact)
    boundary_layer = (
        boundary_layer_drag(LinearisedFit.of(points, pendulum, exact)) if exact.has_drag else None
    )
    asymptotic = fit_asymptotic(
        points,
        pendulum,
        drag=exact.has_drag,
        loss=loss,
        printed_curvature=printed_curvature,
        exact=exact,
    )

    def with_findings(fit: FitResult) -> FitResult:
        # each is estimated about the fit as it ended, so that their order does not matter
        at = LinearisedFit.of(points, pendulum, fit)
        terms = [] if drifts is None else [drift_term(at, drifts)]
        fit = with_discrepancy(at, at.with_terms(*terms))
        # a deviation that smooth errors of the law explain is no change
        explained = 0.0 if fit.discrepancy is None else fit.discrepancy.against_law
        fit = with_changes(at, settings.u_ageing, explained, fit)
        fit = replace(fit, warnings=(*fit.warnings, *domain_warnings(points, pendulum, fit)))
        return fit if boundary_layer is None else with_boundary_layer_drag(fit, boundary_layer)

    use, alone = None, exact
    if seismometer is not None:
        seen, clock_known = seismometer
        found = fit_with_seismometer(points, pendulum, seen, alone, offset_known=clock_known)
        use = found.use
        exact = replace(found.fit, changes=alone.changes)
        exact = exact.with_terms_of(alone, FIXED_PATTERN) if use.used else exact
    exact = with_findings(exact)
    if use is not None and use.used:
        # the factor is that of the reported uncertainties, with all findings
        use = use.with_saved(with_findings(alone), exact)
    asymptotic = asymptotic.with_terms_of(exact, FIXED_PATTERN, DISCREPANCY)
    return {FitMethod.ASYMPTOTIC: asymptotic, FitMethod.EXACT: exact}, points, use


def _without_rolling_shutter(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult
) -> tuple[FitResult, TurningPoints]:
    """The fit and its points without the effect of a rolling shutter that is not stated, if they show one."""
    found = time_alternation(LinearisedFit.of(points, pendulum, exact))
    if not found.seen:
        return exact, points
    at_once = without_alternation(points, found)
    fit = fit_with_knocks(
        at_once, pendulum, drag=exact.has_drag, evidence=exact.evidence, loss=exact.loss, near=exact
    )
    fit = fit.with_terms_of(exact, FIXED_PATTERN)
    return replace(fit, warnings=(*fit.warnings, found.taken_off_text)), at_once
