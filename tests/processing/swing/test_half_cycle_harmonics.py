"""Harmonics measured in a swing: in any blocks, with gaps and a fast mode, and none of a drag or a lever."""

from dataclasses import replace

import numpy as np
import pytest

from processing.contact import law_harmonics
from processing.contact.laws import PAPER
from processing.deflections import Deflections, slow_deflections
from processing.swing import (
    ORDERS,
    HarmonicsMeasurement,
    PieceHarmonics,
    TurningPointDetector,
    half_cycles_of_blocks,
)
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path

RATE = 25.0
PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)
VALUES = {name: getattr(PARAMETERS, name) for name in PAPER.names(drag=True)}
U = 0.005 * ARCSEC
THIRD = ORDERS.index(3)
ODD = [ORDERS.index(order) for order in (3, 5, 7, 9)]


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    """A decay in air on ground at rest, integrated step by step, to 40 arcsec."""
    return driven_path(PARAMETERS, PENDULUM, q=0.0, seed=1, last_arcsec=40.0, frames_per_s=RATE)[2]


def samples_of(y: np.ndarray, x: np.ndarray | None = None) -> Deflections:
    found = slow_deflections(np.rint(np.arange(len(y)) * 1e9 / RATE).astype(np.int64), y, np.full(len(y), U))
    return found if x is None else Deflections(found.times_ns, x, y, found.u_y, found.u_y, found.unit)


def measured(samples: Deflections, block: int = 500) -> PieceHarmonics:
    watch = HarmonicsMeasurement(half_cycles_of_blocks([samples]))
    for begin in range(0, len(samples), block):
        watch.update(samples[begin : begin + block])
    return watch.harmonics()


def test_what_is_measured_is_what_the_law_predicts(path: np.ndarray) -> None:
    """Two ways that share no formula: steps of an integration seen by frames, and a quadrature."""
    found = measured(samples_of(path))
    predicted = -law_harmonics(PAPER, VALUES, PENDULUM, found.amplitude).imag
    ratio = found.sine[:, ODD] / predicted[:, ODD]
    # single harmonics follow where in a frame the turning points lie
    assert np.abs(ratio.mean(axis=0) - 1) == pytest.approx(np.zeros(4), abs=3e-3)
    assert ratio[:, 0] == pytest.approx(np.ones(len(ratio)), abs=2e-3)


def test_blocks_of_any_length_and_half_cycles_that_come_later_are_the_same(path: np.ndarray) -> None:
    samples = samples_of(path)
    whole = measured(samples, len(samples))
    live, detector = HarmonicsMeasurement(), TurningPointDetector()
    for begin in range(0, len(samples), 37):
        block = samples[begin : begin + 37]
        live.update(block)
        live.add(detector.update(block.times_ns, block.y, block.u_y))
    live.add(detector.finish())
    for other in (measured(samples, 41), live.harmonics()):
        np.testing.assert_array_equal(other.amplitude, whole.amplitude)
        np.testing.assert_array_equal(other.harmonics, whole.harmonics)


def test_stated_uncertainties_are_those_of_the_scatter(path: np.ndarray) -> None:
    truth = measured(samples_of(path))
    pulls = []
    for seed in range(3):
        noisy = samples_of(path + U * np.random.default_rng(seed).standard_normal(len(path)))
        found = measured(noisy)
        u = np.sqrt(np.diagonal(found.covariance_sine, axis1=1, axis2=2))
        pulls.append((found.sine - truth.sine)[:, ODD] / u[:, ODD])
    rms = np.sqrt(np.mean(np.square(pulls), axis=(0, 1)))
    # 3 runs of about 20 pieces
    assert rms == pytest.approx(np.ones(4), abs=0.25)


def test_a_piece_with_a_disturbed_half_cycle_is_left_out(path: np.ndarray) -> None:
    samples = samples_of(path)
    half_cycles = half_cycles_of_blocks([samples])
    clean = HarmonicsMeasurement(half_cycles)
    clean.update(samples)
    flagged = [replace(one, flags=2) if one.index == half_cycles[6].index else one for one in half_cycles]
    fewer = HarmonicsMeasurement(flagged)
    fewer.update(samples)
    assert len(fewer.harmonics()) < len(clean.harmonics())


def test_what_the_fast_mode_leaks_is_no_harmonic(path: np.ndarray) -> None:
    """A fast mode of 0.2 arcsec near the fifth harmonic, a twentieth of which is seen along the slow axis."""
    fast = 0.2 * ARCSEC * np.sin(2 * np.pi * np.arange(len(path)) / RATE * 5.07 / PARAMETERS.period0_s)
    noise = U * np.random.default_rng(3).standard_normal((2, len(path)))
    clean, leaking = (
        measured(samples_of(path + noise[0])),
        measured(samples_of(path + 0.05 * fast + noise[0], fast + noise[1])),
    )
    u = np.sqrt(leaking.covariance_sine[:, THIRD, THIRD])
    assert len(clean) == len(leaking)
    assert np.abs((leaking.sine - clean.sine)[:, THIRD] / u).max() < 1.5
