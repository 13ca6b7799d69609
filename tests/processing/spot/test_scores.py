"""Gradient and Fisher information of every fit are those of a spot that is integrated over its pixels."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.spot import SensorModel, upright_score
from processing.spot.fit_values import PARAMETERS, TILTED, UPRIGHT, Window, nothing_hidden
from processing.spot.general_fit import score_general
from processing.spot.sensor_model import background_variance
from processing.spot.tilted_score import information_tilted, score_tilted
from tests.processing.spot.frames import tilted_light

Floats = NDArray[np.float64]
SHAPE = (61, 66)
WINDOW = Window(0, 0, SHAPE[1], SHAPE[0])
SENSOR = SensorModel(39.2, 7.0, 1e4, prnu=0.01)
NOISE = SENSOR.pixel_noise
TILTED_SPOT = np.array([150.0, 31.3, 28.6, 6.0, 4.5, 12.0, 9.0, 0.0, 0.0, 0.0])
UPRIGHT_SPOT = np.array([150.0, 31.3, 28.6, 6.0, 4.5, 12.0, 0.0, 0.0, 0.0, 0.0])
TWO_SPOTS = np.array([150.0, 27.3, 28.6, 5.0, 4.5, 12.0, 6.0, 70.0, 37.2, 33.9])


def expected(p: Floats) -> Floats:
    """Gaussians with this covariance matrix on their background."""
    variances, axes = np.linalg.eigh([[p[3] ** 2, p[6]], [p[6], p[4] ** 2]])
    shape = tuple(np.sqrt(variances).tolist()), math.atan2(axes[1, 0], axes[0, 0])
    return p[5] + tilted_light(SHAPE, *p[1:3], *shape, p[0]) + tilted_light(SHAPE, *p[8:10], *shape, p[7])


def wanted(p: Floats, image: Floats, size: int) -> tuple[Floats, Floats, float]:
    """Gradient, information and chi-square by differences of the expectation."""
    mu = expected(p)
    light = mu - p[5]
    floor = background_variance(p[5], NOISE)
    variance = floor + light * (NOISE.dn_per_e + light * NOISE.prnu2)
    by = np.empty((size, *SHAPE))
    for k in range(size):
        step = np.zeros(PARAMETERS)
        step[k] = 1e-4
        by[k] = (expected(p + step) - expected(p - step)) / 2e-4
    gradient = np.einsum("kji,ji->k", by, (image - mu) / variance)
    matrix = np.einsum("kji,mji->km", by, by / variance)
    return gradient, matrix, float(((image - mu) ** 2 / variance).sum())


def frame(p: Floats) -> tuple[Floats, NDArray[np.uint16]]:
    """What is seen of a spot a little beside `p`, with noise."""
    rng = np.random.default_rng(3)
    seen = expected(p * (1 + 0.002 * rng.standard_normal(PARAMETERS))) + rng.standard_normal(SHAPE)
    image = np.rint(np.maximum(seen, 0)).astype(np.uint16)
    return image.astype(np.float64), image


def assert_same(found: Floats, matrix: Floats, gradient: Floats, information: Floats) -> None:
    """In standard uncertainties; the fits leave out a derivative of the order of 1/(12 sigma^2)."""
    unit = np.sqrt(np.diag(information))
    assert found / unit == pytest.approx(gradient / unit, abs=0.05, rel=0.01)
    assert matrix / np.outer(unit, unit) == pytest.approx(information / np.outer(unit, unit), abs=0.025)


@pytest.mark.parametrize(
    ("p", "size"), [(UPRIGHT_SPOT, UPRIGHT), (TILTED_SPOT, TILTED), (TWO_SPOTS, PARAMETERS)]
)
def test_the_general_fit(p: Floats, size: int) -> None:
    values, image = frame(p)
    gradient, matrix = np.empty(PARAMETERS), np.empty((PARAMETERS, PARAMETERS))
    tilted, two = size >= TILTED, size == PARAMETERS
    chi2, pixels, saturated, outliers = score_general(
        image, WINDOW, p, tilted, two, NOISE, math.inf, nothing_hidden(), gradient, matrix
    )
    expected_gradient, information, expected_chi2 = wanted(p, values, size)
    assert_same(gradient[:size], matrix[:size, :size], expected_gradient, information)
    assert (pixels, saturated, outliers) == (image.size, 0, 0)
    assert chi2 == pytest.approx(expected_chi2, rel=1e-3)
    # what is not fitted stays where it is
    assert np.array_equal(matrix[size:], np.eye(PARAMETERS)[size:])
    assert not gradient[size:].any()


def test_the_general_fit_leaves_out_what_is_wild_and_what_would_be_clipped() -> None:
    _, image = frame(TILTED_SPOT)
    image[5, 5] += 200
    gradient, matrix = np.empty(PARAMETERS), np.empty((PARAMETERS, PARAMETERS))
    _, pixels, saturated, outliers = score_general(
        image, WINDOW, TILTED_SPOT, True, False, NOISE, 30.0, nothing_hidden(), gradient, matrix
    )
    assert (pixels, saturated, outliers) == (image.size - 1, 0, 1)
    # the model decides which are clipped, not the value seen
    clipping = NOISE._replace(full_scale_dn=120.0)
    _, pixels, saturated, outliers = score_general(
        image, WINDOW, TILTED_SPOT, True, False, clipping, 30.0, nothing_hidden(), gradient, matrix
    )
    assert outliers == 1
    mu = expected(TILTED_SPOT)
    assert np.count_nonzero(mu > 118) <= saturated <= np.count_nonzero(mu > 104)
    assert pixels == image.size - 1 - saturated


@pytest.mark.slow
def test_the_fast_fit_of_a_tilted_spot() -> None:
    p = TILTED_SPOT
    values, image = frame(p)
    floor = background_variance(p[5], NOISE)
    gradient, matrix = np.empty(PARAMETERS), np.empty((PARAMETERS, PARAMETERS))
    columns = np.empty(SHAPE[1], np.float32)
    arguments = (image, 0, 0, SHAPE[1], SHAPE[0], columns, p, floor, NOISE)
    chi2, kept = score_tilted(*arguments, 1e30, gradient)
    expected_gradient, information, expected_chi2 = wanted(p, values, TILTED)
    for steps in ((1, 1), (4, 3), (2, 4)):
        information_tilted(image, WINDOW, p, NOISE, *steps, matrix)
        assert_same(gradient[:TILTED], matrix[:TILTED, :TILTED], expected_gradient, information)
    assert (chi2, kept) == (pytest.approx(expected_chi2, rel=1e-3), image.size)
    image[5, 5] += 200
    assert score_tilted(*arguments, 30.0, gradient)[1] == image.size - 1


@pytest.mark.slow
@pytest.mark.parametrize("row_step", [1, 2])
def test_the_fast_fit_of_an_upright_spot(row_step: int) -> None:
    p = UPRIGHT_SPOT
    values, image = frame(p)
    floor = background_variance(p[5], NOISE)
    table = np.zeros((upright_score.TABLE_ROWS, max(SHAPE)), np.float32)
    upright_score.profile(table[: upright_score.ALONG_Y], 0, SHAPE[1], p[1], p[3])
    upright_score.profile(table[upright_score.ALONG_Y :], 0, SHAPE[0], p[2], p[4])
    gradient, matrix = np.empty(TILTED), np.empty((TILTED, TILTED))
    of_noise = (floor, NOISE.dn_per_e, NOISE.prnu2)
    chi2, kept = upright_score.score(
        image, 0, 0, SHAPE[1], SHAPE[0], row_step, table, p[0], p[5], *of_noise, 1e30, gradient
    )
    # rows between those summed count as their neighbours do
    rows = np.zeros(SHAPE[0], bool)
    rows[row_step // 2 :: row_step] = True
    seen = np.where(rows[:, np.newaxis], values, expected(p))
    expected_gradient, information, expected_chi2 = wanted(p, seen, TILTED)
    for steps in ((1, 1), (4, 3), (2, 4)):
        upright_score.information(SHAPE[1], SHAPE[0], table, p[0], *of_noise, *steps, matrix)
        assert_same(gradient, matrix, row_step * expected_gradient, information)
    assert chi2 == pytest.approx(row_step * expected_chi2, rel=2e-3)
    assert kept == pytest.approx(image.size, rel=0.03)
