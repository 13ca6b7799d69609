"""Harmonics tell laws apart and a drag from friction, and what distorts the swing does not turn either."""

from dataclasses import asdict

import numpy as np
import pytest

from processing.contact import LAWS, law_harmonics
from processing.fit import waveform_of
from processing.swing import ORDERS
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.processing.fit.frames import points_and_harmonics, seen_in_frames

RATE, FRAMES = 50.0, 12_000
NOISE = 0.0025 * ARCSEC
PARAMETERS, PENDULUM = paper_pair("glass_k8")
Swing = tuple[np.ndarray, np.ndarray]
MEMORY = {
    "k": PARAMETERS.b / (1 - PARAMETERS.p),
    "q": PARAMETERS.p,
    "c": 0.0,
    "period0_s": PARAMETERS.period0_s,
}
"""The backbone that loses what b and p lose."""


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
def swing() -> Swing:
    """Four minutes of the paper's law: times and angles."""
    path = driven_path(PARAMETERS, PENDULUM, q=3e-9, seed=1, frames_per_s=RATE)[2]
    return np.arange(FRAMES) / RATE, path[:FRAMES]


def misfits(seen: np.ndarray) -> dict[str, float]:
    """chi2 of each law's waveform, over the number of independent harmonics."""
    found = waveform_of(points_and_harmonics(seen_in_frames(seen, NOISE, 3, RATE))[1])
    laws = {"paper": asdict(PARAMETERS), "masing": MEMORY}
    left = {name: found.residuals(LAWS[name], values, PENDULUM) for name, values in laws.items()}
    return {name: float(one @ one) / len(one) for name, one in left.items()}


def test_harmonics_are_those_of_the_reference() -> None:
    """Third harmonics at 120, 30 and 8 arcsec, in mas; the reference leaves out the change of stiffness."""
    amplitude_rad = np.array([120.0, 30.0, 8.0]) * ARCSEC
    for name, values, expected in (
        ("paper", asdict(PARAMETERS), (55.5, 15.1, 4.4)),
        ("masing", MEMORY, (9.4, 2.5, 0.7)),
    ):
        third = law_harmonics(LAWS[name], values, PENDULUM, amplitude_rad)[:, ORDERS.index(3)]
        np.testing.assert_allclose(np.abs(third) / ARCSEC * 1e3, expected, rtol=0.1)


def test_the_waveform_names_the_law(swing: Swing) -> None:
    found = misfits(swing[1])
    assert found["paper"] < 2
    assert found["masing"] > 10


@pytest.mark.parametrize("distortion", ["lever", "rows", "leak", "fringes", "strong fringes"])
def test_false_friends_do_not_turn_it(swing: Swing, distortion: str) -> None:
    seconds, angle = swing
    found = misfits(distorted(distortion, seconds, angle))
    assert found["paper"] < 0.5 * found["masing"]
