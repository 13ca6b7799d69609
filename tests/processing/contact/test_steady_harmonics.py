"""Harmonics of a steady swing are those of the Fourier series of friction and stiffness."""

import math

import numpy as np
import pytest

from processing.contact import law_harmonics, stiffness_ratio
from processing.contact.free_swing import free_swing
from processing.contact.laws import PAPER
from processing.swing import ORDERS
from tests.processing.fit.decays import paper_pair

PENDULUM = paper_pair("steel")[1]
AMPLITUDES_RAD = np.geomspace(2e-7, 1e-6, 7)


def test_dry_friction_makes_a_square_wave() -> None:
    """c sign(sin s) = (4 c/pi) (sin s + sin 3s/3 + ...), each over 1 - k^2; sine is -i.

    Those beyond the ninth leak into the terms of a piece.
    """
    c = 1e-11
    values = {"b": 0.0, "p": 1.0, "c": c, "n": 0.5, "period0_s": 4.0, "gamma_pa": 0.0}
    found = law_harmonics(PAPER, values, PENDULUM, AMPLITUDES_RAD)
    for k in (3, 5):
        column = found[:, ORDERS.index(k)]
        assert column == pytest.approx(np.full(7, -4j * c / (math.pi * k) / (1 - k**2)), rel=1e-2)


def test_a_cubic_stiffness_makes_a_third_harmonic_that_grows_with_the_cube() -> None:
    """cos^3 s = (3 cos s + cos 3s)/4; what is left of the stiffness divides it."""
    gamma_pa = 1e20
    values = {"b": 0.0, "p": 1.0, "c": 0.0, "n": 2.0, "period0_s": 4.0, "gamma_pa": gamma_pa}
    cube = stiffness_ratio(gamma_pa, PENDULUM) * math.pi / 2 * AMPLITUDES_RAD**3
    assert 0.02 < cube[-1] / AMPLITUDES_RAD[-1] < 0.5
    found = law_harmonics(PAPER, values, PENDULUM, AMPLITUDES_RAD)[:, ORDERS.index(3)]
    wanted = cube / 4 / (1 - 9) / (1 - 0.75 * cube / AMPLITUDES_RAD)
    # interpolated between twelve amplitudes
    assert found.real == pytest.approx(wanted, rel=0.04)
    assert np.abs(found.imag) == pytest.approx(0, abs=1e-6 * abs(wanted[-1]))


def test_a_drag_alone_makes_the_damped_oscillation() -> None:
    """x'' = -x - d x', in the phase w0 t."""
    values = {"b": 0.0, "p": 1.0, "c": 0.0, "n": 0.5, "period0_s": 4.0, "gamma_pa": 0.0, "drag_s": 0.02}
    swing = free_swing(PAPER, values, PENDULUM, AMPLITUDES_RAD, 4)
    half_d = 0.5 * 0.02 * 2 * math.pi / 4.0
    w = math.sqrt(1 - half_d**2)
    decay = np.exp(-half_d * swing.phase) * (np.cos(w * swing.phase) + half_d / w * np.sin(w * swing.phase))
    assert swing.phi_rad / AMPLITUDES_RAD[:, None] == pytest.approx(decay, abs=1e-4)
    assert swing.end == pytest.approx(4 * math.pi / w, rel=1e-5)
