"""Damping of all parts is fitted with its uncertainty; truth from an integration of its own.

Hundreds of decays: ``python -m tests.benchmarks damping``.
"""

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from processing.damping import amplitude_at, fit_damping
from processing.errors import DataError

T = np.linspace(0.0, 30.0, 300)
NOISE = 0.003
KINDS = {
    "viscous": (0.0, 0.1, 0.0),
    "quadratic": (0.0, 0.0, 0.15),
    "Coulomb": (0.025, 0.0, 0.0),
    "viscous and quadratic": (0.0, 0.05, 0.08),
    "viscous and Coulomb": (0.01, 0.06, 0.0),
    "all": (0.006, 0.05, 0.05),
}


def true_amplitude(parts: tuple[float, float, float]) -> NDArray[np.float64]:
    """The amplitude, integrated step by step."""
    c, g, q = parts
    found = scipy.integrate.solve_ivp(
        lambda _, a: -(c + g * a + q * a**2), (0.0, T[-1]), [1.0], t_eval=T, rtol=1e-10, atol=1e-12
    )
    return np.asarray(found.y[0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_solution_is_that_of_the_differential_equation(kind: str) -> None:
    np.testing.assert_allclose(amplitude_at(T, 1.0, *KINDS[kind]), true_amplitude(KINDS[kind]), atol=1e-8)


@pytest.mark.parametrize(("exponent", "floor"), [(0.94, 0.02), (0.8, 0.05), (1.3, 0.02)])
def test_time_constants_of_a_loss_that_the_parts_do_not_describe_are_as_uncertain_as_they_are_wrong(
    exponent: float, floor: float
) -> None:
    """A loss by A^p: time constants lay up to 40 u off, because the residuals hang together."""
    time_s = np.linspace(0.0, 1200.0, 570)
    rest = 1.0 - exponent
    # dA/dt = -k A^p, from 1 to the last amplitude
    rate = (1.0 - floor**rest) / rest / time_s[-1]
    truth = (1.0 - rest * rate * time_s) ** (1.0 / rest)
    u = 1e-5
    noisy = truth + u * np.random.default_rng(2).standard_normal(len(time_s))
    found = fit_damping(time_s, noisy, np.full(len(truth), u))
    assert found.chi2_per_dof > 4
    amplitudes = np.geomspace(1.0, floor, 9)
    tau_s, u_tau_s = found.time_constant_s(amplitudes)
    z = (tau_s - amplitudes**rest / rate) / u_tau_s
    assert 0.2 < np.sqrt(np.mean(z**2)) < 2.0


def test_noise_that_is_larger_than_stated_is_no_misfit() -> None:
    """White residuals enlarge the uncertainties by chi-square alone."""
    truth = true_amplitude(KINDS["all"])
    noisy = truth + NOISE * np.random.default_rng(8).standard_normal(len(T))
    stated, too_small = (fit_damping(T, noisy, np.full(len(T), u)) for u in (NOISE, NOISE / 10))
    assert too_small.linear.u == pytest.approx(stated.linear.u, rel=0.1)


def test_friction_that_does_not_depend_on_speed_ends_the_swing() -> None:
    assert amplitude_at(T, 1.0, 0.1, 0.0, 0.0)[-1] == 0.0
    assert amplitude_at(T, 1.0, 0.1, 0.0, 0.3)[-1] == 0.0
    assert amplitude_at(T, 1.0, 0.1, 0.2, 0.0)[-1] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_time_constant_at_every_amplitude_is_within_its_uncertainty(kind: str) -> None:
    parts, truth = KINDS[kind], true_amplitude(KINDS[kind])
    amplitudes = np.geomspace(1.0, truth[-1], 4)
    true_s = 1.0 / (parts[0] / amplitudes + parts[1] + parts[2] * amplitudes)
    z = []
    for seed in range(2):
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(T))
        found = fit_damping(T, truth + noise, np.full(len(T), NOISE))
        tau_s, u_tau_s = found.time_constant_s(amplitudes)
        z.append((tau_s - true_s) / u_tau_s)
        needed = tuple(
            name for name, part in zip(("constant", "linear", "quadratic"), parts, strict=True) if part
        )
        assert found.needed == needed
    # of 8 values, 400 decays in docs/validation.md, of which those of one decay hang together
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.9


def test_what_cannot_be_an_amplitude_or_its_uncertainty_is_named() -> None:
    truth = true_amplitude(KINDS["viscous"])
    with pytest.raises(DataError, match="uncertainty of an amplitude is 0: it must be positive"):
        fit_damping(T, truth, np.append(np.full(len(T) - 1, NOISE), 0.0))
    for deflections in (-truth, truth * np.cos(5 * T)):
        with pytest.raises(DataError, match="amplitudes are positive, but one is -"):
            fit_damping(T, deflections, np.full(len(T), NOISE))


def test_values_that_do_not_fall_are_no_decay() -> None:
    rising = 1.0 + 0.01 * T + NOISE * np.random.default_rng(1).standard_normal(len(T))
    with pytest.raises(DataError, match="does not fall"):
        fit_damping(T, rising, np.full(len(T), NOISE))
    with pytest.raises(DataError, match="at least 12"):
        fit_damping(T[:11], rising[:11], np.full(11, NOISE))
