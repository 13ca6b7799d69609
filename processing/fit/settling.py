"""Fits of half-cycles, and which measurement of them stands: as detected, or on the motion fitted to them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from processing.contact import PendulumOnBall
from processing.deflections import Deflections
from processing.errors import DataError
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact
from processing.fit.remeasure import describes_as_well, known_motion, measured_again, shift_of, widened
from processing.fit.result import FitResult
from processing.least_squares import Loss
from processing.swing import KnownMotion, Swing, TurningPoints, turning_points, with_learned_weights


def points_in_true_time(swings: Sequence[Swing], clock_rate: float) -> TurningPoints:
    """Unflagged swings; `clock_rate` is how many true seconds pass in one of the swings' clock."""
    found = turning_points(swings)
    return replace(found, time_s=found.time_s * clock_rate, u_time_s=found.u_time_s * clock_rate)


class FitOfSwings(NamedTuple):
    """How half-cycles are fitted."""

    pendulum: PendulumOnBall
    clock_rate: float = 1.0
    drag: bool = True
    evidence: Evidence = NO_EVIDENCE
    loss: Loss = "linear"

    def points(self, swings: Sequence[Swing]) -> TurningPoints:
        """The unflagged ones in true time."""
        return points_in_true_time(swings, self.clock_rate)

    def of(self, swings: Sequence[Swing], near: FitResult | None = None) -> FitResult:
        """The exact fit of half-cycles."""
        return fit_exact(
            self.points(swings),
            self.pendulum,
            drag=self.drag,
            evidence=self.evidence,
            loss=self.loss,
            near=near,
        )

    def motion(self, fit: FitResult, swings: Sequence[Swing]) -> KnownMotion:
        """The motion that a fit of half-cycles found, about their first amplitude."""
        reference_rad = next(swing.amplitude for swing in swings if not swing.flags)
        return known_motion(fit.parameters, self.pendulum, reference_rad, self.clock_rate)


class Settlement(NamedTuple):
    """Half-cycles that stand, and the motion on which they were measured again; None: they are as detected.

    `exact` is the fit to those that were measured again, and `doubt` says why they were not.
    """

    swings: Sequence[Swing]
    motion: KnownMotion | None
    exact: FitResult | None = None
    doubt: str = ""


def settlement(
    swings: Sequence[Swing], again: Sequence[Swing], motion: KnownMotion, first: FitResult, fit: FitOfSwings
) -> Settlement:
    """The second measurement if the laws describe it as well as the first."""
    shift = shift_of(swings, again)
    reason = f"only {100 * shift.found:.0f} % of the half-cycles were found again"
    if shift.complete:
        try:
            second = fit.of(again, first)
            if describes_as_well(second, first):
                return Settlement(again, motion, second)
            reason = "the laws would describe them worse"
        except DataError as error:
            reason = str(error)
    doubt = (
        f"the turning points stand as detected ({reason}): measured again on the fitted motion they would "
        f"move by {shift.time:.2g} standard uncertainties in time and {shift.amplitude:.2g} in amplitude; "
        "the uncertainties allow for it"
    )
    return Settlement(widened(swings, shift), None, None, doubt)


def fitted_twice(
    swings: Sequence[Swing],
    blocks: Iterable[Deflections],
    fit: FitOfSwings,
    near: FitResult | None = None,
    before: Sequence[Swing] = (),
) -> tuple[Settlement, FitResult]:
    """Half-cycles fitted as detected, measured again on that fit's motion, and fitted again.

    Parameters
    ----------
    blocks
        The deflections in rad in which they were detected.
    near
        A fit of fewer of them.
    before
        Half-cycles before them, which are fitted with them and not measured again.

    Returns
    -------
    All half-cycles as they stand, and their fit.

    Raises
    ------
    DataError
        They cannot be fitted.
    """
    every = with_learned_weights([*before, *swings])
    first = fit.of(every, near)
    try:
        motion = fit.motion(first, every)
    except DataError:
        return Settlement(every, None), first
    again = [*before, *measured_again(swings, blocks, motion)]
    found = settlement(every, again, motion, first, fit)
    return found, found.exact or fit.of(found.swings, first)
