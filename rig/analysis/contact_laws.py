"""Both fits of one decay, from its turning points as they are best known."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit import (
    MISFIT,
    NO_EVIDENCE,
    PLACE,
    Evidence,
    FitMethod,
    FitResult,
    Linearised,
    WitnessUse,
    alternation_of,
    domain_warnings,
    drift_term,
    fit_asymptotic,
    fit_exact,
    steeper_drag,
    with_changes,
    with_misfit,
    with_steeper_drag,
    without_alternation,
)
from processing.swing import TurningPoints
from rig.analysis.settled import loss_of
from rig.analysis.witnessed_fits import WitnessedWith
from rig.settings import FitSettings


@dataclass(frozen=True, slots=True)
class DecayFits:
    """Both fits of one decay; `problem` says in one line why they are missing.

    `points` are the turning points that were fitted, where those given were not; None: they were.
    `witness` is what a witness of the ground told.
    """

    fits: Mapping[str, FitResult]
    problem: str = ""
    points: TurningPoints | None = None
    witness: WitnessUse | None = None


def fit_decay(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    exact: FitResult | None = None,
    *,
    drag: bool = True,
    evidence: Evidence = NO_EVIDENCE,
    drifts: Mapping[str, float] | None = None,
    witness: WitnessedWith | None = None,
) -> DecayFits:
    """Asymptotic and exact fit of turning points; a decay that cannot be fitted is said, not raised.

    `exact` is the exact fit of these points where it has been made; otherwise a `drag` is fitted or not, and
    `evidence` restrains the fit. `witness` tells of the ground; Eqs. 5 and 6 keep the paper's procedure.
    """
    if pendulum is None:
        return DecayFits(
            {}, "no [pendulum] in the configuration: state mass_kg and ball_radius_m to fit the contact"
        )
    loss, printed_curvature = loss_of(settings), settings.printed_055
    try:
        if exact is None:
            exact = fit_exact(points, pendulum, drag=drag, evidence=evidence, loss=loss)
        exact, points, alternates = _of_one_moment(points, pendulum, exact)
        steeper = steeper_drag(Linearised.of(points, pendulum, exact)) if exact.has_drag else None
        asymptotic = fit_asymptotic(
            points,
            pendulum,
            drag=exact.has_drag,
            loss=loss,
            printed_curvature=printed_curvature,
            exact=exact,
        )

        def judged(fit: FitResult) -> FitResult:
            fit = _judged(Linearised.of(points, pendulum, fit), drifts, settings)
            fit = replace(fit, warnings=(*fit.warnings, *domain_warnings(points, pendulum, fit)))
            return fit if steeper is None else with_steeper_drag(fit, steeper)

        use, alone = None, exact
        if witness is not None:
            exact, use = witness.fit(points, pendulum, exact)
        exact = judged(exact)
        if use is not None and use.used:
            # of the uncertainties as they are reported
            use = use.beside(judged(alone), exact)
    except DataError as error:
        return DecayFits({}, str(error))
    asymptotic = asymptotic.with_terms_of(exact, PLACE, MISFIT)
    fits: dict[str, FitResult] = {FitMethod.ASYMPTOTIC: asymptotic, FitMethod.EXACT: exact}
    return DecayFits(fits, points=points if alternates else None, witness=use)


def _of_one_moment(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult
) -> tuple[FitResult, TurningPoints, bool]:
    """The fit and its points without row times of a shutter that nobody stated, and whether it has any."""
    found = alternation_of(points, pendulum, exact)
    if not found.seen:
        return exact, points, False
    at_once = without_alternation(points, found)
    fit = fit_exact(
        at_once, pendulum, drag=exact.has_drag, evidence=exact.evidence, loss=exact.loss, near=exact
    )
    fit = fit.with_terms_of(exact, PLACE)
    return replace(fit, warnings=(*fit.warnings, found.taken_off_text)), at_once, True


def _judged(at: Linearised, drifts: Mapping[str, float] | None, settings: FitSettings) -> FitResult:
    """A fit with what it does not describe: drifts, errors of the law, changes during the run.

    Each is found beside the fit as it ended, so that their order does not matter; what smooth errors of the
    law explain is no change.
    """
    terms = [] if drifts is None else [drift_term(at, drifts)]
    fit = with_misfit(at, at.described(*terms))
    explained = 0.0 if fit.misfit is None else fit.misfit.against_law
    return with_changes(at, settings.u_ageing, explained, fit)
