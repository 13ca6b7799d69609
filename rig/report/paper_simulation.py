"""Values printed in the paper, and its contact pairs simulated and fitted.

"Phenomenological Laws of Single Point Contact: Pre-Rolling Contact Resistance through Pendulum", Lubricants
2023, 11(2), 88.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from acquisition.simulation.settings import ContactTruth, FastModeTruth, ReleaseTruth, SimulationSettings
from acquisition.simulation.true_path import noisy, true_path, true_turning_points
from processing.contact import MATERIALS, ContactParameters, PendulumOnBall, pendulum_on_ball
from processing.deflections import slow_deflections
from processing.fit import FitMethod, InputQuantity, RigQuantities, fit_asymptotic, fit_exact
from processing.swing import half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD
from rig.analysis import (
    AnalysedRun,
    RunResults,
    Series,
    StoredTurningPoints,
    fitted_series,
    refined_half_cycles,
    with_contact,
)
from rig.settings import FitSettings

MASS_KG: Final = 0.406
BALL_RADIUS_M: Final = 6.05e-3
BALL: Final = "steel"
PARAMETERS: Final = {"b": "b", "p": "p", "c": "c", "n": "n", "period0_s": "T₀", "gamma_pa": "γ"}
B_EXPONENT: Final = -4
"""Power of ten of b, which Table 2 omits: with this one a run lasts as long as stated in the paper."""
NOISE_ARCSEC: Final = 0.0027
"""Standard uncertainty of one tracked position of the demonstration, 0.0055 px at an arm of 1 m."""
_PERIOD_RATIO: Final = 5.0
_FIRST_ARCSEC, _LAST_ARCSEC = 124.0, 2.0
_RUNS: Final = 3


@dataclass(frozen=True, slots=True)
class PrintedPair:
    """Values of one contact pair in Tables 1 to 3."""

    flat_name: str
    flat: str
    contact_radius_um: float
    depth_um: float
    contact_angle_arcmin: float
    b_printed: float
    """b as Table 2 prints it, without its power of ten."""
    p: float
    c: float
    surface_energy_j_per_m2: float
    arae_decay: float
    n: float
    period0_s: float
    gamma_pa: float
    arae_period: float

    @property
    def name(self) -> str:
        return f"{BALL} on {self.flat_name}"

    @property
    def pendulum(self) -> PendulumOnBall:
        return pendulum_on_ball(MASS_KG, BALL_RADIUS_M, MATERIALS[BALL], MATERIALS[self.flat])

    @property
    def parameters(self) -> ContactParameters:
        b = self.b_printed * 10.0**B_EXPONENT
        return ContactParameters(b, self.p, self.c, self.n, self.period0_s, self.gamma_pa)

    @property
    def settings(self) -> SimulationSettings:
        """Settings of the simulated rig with this contact, on ground at rest."""
        flat, ball = MATERIALS[self.flat], MATERIALS[BALL]
        truth = self.parameters
        return SimulationSettings(
            contact=ContactTruth(
                **{name: getattr(truth, name) for name in PARAMETERS},
                mass_kg=MASS_KG,
                ball_radius_m=BALL_RADIUS_M,
                **{f"ball_{name}": value for name, value in asdict(ball).items() if name in _ELASTIC},
                **{f"flat_{name}": value for name, value in asdict(flat).items() if name in _ELASTIC},
            ),
            fast=FastModeTruth(period_ratio=_PERIOD_RATIO),
            release=ReleaseTruth(amplitude_arcsec=_FIRST_ARCSEC),
        )


_ELASTIC: Final = ("youngs_modulus_pa", "poisson_ratio")
PAIRS: Final = (
    PrintedPair(
        "K8 glass", "glass_k8", 66, 0.7, 38,
        37.330, 0.944, 10.510e-9, 28.900e-3, 0.008, 0.092, 4.071, 28.97e6, 0.002,
    ),
    PrintedPair(
        "silicon", "silicon", 59, 0.6, 34,
        7.060, 0.815, 3.840e-9, 13.200e-3, 0.026, 0.552, 4.072, 290.69e6, 0.002,
    ),
    PrintedPair(
        "steel", "steel", 54, 0.5, 31,
        7.961, 0.850, 6.601e-9, 27.300e-3, 0.035, 0.461, 4.049, 95.46e6, 0.004,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PairSeries:
    """One contact pair, simulated and analysed."""

    pair: PrintedPair
    run: RunResults
    """The first of the runs of `series`."""
    series: Series


def simulate_pair(pair: PrintedPair, seed: int) -> PairSeries:
    """Simulate three runs of a pair, with different noise, make both fits of each, and combine them."""
    pendulum, settings = pair.pendulum, pair.settings
    end_s = float(true_turning_points(settings, _LAST_ARCSEC).time_s[-1])
    motion = true_path(settings, end_s + 0.6 * pair.period0_s)
    noise_rad = NOISE_ARCSEC * ARCSEC_RAD
    rig = RigQuantities(
        InputQuantity(MASS_KG), InputQuantity(BALL_RADIUS_M), MATERIALS[BALL], MATERIALS[pair.flat],
        InputQuantity(1.0), InputQuantity(1.0),
    )  # fmt: skip
    runs = []
    for number in range(_RUNS):
        measured = noisy(motion, noise_rad, noise_rad, seed + number)
        deflections = slow_deflections(measured.times_ns, measured.y_rad, noise_rad)
        half_cycles = half_cycles_of_blocks([deflections])
        refined = refined_half_cycles(half_cycles, [deflections], deflections.unit, pendulum, FitSettings())
        points = turning_points(refined.half_cycles)
        exact = refined.exact or fit_exact(points, pendulum)
        run = AnalysedRun(
            path=Path(),
            record="",
            turning_points=StoredTurningPoints.of(points, refined.half_cycles, deflections.unit, 1.0),
            fitted={
                FitMethod.ASYMPTOTIC: fit_asymptotic(points, pendulum, exact=exact),
                FitMethod.EXACT: exact,
            },
            rig=rig,
        )
        runs.append(with_contact(run, pendulum))
    series = fitted_series(runs)
    assert series is not None  # of several fitted runs
    return PairSeries(pair, runs[0], series)
