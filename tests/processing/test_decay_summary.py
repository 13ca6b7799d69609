"""Whether a decay has one decrement is judged by the uncertainties of its ends."""

import numpy as np
import pytest

from processing.decay_summary import summarise_decay
from processing.swing import TurningPoints


def decay(log_decrement: float, bend: float, scatter: float, seed: int, count: int = 60) -> TurningPoints:
    """Turning points whose amplitudes scatter `scatter` times as much as is stated of them; the decrement
    falls by `bend` of itself from first to last.
    """
    rng = np.random.default_rng(seed)
    index = np.arange(count)
    fallen = 0.5 * log_decrement * (index - 0.5 * bend * index**2 / count)
    relative, u_time_s = 1e-3, 1e-4
    amplitude = 50.0 * np.exp(-fallen) * (1.0 + scatter * relative * rng.standard_normal(count))
    return TurningPoints(
        index,
        index + u_time_s * rng.standard_normal(count),
        np.full(count, u_time_s),
        amplitude,
        relative * amplitude,
    )


@pytest.mark.parametrize("seed", range(5))
def test_scatter_that_is_larger_than_stated_is_no_change(seed: int) -> None:
    found = summarise_decay(decay(0.05, 0.0, 3.0, seed))
    assert found.decrement.chi2_per_dof > 4.0
    assert not found.decrement.changes
    quality = found.quality_factor
    assert abs(quality.value - np.pi / 0.05) < 4 * quality.standard_uncertainty


@pytest.mark.parametrize("scatter", [1.0, 3.0])
def test_ends_that_disagree_are_a_change(scatter: float) -> None:
    found = summarise_decay(decay(0.05, 0.5, scatter, 1))
    assert found.decrement.changes
    assert found.quality_factor is None
    assert found.decrement.u > 0.1 * 0.05


@pytest.mark.parametrize("seed", range(3))
def test_a_decrement_that_is_not_told_from_zero_has_no_quality_factor(seed: int) -> None:
    """It came out as -1.8 million with an uncertainty of 1.7 million."""
    found = summarise_decay(decay(0.0, 0.0, 1.0, seed))
    assert found.quality_factor is None
    assert not found.grows


def test_an_amplitude_that_grows_is_no_decay() -> None:
    found = summarise_decay(decay(-0.05, 0.0, 1.0, 1))
    assert found.grows
    assert found.quality_factor is None
    assert not summarise_decay(decay(0.05, 0.0, 1.0, 1)).grows
