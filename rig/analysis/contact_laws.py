"""Both fits of one decay, from its turning points as they are best known."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from processing.contact import PendulumOnBall, surface_energy
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import (
    FitMethod,
    FitResult,
    describes_as_well,
    fit_asymptotic,
    fit_exact,
    known_motion,
    measured_again,
    shift_of,
    widened,
)
from processing.least_squares import Loss
from processing.swing import KnownMotion, Swing, TurningPoints, turning_points
from rig.analysis.contact_results import SurfaceEnergies, SurfaceEnergy
from rig.settings import FitSettings


@dataclass(frozen=True, slots=True)
class DecayFits:
    """Both fits of one decay; `problem` says in one line why they are missing."""

    fits: Mapping[str, FitResult]
    surface_energy: SurfaceEnergies | None
    problem: str = ""


def points_in_true_time(swings: Sequence[Swing], clock_rate: float) -> TurningPoints:
    """Unflagged swings; `clock_rate` is how many true seconds pass in one of the swings' clock."""
    found = turning_points(swings)
    return replace(found, time_s=found.time_s * clock_rate, u_time_s=found.u_time_s * clock_rate)


class Settled(NamedTuple):
    """Half-cycles, and the motion on which they were measured again; None: they are as detected.

    `exact` is the fit to them, where one was made, and `doubt` says why they were not measured again.
    """

    swings: Sequence[Swing]
    motion: KnownMotion | None
    exact: FitResult | None = None
    doubt: str = ""


def settled_swings(
    swings: Sequence[Swing],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    clock_rate: float = 1.0,
) -> Settled:
    """The half-cycles as they stand once the motion is known from all of them.

    `blocks` are consecutive deflections, in `unit`, in which the swings were detected.

    They stay as they were detected where the laws cannot be fitted, which need deflections in rad, and where
    the laws describe the second measurement worse than the first; their uncertainties then hold by how much
    the two differ. One repetition is enough: a second one shifts them by some hundredths of an uncertainty.
    """
    if pendulum is None or unit is not DeflectionUnit.RAD:
        return Settled(swings, None)
    points = points_in_true_time(swings, clock_rate)
    try:
        first = fit_exact(points, pendulum, drag=settings.drag, loss=_loss(settings))
        motion = known_motion(first.parameters, pendulum, float(points.amplitude[0]), clock_rate)
    except DataError:
        return Settled(swings, None)
    again = measured_again(swings, blocks, motion)
    shift = shift_of(swings, again)
    reason = f"only {shift.found:.0%} of the half-cycles were found again"
    if shift.complete:
        try:
            second = fit_exact(
                points_in_true_time(again, clock_rate),
                pendulum,
                drag=settings.drag,
                loss=_loss(settings),
                near=first,
            )
            if describes_as_well(second, first):
                return Settled(again, motion, second)
            reason = "the laws would describe them worse"
        except DataError as error:
            reason = str(error)
    doubt = (
        f"the turning points stand as detected ({reason}): measured again on the fitted motion they would "
        f"move by {shift.time:.2g} standard uncertainties in time and {shift.amplitude:.2g} in amplitude; "
        "the uncertainties hold that"
    )
    return Settled(widened(swings, shift), None, None, doubt)


def fit_decay(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    settings: FitSettings,
    exact: FitResult | None = None,
) -> DecayFits:
    """Asymptotic and exact fit of turning points; a decay that cannot be fitted is said, not raised.

    `exact` is the exact fit of these points where it has been made.
    """
    if pendulum is None:
        return DecayFits(
            {}, None, "no [pendulum] in the configuration: state mass_kg and ball_radius_m to fit the contact"
        )
    loss, printed_curvature = _loss(settings), settings.printed_055
    try:
        if exact is None:
            exact = fit_exact(points, pendulum, drag=settings.drag, loss=loss)
        asymptotic = fit_asymptotic(
            points,
            pendulum,
            drag=settings.drag,
            loss=loss,
            printed_curvature=printed_curvature,
            exact=exact,
        )
    except DataError as error:
        return DecayFits({}, None, str(error))
    fits: dict[str, FitResult] = {FitMethod.ASYMPTOTIC: asymptotic, FitMethod.EXACT: exact}
    return DecayFits(fits, surface_energies(fits, pendulum))


def _loss(settings: FitSettings) -> Loss:
    return "soft_l1" if settings.robust else "linear"


def surface_energies(fits: Mapping[str, FitResult], pendulum: PendulumOnBall) -> SurfaceEnergies:
    """Surface energy after every fit."""
    energies = {name: surface_energy_of(fit.estimate("c"), pendulum) for name, fit in fits.items()}
    default = energies.pop(FitMethod.EXACT)
    return SurfaceEnergies(default.table2, default.eq2, energies)


def surface_energy_of(c: Estimate, pendulum: PendulumOnBall) -> SurfaceEnergy:
    """Both forms of the surface energy; each is proportional to c, and so is its uncertainty."""
    value, u = surface_energy(c.value, pendulum), surface_energy(c.standard_uncertainty, pendulum)
    return SurfaceEnergy(
        Estimate(value.table2_j_per_m2, u.table2_j_per_m2), Estimate(value.eq2_j_per_m2, u.eq2_j_per_m2)
    )
