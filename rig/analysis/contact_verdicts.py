"""What stands behind a fit's numbers: drag, identifiability, budget, Monte Carlo, contact, work."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.axes import Axes
from processing.angle import ARCSEC_RAD
from processing.contact import HertzContact, PendulumOnBall, cycle_work, hertz_contact
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import (
    Budget,
    Determination,
    DragVerdict,
    FitResult,
    Propagated,
    Quantity,
    RigQuantities,
    budgets,
    drag_verdict,
    draw_fitted,
    fitted_contact,
    identifiability,
    monte_carlo,
    reported_quantities,
    strong_correlations,
    work_per_cycle_j,
)
from processing.swing import TurningPoints
from rig.instrument import balls, material
from rig.settings import Configuration, TimebaseSettings

DRAWS = 10_000
TABLE4_AMPLITUDE_ARCSEC = 3.1
"""Amplitude at which the paper's Table 4 draws its loops."""


class WorkPerCycle(NamedTuple):
    """Work of one cycle in J: 4A, its adhesive part 4A_t, that of a linear drag beside them."""

    amplitude_arcsec: float
    dissipated_j: Estimate
    adhesive_j: Estimate
    drag_j: float


@dataclass(frozen=True)
class Evaluation:
    """Verdicts and uncertainties of one run's exact fit.

    `rig` and `contact` are None where the contact radius is stated instead of calculated after
    Hertz; there is no budget and no Monte Carlo then, and `notes` says so.
    """

    pendulum: PendulumOnBall
    rig: RigQuantities | None
    contact: HertzContact | None
    drag: DragVerdict | None
    determinations: Sequence[Determination]
    strong_correlations: Sequence[tuple[str, str, float]]
    budgets: Mapping[str, Budget]
    propagated: Mapping[str, Propagated]
    seed: int
    work: Sequence[WorkPerCycle]
    notes: Sequence[str]

    def lines(self) -> list[str]:
        """The essentials, a line each, for a terminal."""
        found = [self.drag.text] if self.drag else []
        found += [item.text for item in self.determinations if item.verdict != "determined"]
        if self.strong_correlations:
            pairs = ", ".join(f"{a}/{b} {value:+.3f}" for a, b, value in self.strong_correlations[:3])
            found.append(f"hardly told apart (correlation): {pairs}")
        return [*found, *self.notes]


def rig_quantities(config: Configuration, fast_ratio: float = 0.0) -> RigQuantities | None:
    """The apparatus with its standard uncertainties; None where the contact radius is not after Hertz.

    `fast_ratio` is the fast mode's amplitude over the slow one's (see `RigQuantities`).
    """
    pendulum, lever = config.pendulum, config.lever
    if pendulum is None or lever is None or pendulum.contact_radius_m is not None:
        return None
    timebase = config.timebase or TimebaseSettings()
    axes = config.axes or Axes()
    return RigQuantities(
        mass_kg=Quantity(pendulum.mass_kg, pendulum.u_mass_kg),
        ball_radius_m=Quantity(pendulum.ball_radius_m, pendulum.u_ball_radius_m),
        ball=material(config, pendulum.ball_material),
        flat=material(config, pendulum.flat_material),
        arm_m=Quantity(lever.arm_m, lever.u_arm_m),
        pitch_m=Quantity(lever.pixel_pitch_m, lever.u_pixel_pitch_m),
        gravity_m_per_s2=Quantity(pendulum.gravity_m_per_s2, pendulum.u_gravity_m_per_s2),
        clock=Quantity(timebase.camera_rate, timebase.u_camera_rate),
        slow_angle_rad=Quantity(axes.slow_angle_rad, axes.u_slow_angle_rad),
        non_orthogonality_rad=Quantity(axes.non_orthogonality_rad, axes.u_non_orthogonality_rad),
        fast_ratio=fast_ratio,
        balls=balls(config),
    )


