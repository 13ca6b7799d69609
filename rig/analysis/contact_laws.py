"""Both fits of one decay, from its turning points as they are best known."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall, surface_energy
from processing.errors import DataError
from processing.fit import FitResult, agree, fit_asymptotic, fit_exact, known_motion, measured_again
from processing.least_squares import Loss
from processing.swing import KnownMotion, Swing, TurningPoints, turning_points
from rig.settings import FitSettings


@dataclass(frozen=True, slots=True)
class DecayFits:
    """Both fits of one decay; `problem` says in one line why they are missing."""

    fits: Mapping[str, FitResult]
    surface_energy: Mapping[str, Any]
    problem: str = ""


@dataclass(frozen=True, slots=True)
class SlowSamples:
    """Deflections along the slow axis, arrays of one length; NaN where the spot was lost.

    `clock` is how many true seconds pass in one of theirs.
    """

    times_ns: NDArray[np.int64]
    y_rad: NDArray[np.float64]
    u_y_rad: NDArray[np.float64]
    clock: float = 1.0

    def again(self, swings: Sequence[Swing], motion: KnownMotion) -> list[Swing]:
        """See `measured_again`."""
        return measured_again(swings, self.times_ns, self.y_rad, self.u_y_rad, motion)

    def points(self, swings: Sequence[Swing]) -> TurningPoints:
        """Unflagged swings in true seconds."""
        found = turning_points(swings)
        return replace(found, time_s=found.time_s * self.clock, u_time_s=found.u_time_s * self.clock)


class Settled(NamedTuple):
    """Half-cycles, and the motion on which they were measured again; None: they are as detected."""

    swings: Sequence[Swing]
    motion: KnownMotion | None


def settled_swings(
    swings: Sequence[Swing], samples: SlowSamples, pendulum: PendulumOnBall | None, settings: FitSettings
) -> Settled:
    """The half-cycles as they stand once the motion is known from all of them.

    They stay as they were detected where the laws cannot be fitted, or where the fit does not describe
    the samples.
    """
    as_detected = Settled(swings, None)
    if pendulum is None:
        return as_detected
    points = samples.points(swings)
    try:
        exact = fit_exact(points, pendulum, drag=settings.drag, loss=_loss(settings))
        motion = known_motion(exact.parameters, pendulum, float(points.amplitude[0]), samples.clock)
    except DataError:
        return as_detected
    again = samples.again(swings, motion)
    return Settled(again, motion) if agree(swings, again) else as_detected


def fit_decay(points: TurningPoints, pendulum: PendulumOnBall | None, settings: FitSettings) -> DecayFits:
    """Asymptotic and exact fit of turning points; a decay that cannot be fitted is said, not raised."""
    if pendulum is None:
        return DecayFits(
            {}, {}, "no [pendulum] in the configuration: state mass_kg and ball_radius_m to fit the contact"
        )
    loss = _loss(settings)
    try:
        fits = {
            "asymptotic": fit_asymptotic(
                points, pendulum, drag=settings.drag, loss=loss, printed_curvature=settings.printed_055
            ),
            "exact": fit_exact(points, pendulum, drag=settings.drag, loss=loss),
        }
    except DataError as error:
        return DecayFits({}, {}, str(error))
    energies = {name: _energy(fit, pendulum) for name, fit in fits.items()}
    return DecayFits(fits, {**energies["exact"], "asymptotic": energies["asymptotic"]})


def _loss(settings: FitSettings) -> Loss:
    return "soft_l1" if settings.robust else "linear"


def _energy(fit: FitResult, pendulum: PendulumOnBall) -> dict[str, dict[str, float]]:
    """Both forms of the surface energy; each is proportional to c, and so is its uncertainty."""
    c = fit.estimate("c")
    value = surface_energy(c.value, pendulum)
    unit = surface_energy(1.0, pendulum)
    return {
        "table2": {
            "value": value.table2_j_per_m2,
            "standard_uncertainty": c.standard_uncertainty * unit.table2_j_per_m2,
        },
        "eq2": {
            "value": value.eq2_j_per_m2,
            "standard_uncertainty": c.standard_uncertainty * unit.eq2_j_per_m2,
        },
    }
