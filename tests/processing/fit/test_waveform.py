"""Harmonics tell laws apart and a drag from friction, and what distorts the swing does not turn either."""

from dataclasses import asdict

import numpy as np
import pytest

from processing.contact import LAWS, PendulumOnBall, law_harmonics
from processing.deflections import slow_deflections
from processing.fit import waveform_of
from processing.swing import ORDERS, HarmonicsMeasurement, PieceHarmonics, half_cycles_of_blocks
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path

RATE, FRAMES = 50.0, 12_000
NOISE = 0.0025 * ARCSEC
PARAMETERS, PENDULUM = paper_pair("glass_k8")
MEMORY = {
    "k": PARAMETERS.b / (1 - PARAMETERS.p),
    "q": PARAMETERS.p,
    "c": 0.0,
    "period0_s": PARAMETERS.period0_s,
}
"""The backbone that loses what b and p lose."""


FALSE_FRIENDS = ("lever", "rows", "leak", "fringes", "strong fringes")


def four_minutes(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Four minutes of the paper's law: times and angles."""
    path = driven_path(PARAMETERS, PENDULUM, q=3e-9, seed=seed, frames_per_s=RATE)[2]
    return np.arange(FRAMES) / RATE, path[:FRAMES]


def measured(seconds: np.ndarray, seen: np.ndarray, seed: int = 1) -> PieceHarmonics:
    """The harmonics of angles that are seen with noise."""
    noisy = seen + NOISE * np.random.default_rng(seed + 2).standard_normal(len(seen))
    samples = slow_deflections(np.rint(1e9 * seconds).astype(np.int64), noisy, np.full(len(seen), NOISE))
    watch = HarmonicsMeasurement(half_cycles_of_blocks([samples]))
    for begin in range(0, len(samples), 700):
        watch.update(samples[begin : begin + 700])
    return watch.harmonics()


def distorted(name: str, seconds: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """The swing as an instrument with this fault shows it."""
    if name == "lever":
        return np.asarray(0.5 * np.tan(2 * angle) + 30 * angle**2)
    if name == "rows":  # 5 ms from one turning point to the other
        return np.interp(seconds + 2.5e-3 * angle / angle.max(), seconds, angle)
    if name == "leak":
        return angle + 0.5 * ARCSEC * np.sin(2 * np.pi * seconds / (PARAMETERS.period0_s / 5.003))
    size = (0.02 if name == "fringes" else 0.2) * ARCSEC
    return angle + size * np.sin(2 * np.pi * angle / (9.7 * ARCSEC) + 0.4)


@pytest.fixture(scope="module")
def swing() -> tuple[np.ndarray, np.ndarray]:
    return four_minutes(1)


def misfits(seconds: np.ndarray, seen: np.ndarray) -> dict[str, float]:
    """chi2 of each law's waveform, over the number of independent harmonics."""
    found = waveform_of(measured(seconds, seen))
    assert found is not None
    laws = {"paper": asdict(PARAMETERS), "masing": MEMORY}
    left = {name: found.residuals(LAWS[name], values, PENDULUM) for name, values in laws.items()}
    return {name: float(one @ one) / len(one) for name, one in left.items()}


def harmonics(
    name: str, values: dict[str, float], pendulum: PendulumOnBall, amplitude_rad: np.ndarray
) -> np.ndarray:
    return law_harmonics(LAWS[name], values, pendulum, amplitude_rad)


def test_harmonics_are_those_of_the_reference() -> None:
    """Third harmonics at 120, 30 and 8 arcsec, in mas; the reference leaves out the change of stiffness."""
    amplitude_rad = np.array([120.0, 30.0, 8.0]) * ARCSEC
    for name, values, expected in (
        ("paper", asdict(PARAMETERS), (55.5, 15.1, 4.4)),
        ("masing", MEMORY, (9.4, 2.5, 0.7)),
    ):
        third = harmonics(name, values, PENDULUM, amplitude_rad)[:, ORDERS.index(3)]
        np.testing.assert_allclose(np.abs(third) / ARCSEC * 1e3, expected, rtol=0.1)


def test_the_waveform_names_the_law(swing: tuple[np.ndarray, np.ndarray]) -> None:
    found = misfits(*swing)
    assert found["paper"] < 2
    assert found["masing"] > 10


@pytest.mark.parametrize("distortion", FALSE_FRIENDS)
def test_false_friends_do_not_turn_it(swing: tuple[np.ndarray, np.ndarray], distortion: str) -> None:
    seconds, angle = swing
    found = misfits(seconds, distorted(distortion, seconds, angle))
    assert found["paper"] < 0.5 * found["masing"]
