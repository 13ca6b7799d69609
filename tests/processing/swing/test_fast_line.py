"""A fast mode that is seen along the slow axis is found within a cycle and taken out."""

import numpy as np
import pytest

from processing.swing.cycle_residuals import fast_mode_derivatives, linear_fit_residuals

TAU_S = np.linspace(-1.0, 3.0, 400)
OWN = np.column_stack([np.ones(400), TAU_S])


@pytest.mark.parametrize("frequency_hz", [2.3, 7.1, 24.0])
def test_a_line_is_found_with_its_frequency_and_phase(frequency_hz: float) -> None:
    rng = np.random.default_rng(1)
    phase = 2 * np.pi * frequency_hz * TAU_S
    fast = 3.0 + 0.5 * np.cos(phase + 0.4) + 0.02 * rng.standard_normal(400)
    columns = fast_mode_derivatives(TAU_S, fast, OWN)
    assert columns.shape == (400, 4)
    # along the slow axis it is seen with another phase, and damped
    seen = 0.1 * np.sin(phase) * np.exp(-0.05 * TAU_S)
    left = linear_fit_residuals(seen, np.column_stack([OWN, columns]))
    assert np.std(left) < 0.03 * np.std(seen)
    # a line elsewhere is none of its
    other = np.cos(2 * np.pi * (frequency_hz + 3.0) * TAU_S)
    assert np.std(linear_fit_residuals(other, columns)) > 0.9 * np.std(other)


def test_noise_and_gaps_have_no_line() -> None:
    noise = np.random.default_rng(2).standard_normal(400)
    assert fast_mode_derivatives(TAU_S, noise, OWN) is None
    assert fast_mode_derivatives(TAU_S, np.where(TAU_S > 1, np.nan, np.cos(20 * TAU_S)), OWN) is None
    assert fast_mode_derivatives(TAU_S, OWN[:, 1] * 2 + 1 + 1e-3 * noise, OWN) is None


@pytest.mark.parametrize("part", [-0.4, -0.2, 0.3, 0.5])
def test_the_frequency_of_a_line_between_those_of_the_spectrum_is_met(part: float) -> None:
    # the spectrum has four frequencies for each one that the cycle's length tells apart
    spacing_hz = (len(TAU_S) - 1) / (4 * len(TAU_S) * (TAU_S[-1] - TAU_S[0]))
    phase = 2 * np.pi * (80 + part) * spacing_hz * (TAU_S - TAU_S[0])
    columns = fast_mode_derivatives(TAU_S, np.cos(phase + 1.0), OWN)
    # over the whole cycle: a hundredth of the spacing is 0.016 rad
    np.testing.assert_allclose(columns[:, 0], np.cos(phase), atol=0.05)
