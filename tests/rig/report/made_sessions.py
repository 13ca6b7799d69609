"""Sessions of made-up runs, as `rig fit` leaves their results."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from processing.ambient import AmbientConditions
from processing.contact import PendulumOnBall, surface_energy
from processing.estimate import Estimate
from processing.fit import Budget, FitMethod
from processing.fit.uncertainty import BudgetSource
from processing.units import ARCSEC_RAD
from rig.analysis import Correlation, Fit, RunResults, SessionResults, StoredTurningPoints, write_results

NAMES = ("b", "p", "c", "n", "period0_s", "gamma_pa")
GLASS = np.array([3.733e-3, 0.944, 1.051e-8, 0.092, 4.071, 28.97e6])
RELATIVE_U = np.array([0.005, 0.001, 0.1, 0.02, 1e-4, 0.01])
PENDULUM = PendulumOnBall(0.406, 6.05e-3, 6.6e-5)
ENERGY_OVER_C = surface_energy(Estimate(1.0, 0.0), PENDULUM).table2.value
"""Of the surface energy in J/m2 to c."""
U_MASS_KG, U_ARM_M = 2e-4, 1e-3


def run(
    number: int,
    truth: Sequence[float] | np.ndarray,
    rng: np.random.Generator,
    *,
    humidity_percent: float = 45.0,
    sha256: str = "",
) -> RunResults:
    """A run that measures these values with its u, by an arm and a mass that are not well known."""
    values = np.array(truth)
    u = RELATIVE_U * values
    correlation = np.eye(len(NAMES))
    correlation[0, 1] = correlation[1, 0] = 0.6
    seen = values + np.linalg.cholesky(correlation * np.outer(u, u)) @ rng.normal(size=len(NAMES))
    fit = Fit(
        law="paper",
        parameters={
            **{name: Estimate(float(v), float(s)) for name, v, s in zip(NAMES, seen, u, strict=True)},
            "initial_amplitude_rad": Estimate(124 * ARCSEC_RAD, 1e-9),
        },
        correlation=Correlation(NAMES, tuple(map(tuple, correlation.tolist()))),
    )
    budget = {
        name: _budget(name, float(v), float(s), arm=-1.0 if name == "c" else 0.0, mass=0.0)
        for name, v, s in zip(NAMES, seen, u, strict=True)
    }
    energy = float(ENERGY_OVER_C * seen[2])
    key = "surface_energy_table2_j_per_m2"
    budget[key] = _budget(key, energy, float(RELATIVE_U[2] * energy), arm=-1.0, mass=0.33)
    time_s = np.arange(0, 1200, 20.0)
    return RunResults(
        record=f"run-{number}.mcap",
        sha256=sha256 or f"{rng.integers(2**62):064x}",
        half_cycles=len(time_s),
        fits={FitMethod.EXACT: fit},
        pendulum=PENDULUM,
        budget=budget,
        ambient=AmbientConditions(temperature_c=20.0, humidity_percent=humidity_percent),
        turning_points=StoredTurningPoints(
            index=np.arange(len(time_s)), time_s=time_s, u_time_s=time_s * 0 + 1e-3,
            amplitude=np.linspace(6e-4, 1e-5, len(time_s)), u_amplitude=time_s * 0 + 1e-8,
        ),
    )  # fmt: skip


def _budget(name: str, value: float, u: float, *, arm: float, mass: float) -> Budget:
    """With slopes that are relative ones by arm (m) and mass (0.4 kg)."""
    sources = [BudgetSource("swings", "A", u, np.nan, u, 1.0)]
    for source, slope, u_source in (
        ("arm_m", arm * value, U_ARM_M),
        ("mass_kg", mass * value / 0.406, U_MASS_KG),
    ):
        if slope:
            sources.append(BudgetSource(source, "B", u_source, slope, abs(slope * u_source), 0.0))
    return Budget(
        value=value, standard_uncertainty=u,
        sources=tuple(sources),
    )  # fmt: skip


def session(folder: Path, runs: Sequence[RunResults]) -> Path:
    """A folder with the results of these runs."""
    folder.mkdir(parents=True)
    write_results(folder / "results.json", SessionResults(runs=tuple(runs)))
    return folder


def humid_campaign(
    parent: Path, *, slope: float = -0.02, seed: int = 1, bad: bool = False, count: int = 6
) -> list[Path]:
    """Two sessions of glass; ln c changes by `slope` with every percent of humidity."""
    rng = np.random.default_rng(seed)
    folders = []
    for name in ("monday", "tuesday"):
        runs = []
        for number in range(1, count + 1):
            humidity = float(rng.uniform(25, 65))
            truth = GLASS.copy()
            truth[2] *= np.exp(slope * (humidity - 45) + 0.03 * rng.normal())
            if bad and name == "tuesday" and number == 2:
                truth[0] *= 1.4
            runs.append(run(number, truth, rng, humidity_percent=humidity))
        folders.append(session(parent / name, runs))
    return folders
