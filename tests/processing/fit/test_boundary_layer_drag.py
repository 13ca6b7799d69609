"""A drag with the 3/2 power of the speed: found where it is, and not where it is not."""

from math import pi, sqrt

import numpy as np
import pytest

from processing.fit import (
    Evidence,
    FitResult,
    LinearisedFit,
    boundary_layer_drag,
    fit_exact,
    waveform_of,
    with_boundary_layer_drag,
)
from processing.swing import TurningPoints
from tests.processing.fit.decays import ARCSEC, paper_pair, pulls
from tests.processing.fit.driven import World
from tests.processing.fit.frames import seen_decay

DRAG_S, SHARE = 1.7e-3, 0.1
PARAMETERS, PENDULUM = paper_pair("glass_k8", DRAG_S)
# the works in a swing from 124 arcsec: integrals of sin^2.5 and sin^2 over half of one
BOUNDARY_LAYER = SHARE * DRAG_S / sqrt(124 * ARCSEC * 2 * pi / PARAMETERS.period0_s) * 0.5 * pi / 1.4377


def seen(boundary_layer: float, seed: int) -> tuple[TurningPoints, FitResult]:
    """Integrated on moving ground, seen by frames, fitted with a linear drag of which nothing is known."""
    world = World(drag32=boundary_layer)
    points, harmonics = seen_decay(PARAMETERS, PENDULUM, world, q=8e-9, seed=seed, noise_seed=[2, seed])
    return points, fit_exact(points, PENDULUM, drag=True, evidence=Evidence(waveform_of(harmonics)))


def test_a_tenth_of_the_drag_is_found_and_b_holds_what_it_does() -> None:
    points, fit = seen(BOUNDARY_LAYER, 1)
    b, u_b = fit.estimate("b")
    # what is printed where nobody asks
    assert b - PARAMETERS.b > 10 * u_b
    found = boundary_layer_drag(LinearisedFit.of(points, PENDULUM, fit))
    assert found.seen
    value, u = found.coefficient
    assert abs(value - BOUNDARY_LAYER) < 3 * u
    assert found.share == pytest.approx(SHARE, abs=0.04)
    assert abs((1 + found.relative_shift_b) * b / PARAMETERS.b - 1) < 0.05
    assert abs(fit.parameters.drag_s + found.shift_drag_s - DRAG_S) < 0.03 * DRAG_S
    wider = with_boundary_layer_drag(fit, found)
    assert np.all(np.abs(pulls(wider, PARAMETERS)) < 3)
    assert "3/2 power" in wider.warnings[-1]


def test_none_is_found_where_there_is_none() -> None:
    points, fit = seen(0.0, 1)
    found = boundary_layer_drag(LinearisedFit.of(points, PENDULUM, fit))
    assert not found.seen
    assert abs(found.coefficient.value) < 3 * found.coefficient.standard_uncertainty < 0.4 * BOUNDARY_LAYER
    same = with_boundary_layer_drag(fit, found)
    np.testing.assert_array_equal(same.covariance, fit.covariance)
    assert same.warnings == fit.warnings
