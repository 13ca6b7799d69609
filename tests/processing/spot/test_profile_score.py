"""The fit of a learned profile: its gradient and information are those of scipy's cubic spline."""

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from processing.spot import SensorModel
from processing.spot.fit_values import REACH
from processing.spot.profile import MARGIN_PX, _to_spline
from processing.spot.profile_fit import (
    CENTRE_X,
    CENTRE_Y,
    PROFILE_PARAMETERS,
    fit_profile,
    score_profile,
    spline_weights,
)

Floats = NDArray[np.float64]
NY, NX = 24, 31
BASE_X, BASE_Y = 3, 2
PHASE_X, PHASE_Y = 0.3, 0.65
P = np.array([120.0, 0.0, 0.0, 14.0, 0.05, -0.08])
NOISE = SensorModel(39.2, 7.0, 1e4, prnu=0.02).pixel_noise


def coefficients() -> NDArray[np.float32]:
    """A beam with a shoulder, no Gaussian, and nothing alike on both sides."""
    y, x = np.indices((NY + 10, NX + 10))
    beam = np.exp(-0.5 * (((x - 20) / 6) ** 2 + ((y - 17) / 4.5) ** 2 + 0.02 * (x - 20) * (y - 17)))
    return (beam + 0.4 * np.exp(-0.5 * (((x - 27) / 4) ** 2 + ((y - 13) / 4) ** 2))).astype(np.float32)


def expected(p: Floats) -> Floats:
    """A T + plane; the centre's place is counted from that of `P`."""
    y, x = np.indices((NY, NX)).astype(np.float64)
    at = [y + BASE_Y + 1 + PHASE_Y - p[CENTRE_Y], x + BASE_X + 1 + PHASE_X - p[CENTRE_X]]
    light = scipy.ndimage.map_coordinates(coefficients().astype(np.float64), at, order=3, prefilter=False)
    return p[0] * light + p[3] + p[4] * (x - 0.5 * (NX - 1)) + p[5] * (y - 0.5 * (NY - 1))


def scored(pixels: Floats, gate: float = 1e30, full_scale_dn: float = 1e4) -> tuple[Floats, Floats, Floats]:
    weights = np.empty((4, 4), np.float32)
    spline_weights(PHASE_X, weights[0], weights[1])
    spline_weights(PHASE_Y, weights[2], weights[3])
    gradient, matrix = np.empty(PROFILE_PARAMETERS), np.empty((PROFILE_PARAMETERS, PROFILE_PARAMETERS))
    values = np.array(NOISE._replace(full_scale_dn=full_scale_dn))
    found = score_profile(
        pixels.astype(np.float32), coefficients(), BASE_X, BASE_Y, weights, P, values, gate,
        np.empty((2, NX + 3), np.float32), gradient, matrix,
    )  # fmt: skip
    return np.array(found), gradient, np.tril(matrix) + np.tril(matrix, -1).T


def seen() -> Floats:
    off = P + np.array([1.0, 0.02, -0.03, 0.3, 0.01, 0.01])
    return expected(off) + np.random.default_rng(2).standard_normal((NY, NX))


def test_gradient_and_information() -> None:
    mu, pixels = expected(P), seen()
    light = np.maximum(mu - expected(P * [0, 1, 1, 1, 1, 1]), 0)
    dark = max(NOISE.at_zero_dn2 + P[3] * NOISE.dn_per_e, 1 / 12)
    variance = dark + light * (NOISE.dn_per_e + light * NOISE.prnu2)
    by = np.empty((PROFILE_PARAMETERS, NY, NX))
    for k, step in enumerate(np.diag([1e-3] * PROFILE_PARAMETERS)):
        by[k] = (expected(P + step) - expected(P - step)) / 2e-3
    (chi2, kept, saturated), gradient, matrix = scored(pixels)
    information = np.einsum("kji,mji->km", by, by / variance)
    unit = np.sqrt(np.diag(information))
    assert matrix / np.outer(unit, unit) == pytest.approx(information / np.outer(unit, unit), abs=1e-3)
    expected_gradient = np.einsum("kji,ji->k", by, (pixels - mu) / variance)
    assert gradient / unit == pytest.approx(expected_gradient / unit, abs=1e-2, rel=1e-3)
    assert chi2 == pytest.approx(float(((pixels - mu) ** 2 / variance).sum()), rel=1e-3)
    assert (kept, saturated) == (NY * NX, 0)


def test_wild_pixels_and_those_near_full_scale_are_left_out() -> None:
    pixels = expected(P)
    pixels[2, 3] += 300
    (chi2, kept, saturated), gradient, _ = scored(pixels, gate=25.0)
    assert (kept, saturated) == (NY * NX - 1, 0)
    assert chi2 < 1
    assert np.abs(gradient).max() < 1
    (_, kept, saturated), _, _ = scored(pixels, gate=25.0, full_scale_dn=100.0)
    mu = expected(P)
    assert np.count_nonzero(mu > 98) <= saturated <= np.count_nonzero(mu > 80)
    assert kept == NY * NX - 1 - saturated


@pytest.mark.parametrize("scatter", [1.0, 6.0])
def test_the_gate_is_that_of_the_scatter_which_may_be_larger_than_stated(scatter: float) -> None:
    """All pixels stay but the wild one, also where noise is six times what the sensor's model says."""
    noise = NOISE._replace(at_zero_dn2=1.0, dn_per_e=0.0, prnu2=0.0)
    pixels = expected(P) + scatter * np.random.default_rng(2).standard_normal((NY, NX))
    pixels[2, 3] += 300
    # the centre's place in the spline's grid; the start is a little beside it
    centre, p = np.array([BASE_X + 1 + PHASE_X, BASE_Y + 1 + PHASE_Y]), P.copy()
    p[:4] += [9, 0.1, -0.1, 1]
    converged, chi2, kept, saturated, outliers, *u = fit_profile(
        pixels.astype(np.float32), coefficients(), centre, p, np.array(noise)
    )
    assert converged
    assert (kept, saturated, outliers) == (NY * NX - 1, 0, 1)
    assert chi2 / kept == pytest.approx(scatter**2, rel=0.2)
    assert np.all(np.abs(p - P)[[CENTRE_X, CENTRE_Y]] < 4 * scatter * np.array(u))


@pytest.mark.parametrize("sigma_px", [2.0, 7.9, 8.1, *np.linspace(8.2, 9.6, 57), 8.47542047015753, 20.0])
def test_the_spline_of_a_spot_is_the_spot(sigma_px: float) -> None:
    """Also where two knots lie between the same grid points, as for 8.4754 px."""
    half = int(np.ceil(REACH * sigma_px)) + MARGIN_PX
    grid = np.arange(-half, half + 1, dtype=np.float64)
    spot = np.exp(-0.5 * (grid / sigma_px) ** 2)
    coefficients = _to_spline(len(grid), sigma_px) @ spot
    again = (np.roll(coefficients, 1) + 4.0 * coefficients + np.roll(coefficients, -1)) / 6.0
    assert again[1:-1] == pytest.approx(spot[1:-1], abs=2e-5)
