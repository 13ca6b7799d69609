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
    REST_POSITION,
    DecayFit,
    Evidence,
    FitMethod,
    FitResult,
    LinearisedFit,
    PositionErrorFit,
    Refinement,
    Seismogram,
    SeismometerUse,
    TimeAlternation,
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
    with_rest_position,
    without_alternation,
)
from processing.least_squares import Loss
from processing.position_map import PositionMap, PositionMapSearch
from processing.swing import (
    CycleExtractor,
    HalfCycle,
    HarmonicsMeasurement,
    KnownMotion,
    PieceHarmonics,
    TurningPoints,
    with_learned_weights,
)
from rig.analysis.ambient import FREE_DRAG, FittedDrag, evidence_of
from rig.settings import FitSettings


def refined_half_cycles(
    half_cycles: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    clock_rate: float = 1.0,
    drag: FittedDrag = FREE_DRAG,
) -> Refinement:
    """Half-cycles measured a second time with the motion that was fitted to all of them.

    `blocks` are consecutive deflections, in `unit`, in which the half-cycles were detected. They are read
    once for the harmonics of the motion, once for the measurement, and again where the run shows position
    errors: the harmonics are then those of the corrected deflections.

    Half-cycles stay as detected where the laws cannot be fitted, which need deflections in rad. They also
    stay where the laws describe the second measurement worse than the first, and their uncertainties then
    contain the difference of both. One repetition is enough: a second one shifts them by some hundredths of
    an uncertainty.
    """
    if pendulum is None or unit is not DeflectionUnit.RAD:
        return Refinement(half_cycles, None)
    half_cycles = with_learned_weights(half_cycles)
    harmonics = _harmonics_of(blocks, half_cycles)
    fit = DecayFit(pendulum, clock_rate, drag.fitted, evidence_of(drag, harmonics), loss_of(settings))
    remark = ""
    try:
        first = fit.of(half_cycles)
        half_cycles, remark = up_to_rest_step(half_cycles, first.evidence.knocks)
        if remark:
            harmonics = _harmonics_of(blocks, half_cycles)
            fit = fit._replace(evidence=evidence_of(drag, harmonics))
            first = fit.of(half_cycles)
        motion = fit.motion(first, half_cycles)
    except DataError:
        return Refinement(half_cycles, None, doubt=remark, harmonics=harmonics)
    watch = CycleExtractor(half_cycles, motion)
    deflections = [h.centre + h.side * h.amplitude for h in half_cycles if not h.flags]
    search = PositionMapSearch(min(deflections), max(deflections), watch.pending_cycles)
    remeasured = second_measurement(half_cycles, _search_errors(blocks, watch, search), motion)
    refined = judge_refinement(half_cycles, remeasured, motion, first, fit)._replace(harmonics=harmonics)
    doubts = [remark, refined.doubt]
    errors = search.position_map()
    if errors is not None:
        exact = refined.exact or first
        corrected = _without_position_errors(half_cycles, blocks, motion, exact, errors, fit, drag)
        if corrected is not None:
            return corrected._replace(doubt=remark)
        doubts.append(
            "the residuals show errors of position that are fixed on the sensor, but correcting them does "
            "not improve the fit of the laws: they are left uncorrected"
        )
    return refined._replace(doubt="; ".join(filter(None, doubts)))


def _search_errors(
    blocks: Iterable[Deflections], watch: CycleExtractor, search: PositionMapSearch
) -> Iterator[Deflections]:
    for block in blocks:
        for cycle in watch.update(block):
            search.add(cycle)
        yield block


def _without_position_errors(
    half_cycles: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    motion: KnownMotion,
    first_fit: FitResult,
    position_map: PositionMap,
    fit: DecayFit,
    drag: FittedDrag,
) -> Refinement | None:
    """Half-cycles measured in deflections without the map's errors; None where laws describe them worse."""
    exact, final_map, remeasured = first_fit, position_map, half_cycles
    harmonics: PieceHarmonics | None = None
    try:
        # motion and errors were found in deflections with the errors, and are found again without them; then
        # the fitted law adjusts the part of the map that residuals leave open
        for step in range(3):
            if step == 1:
                position_map = final_map = _with_remaining_errors(position_map, blocks, remeasured, motion)
                harmonics = _harmonics_of(map(position_map.corrected, blocks), remeasured)
                fit = fit._replace(evidence=evidence_of(drag, harmonics))
            if step == 2:
                errors = _position_errors(position_map, remeasured, exact, fit)
                final_map = position_map.adjusted(errors.values, errors.covariance)
            remeasured = second_measurement(half_cycles, map(final_map.corrected, blocks), motion)
            if not measurement_shift(half_cycles, remeasured).complete:
                return None
            exact = fit.of(remeasured, exact)
            if step < 2:
                motion = known_motion(exact.parameters, fit.pendulum, motion.reference, fit.clock_rate)
        if not describes_as_well(exact, first_fit):
            return None
        remaining = _position_errors(position_map, remeasured, exact, fit).of_parameters
    except DataError:
        return None
    return Refinement(remeasured, motion, exact.with_term(FIXED_PATTERN, remaining), "", final_map, harmonics)


