"""Simulated series of the paper's contact pairs, from the equations of motion to fits."""

from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.simulation.settings import (
    ContactTruth,
    FastModeTruth,
    ReleaseTruth,
    SimulationSettings,
)
from acquisition.simulation.true_path import noisy, true_path, true_turning_points
from processing.angle import ARCSEC_RAD
from processing.contact import MATERIALS, ContactParameters, PendulumOnBall, pendulum_on_ball
from processing.deflections import slow_deflections
from processing.fit import FitMethod, FitResult, InputQuantity, RigQuantities, fit_asymptotic, fit_exact
from processing.swing import TurningPoints, swings_of_blocks, turning_points
from processing.ticks import seconds
from rig.analysis import (
    RunResults,
    Series,
    combined_series,
    evaluate,
    fit_results,
    settled_swings,
)
from rig.paper.printed import (
    BALL,
    BALL_RADIUS_M,
    FINAL_AMPLITUDE_ARCSEC,
    INITIAL_AMPLITUDE_ARCSEC,
    MASS_KG,
    PERIOD_RATIO,
    RUNS,
    PrintedPair,
)
from rig.report import ShownTrajectory, ShownUnit
from rig.settings import FitSettings

NOISE_ARCSEC = 0.0027
"""Standard uncertainty of one tracked position of the demonstration, 0.0055 px at an arm of 1 m."""


@dataclass(frozen=True)
class PairSeries:
    """One contact pair, simulated and analysed.

    `points` are the turning points of all runs; `motion` and `run` belong to the first run, `series` to all.
    """

    pair: PrintedPair
    parameters: ContactParameters
    pendulum: PendulumOnBall
    points: Sequence[TurningPoints]
    motion: ShownTrajectory
    run: RunResults
    series: Series


def printed_parameters(pair: PrintedPair, b_exponent: int) -> ContactParameters:
    """The pair's parameters, b with its missing power of ten."""
    return ContactParameters(
        pair.b_printed * 10.0**b_exponent, pair.p, pair.c, pair.n, pair.period0_s, pair.gamma_pa
    )


def simulate_pair(pair: PrintedPair, b_exponent: int, seed: int) -> PairSeries:
    """Simulate three runs of one pair, detect half-cycles, make both fits, and combine the runs.

    The runs differ only in their noise.
    """
    truth = printed_parameters(pair, b_exponent)
    pendulum = pendulum_on_ball(MASS_KG, BALL_RADIUS_M, MATERIALS[BALL], MATERIALS[pair.flat])
    settings = pair_settings(pair, truth)
    end_s = float(true_turning_points(settings, FINAL_AMPLITUDE_ARCSEC).time_s[-1])
    motion = true_path(settings, end_s + 0.6 * truth.period0_s)
    noise_rad = NOISE_ARCSEC * ARCSEC_RAD
    runs, exact = [], []
    shown: ShownTrajectory | None = None
    for number in range(RUNS):
        seen = noisy(motion, noise_rad, noise_rad, seed + number)
        deflections = slow_deflections(seen.times_ns, seen.y_rad, noise_rad)
        swings = swings_of_blocks([deflections])
        settled = settled_swings(swings, [deflections], deflections.unit, pendulum, FitSettings())
        runs.append(turning_points(settled.swings))
        exact.append(settled.exact or fit_exact(runs[-1], pendulum))
        if shown is None:
            first_ns = next(swing.turn_time_ns for swing in swings if swing.flags == 0)
            time_s = seconds(seen.times_ns - first_ns)
            shown = ShownTrajectory(
                time_s, seen.x_rad / ARCSEC_RAD, seen.y_rad / ARCSEC_RAD, ShownUnit("arcsec", ARCSEC_RAD)
            )
    assert shown is not None
    fits: dict[str, list[FitResult]] = {
        FitMethod.ASYMPTOTIC: [
            fit_asymptotic(points, pendulum, exact=fit) for points, fit in zip(runs, exact, strict=True)
        ],
        FitMethod.EXACT: exact,
    }
    rig = RigQuantities(
        InputQuantity(MASS_KG), InputQuantity(BALL_RADIUS_M), MATERIALS[BALL], MATERIALS[pair.flat],
        InputQuantity(1.0), InputQuantity(1.0),
    )  # fmt: skip
    first = {name: found[0] for name, found in fits.items()}
    run = RunResults(
        record="",
        fits={name: fit_results(fit) for name, fit in first.items()},
    )
    run = evaluate(run, runs[0], pendulum, first[FitMethod.EXACT], rig)
    return PairSeries(pair, truth, pendulum, runs, shown, run, combined_series(fits, runs, pendulum, rig))


def pair_settings(pair: PrintedPair, truth: ContactParameters) -> SimulationSettings:
    """The simulated rig with one pair's contact, on ground that stands still."""
    flat, ball = MATERIALS[pair.flat], MATERIALS[BALL]
    return SimulationSettings(
        contact=ContactTruth(
            b=truth.b,
            p=truth.p,
            c=truth.c,
            n=truth.n,
            period0_s=truth.period0_s,
            gamma_pa=truth.gamma_pa,
            mass_kg=MASS_KG,
            ball_radius_m=BALL_RADIUS_M,
            ball_youngs_modulus_pa=ball.youngs_modulus_pa,
            ball_poisson_ratio=ball.poisson_ratio,
            flat_youngs_modulus_pa=flat.youngs_modulus_pa,
            flat_poisson_ratio=flat.poisson_ratio,
        ),
        fast=FastModeTruth(period_ratio=PERIOD_RATIO),
        release=ReleaseTruth(amplitude_arcsec=INITIAL_AMPLITUDE_ARCSEC),
    )