def fast_ratio(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Fast over slow motion (r.m.s. about the median, NaN left out); 0 where there is nothing to compare."""
    spread_x, spread_y = (
        float(np.sqrt(np.mean((good - np.median(good)) ** 2))) if len(good) else 0.0
        for good in (values[np.isfinite(values)] for values in (x, y))
    )
    return spread_x / spread_y if spread_y > 0 else 0.0


def contact_of(rig: RigQuantities) -> HertzContact:
    """Hertz contact with the uncertainties of load, radius and elastic constants."""
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
    points: TurningPoints,
    pendulum: PendulumOnBall,
    exact: FitResult,
    rig: RigQuantities | None,
    seed: int,
) -> Evaluation:
    """Everything that is said about an exact fit beyond its numbers.

    Parameters
    ----------
    seed
        Of the Monte Carlo draws, so that the same record gives the same intervals.

    Notes
    -----
    What cannot be had (a comparison fit that does not converge, a parameter that the data leave
    open) is said in `notes`; nothing is raised for it.
    """
    notes: list[str] = []
    drag: DragVerdict | None = None
    determinations: Sequence[Determination] = ()
    try:
        drag = drag_verdict(points, pendulum, loss=exact.loss, without=None if exact.has_drag else exact)
    except DataError as error:
        notes.append(f"no drag verdict: {error}")
    try:
        determinations = identifiability(points, pendulum, exact)
    except DataError as error:
        notes.append(f"no identifiability verdict: {error}")
    if drag is not None and drag.significant and not exact.has_drag:
        notes.append("the reported fit leaves that drag out; fit.drag = true reports the fit with it")
    tables: Mapping[str, Budget] = {}
    propagated: Mapping[str, Propagated] = {}
    if rig is None:
        notes.append("no uncertainty budget: the contact radius is stated, not calculated after Hertz")
    else:
        tables = budgets(fitted_contact(exact), rig)
        if all(quantity.u == 0 for quantity in rig.inputs().values()):
            notes.append(
                "the configuration states no type B uncertainty (u_mass_kg, u_ball_radius_m, u_arm_m, "
                "u_youngs_modulus_pa, ...): budgets hold the scatter of the swings alone"
            )
        try:
            rng = np.random.default_rng(seed)
            propagated = monte_carlo(fitted_contact(exact), rig, rng, draws=DRAWS, against=tables)
        except DataError as error:
            notes.append(f"no Monte Carlo: {error}")
    return Evaluation(
        pendulum=pendulum,
        rig=rig,
        contact=contact_of(rig) if rig is not None else None,
        drag=drag,
        determinations=determinations,
        strong_correlations=strong_correlations(exact),
        budgets=tables,
        propagated=propagated,
        seed=seed,
        work=[
            _work(amplitude, exact, pendulum, rig if propagated else None, seed)
            for amplitude in (TABLE4_AMPLITUDE_ARCSEC, float(points.amplitude[0]) / ARCSEC_RAD)
        ],
        notes=notes,
    )


def _work(
    amplitude_arcsec: float, exact: FitResult, pendulum: PendulumOnBall, rig: RigQuantities | None, seed: int
) -> WorkPerCycle:
    """Work per cycle with the scatter that fit and apparatus leave it; NaN uncertainty where unknown."""
    amplitude_rad = amplitude_arcsec * ARCSEC_RAD
    work = cycle_work(amplitude_rad, exact.parameters, pendulum)
    u_dissipated = u_adhesive = math.nan
    if rig is not None:
        rng = np.random.default_rng(seed)
        found = fitted_contact(exact)
        values = draw_fitted(found, rng, DRAWS)
        inputs = {
            name: quantity.value + quantity.u * rng.standard_normal(DRAWS)
            for name, quantity in rig.inputs().items()
        }
        reported = reported_quantities(found, values, inputs, rig)
        without_drag = {name: sample for name, sample in reported.items() if name != "drag_s"}
        moment = inputs["mass_kg"] * inputs["gravity_m_per_s2"] * inputs["ball_radius_m"]
        u_dissipated = float(np.std(work_per_cycle_j(amplitude_rad, without_drag, inputs), ddof=1))
        u_adhesive = float(np.std(4 * moment * reported["c"] * amplitude_rad, ddof=1))
    return WorkPerCycle(
        amplitude_arcsec,
        Estimate(work.dissipated_j, u_dissipated),
        Estimate(work.adhesive_j, u_adhesive),
        work.drag_j,
    )