def _with_remaining_errors(
    position_map: PositionMap,
    blocks: Iterable[Deflections],
    half_cycles: Sequence[HalfCycle],
    motion: KnownMotion,
) -> PositionMap:
    """The map with the errors that corrected deflections still show: errors have shifted its own places."""
    watch = CycleExtractor(half_cycles, motion)
    search = PositionMapSearch(*position_map.limits, watch.pending_cycles)
    for _ in _search_errors(map(position_map.corrected, blocks), watch, search):
        pass
    remaining = search.position_map()
    return position_map if remaining is None else position_map.plus(remaining)


def _harmonics_of(blocks: Iterable[Deflections], half_cycles: Sequence[HalfCycle]) -> PieceHarmonics:
    measurement = HarmonicsMeasurement(half_cycles)
    for block in blocks:
        measurement.update(block)
    return measurement.harmonics()


def _position_errors(
    position_map: PositionMap, half_cycles: Sequence[HalfCycle], exact: FitResult, fit: DecayFit
) -> PositionErrorFit:
    """The position errors that the residuals leave open, by the fit."""
    unflagged = [h for h in half_cycles if not h.flags]
    amplitude, centre, side = np.array([(h.amplitude, h.centre, h.side) for h in unflagged]).T
    errors = position_map.amplitude_errors(amplitude, centre, side)
    return fit_position_errors(LinearisedFit.of(fit.points(half_cycles), fit.pendulum, exact), errors)


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
    seismometer: Seismogram | None = None,
) -> tuple[Mapping[str, FitResult], TurningPoints, SeismometerUse | None]:
    """Asymptotic and exact fit of turning points, by name; the fitted points; the use of a seismometer.

    `exact` is an exact fit of these points, if there is one; otherwise `drag` is whether a drag is fitted,
    and `evidence` restrains the fit. `drifts` are the uncertainties of drifts that are terms of the fit.
    `seismometer` is a record on the clock of the points. Eqs. 5 and 6 keep the paper's procedure. Raises
    DataError for a decay that cannot be fitted.
    """
    if pendulum is None:
        raise DataError(
            "no [pendulum] in the configuration: state mass_kg and ball_radius_m to fit the contact"
        )
    loss = loss_of(settings)
    if exact is None:
        exact = fit_with_knocks(points, pendulum, drag=drag, evidence=evidence, loss=loss)
    exact, points, alternation = _without_alternation(points, pendulum, exact)
    boundary_layer = (
        boundary_layer_drag(LinearisedFit.of(points, pendulum, exact)) if exact.has_drag else None
    )
    asymptotic = fit_asymptotic(points, pendulum, drag=exact.has_drag, loss=loss, exact=exact)

    def with_findings(fit: FitResult) -> FitResult:
        # each finding is estimated about the finished fit, so that their order does not matter
        linearised = LinearisedFit.of(points, pendulum, fit)
        terms = [] if drifts is None else [drift_term(linearised, drifts)]
        fit = with_rest_position(linearised, alternation, linearised.with_terms(*terms))
        fit = with_discrepancy(linearised, fit)
        # a deviation that a model discrepancy explains is no change
        discrepancy = 0.0 if fit.discrepancy is None else fit.discrepancy.against_law
        fit = with_changes(linearised, settings.u_ageing, discrepancy, fit)
        fit = replace(fit, warnings=(*fit.warnings, *domain_warnings(points, pendulum, fit)))
        return fit if boundary_layer is None else with_boundary_layer_drag(fit, boundary_layer)

    use, without_seismometer = None, exact
    if seismometer is not None:
        fitted = fit_with_seismometer(points, pendulum, seismometer, without_seismometer)
        use = fitted.use
        exact = replace(fitted.fit, changes=without_seismometer.changes)
        exact = exact.with_terms_of(without_seismometer, FIXED_PATTERN) if use.used else exact
    exact = with_findings(exact)
    if use is not None and use.used:
        # the factor is that of the reported uncertainties, with all findings
        use = use.with_saved(with_findings(without_seismometer), exact)
    asymptotic = asymptotic.with_terms_of(exact, FIXED_PATTERN, DISCREPANCY, REST_POSITION)
    return {FitMethod.ASYMPTOTIC: asymptotic, FitMethod.EXACT: exact}, points, use


def _without_alternation(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult
) -> tuple[FitResult, TurningPoints, TimeAlternation]:
    """The fit and its points without an alternation of the turning times, and that alternation."""
    alternation = time_alternation(LinearisedFit.of(points, pendulum, exact))
    if not alternation.taken_off_texts:
        return exact, points, alternation
    corrected = without_alternation(points, alternation)
    fit = fit_with_knocks(
        corrected, pendulum, drag=exact.has_drag, evidence=exact.evidence, loss=exact.loss, near=exact
    )
    fit = fit.with_terms_of(exact, FIXED_PATTERN)
    return replace(fit, warnings=(*fit.warnings, *alternation.taken_off_texts)), corrected, alternation
