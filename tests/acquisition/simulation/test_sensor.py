"""The simulated sensor's noise has the exact distribution, and its light the exact integral."""

import math
from typing import Any

import numpy as np
import pytest
import scipy
from numba import njit
from numpy.typing import NDArray

from acquisition.simulation import sensor
from acquisition.simulation.optics import GaussianBeam, add_beam, beam_box
from acquisition.simulation.randomness import frame_normals, poisson, stream_key, ziggurat
from acquisition.simulation.settings import SensorState, SensorTruth

DARK = GaussianBeam(0.0, 0.0, 6.0, 6.0, 0.0, 0.0)
NY, NX = 640, 320


def exact_probabilities(mean_e: float, state: SensorState, full_well_e: float) -> NDArray[np.float64]:
    """Probability of each DN for a pixel of this mean: Poisson, full well, normal read noise, rounding."""
    spread = 12 * math.sqrt(mean_e) + 30
    electrons = np.arange(max(0, math.floor(mean_e - spread)), math.ceil(mean_e + spread))
    weights = scipy.stats.poisson.pmf(electrons, mean_e) if mean_e > 0 else (electrons == 0).astype(float)
    held = np.minimum(electrons, full_well_e)
    edges = (np.arange(state.full_scale_dn) + 0.5 - state.black_level_dn) * state.gain_e_per_dn
    near = slice(
        max(0, np.searchsorted(edges, held.min() - 40 * state.read_noise_e) - 1),
        np.searchsorted(edges, held.max() + 40 * state.read_noise_e) + 1,
    )
    p = np.zeros(state.full_scale_dn + 1)
    below = scipy.stats.norm.cdf((edges[near, None] - held) / state.read_noise_e) @ weights
    p[near.start : near.start + len(below) + 1] = np.diff(np.concatenate(([0.0], below, [1.0])))
    return p


def chi2_p_value(values: NDArray[Any], p: NDArray[np.float64]) -> float:
    """Goodness of fit, rare values pooled so that at least ten of each are expected."""
    counts = np.bincount(values.ravel(), minlength=len(p)).astype(float)
    order = np.argsort(p)[::-1]
    counts, expected = counts[order], p[order] * values.size
    rare = int(np.searchsorted(-expected, -10.0, side="right"))
    counts = np.append(counts[:rare], counts[rare:].sum())
    expected = np.append(expected[:rare], max(expected[rare:].sum(), 1e-300))
    if expected[-1] < 5:
        counts = np.append(counts[:-2], counts[-2:].sum())
        expected = np.append(expected[:-2], expected[-2:].sum())
    if len(counts) < 2:
        return 1.0 if counts[0] == values.size else 0.0
    statistic = float(((counts - expected) ** 2 / expected).sum())
    return float(scipy.stats.chi2.sf(statistic, len(counts) - 1))


def frames(
    truth: SensorTruth, count: int, beam: GaussianBeam = DARK, ambient_e: float = 0.0, bits: int | None = None
) -> NDArray[Any]:
    """Images of a sensor under a steady beam and even light."""
    state = truth.at(bits or truth.bit_depth)
    shape = (truth.height_px, truth.width_px)
    readout = state._replace(ambient_e=ambient_e)
    dark = sensor.dark_table(state)
    pixels = sensor.pixels(truth, 1, 0, 0, truth.width_px, truth.height_px)
    images = np.empty((count, *shape), dtype=np.uint8 if state.full_scale_dn == 255 else np.uint16)
    light_e = np.zeros(shape)
    shapes, mains = (
        np.tile(np.array(row, dtype=float), (count, 1))
        for row in (beam[2:5], (beam.x_px, beam.y_px, beam.peak_e))
    )
    edges, ghosts = ziggurat(), np.zeros((count, 3))
    sensor.expose_frames(images, light_e, shapes, mains, ghosts, readout, dark, pixels, edges, 1, 0, 0)
    assert not light_e.any()
    return images


@pytest.mark.parametrize(("read_noise_e", "bits"), [(7.0, 8), (0.5, 12), (60.0, 16)])
def test_dark_pixels_follow_their_distribution(bits: int, read_noise_e: float) -> None:
    truth = SensorTruth(read_noise_e=read_noise_e)
    state = truth.at(bits)
    p = exact_probabilities(0.0, state, truth.full_well_e)
    assert sensor.dark_probabilities(state) == pytest.approx(p, abs=1e-14)
    images = frames(truth, 5, bits=bits)
    assert chi2_p_value(images, p) > 1e-3


def test_dark_pixels_are_independent_of_their_neighbours_and_of_the_frame_before() -> None:
    for bits in (8, 12):
        noise = frames(SensorTruth(), 4, bits=bits).astype(float)
        noise -= noise.mean()
        variance = (noise**2).mean()
        limit = 4 / math.sqrt(noise.size * 0.75)
        for other in (
            (noise[:, :, 1:] * noise[:, :, :-1]).mean(),
            (noise[:, 1:] * noise[:, :-1]).mean(),
            (noise[1:] * noise[:-1]).mean(),
        ):
            assert abs(other) / variance < limit


@pytest.mark.parametrize(
    ("mean_e", "read_noise_e", "bits"),
    [
        *((0.02, 7.0, 8), (0.02, 0.5, 12), (1.0, 2.5, 12), (30.0, 0.5, 8), (30.0, 7.0, 12)),
        *((300.0, 2.5, 8), (300.0, 0.5, 12), (6800.0, 7.0, 8), (6800.0, 0.5, 12)),
    ],
)
def test_lit_pixels_follow_their_distribution(mean_e: float, read_noise_e: float, bits: int) -> None:
    truth = SensorTruth(read_noise_e=read_noise_e)
    images = frames(truth, 3, ambient_e=mean_e, bits=bits)
    p = exact_probabilities(mean_e, truth.at(bits), truth.full_well_e)
    assert chi2_p_value(images, p) > 1e-3
    mean_dn = float(p @ np.arange(len(p)))
    variance_dn = float(p @ (np.arange(len(p)) - mean_dn) ** 2)
    assert images.mean() == pytest.approx(mean_dn, abs=4 * math.sqrt(variance_dn / images.size) + 1e-12)
    assert images.var() == pytest.approx(variance_dn, rel=0.03, abs=1e-4)


@pytest.mark.slow
def test_bent_normal_stays_true_with_many_samples() -> None:
    """The claim that the distribution function errs by less than 1e-4: 20 million pixels would see 2e-4."""
    truth = SensorTruth(read_noise_e=7.0)
    for mean_e in (20.0, 1000.0):
        images = frames(truth, 40, ambient_e=mean_e, bits=12)
        p = exact_probabilities(mean_e, truth.at(12), truth.full_well_e)
        found = np.cumsum(np.bincount(images.ravel(), minlength=len(p))) / images.size
        assert np.abs(found - np.cumsum(p)).max() < 1e-4 + 2 / math.sqrt(images.size)


@pytest.mark.parametrize("full_well_e", [10_000.0, 4_000.0])
@pytest.mark.parametrize("mean_e", [3_900.0, 4_300.0, 9_900.0])
def test_full_well_and_full_scale_cut(full_well_e: float, mean_e: float) -> None:
    truth = SensorTruth(full_well_e=full_well_e)
    images = frames(truth, 2, ambient_e=mean_e, bits=12)
    assert chi2_p_value(images, exact_probabilities(mean_e, truth.at(12), full_well_e)) > 1e-3


def test_every_pixel_of_the_spot_has_its_own_mean_and_variance() -> None:
    """The spot as the tracker sees it: standardised residuals over the whole image are standard normal."""
    truth = SensorTruth(width_px=64, height_px=64)
    beam = GaussianBeam(31.3, 30.8, 5.0, 7.0, 0.5, 170 * 39.2)
    state = truth.at(12)
    count = 400
    images = frames(truth, count, beam, bits=12).astype(float)
    light_e = np.zeros((64, 64))
    add_beam(light_e, beam, 0, 64, 0, 64)
    mean_dn = light_e / state.gain_e_per_dn + state.black_level_dn
    variance_dn = (light_e + state.read_noise_e**2) / state.gain_e_per_dn**2 + 1 / 12
    z = (images.mean(axis=0) - mean_dn) / np.sqrt(variance_dn / count)
    assert scipy.stats.kstest(z.ravel(), "norm").pvalue > 1e-3
    ratio = images.var(axis=0, ddof=1) / variance_dn
    assert ratio.mean() == pytest.approx(1.0, abs=4 * math.sqrt(2 / count / ratio.size))
    assert ratio.std() == pytest.approx(math.sqrt(2 / count), rel=0.1)


def test_uneven_response_is_a_property_of_the_sensor() -> None:
    truth = SensorTruth(prnu=0.02, width_px=128, height_px=128)
    images = frames(truth, 200, ambient_e=6000.0, bits=12).astype(float)
    response = (images.mean(axis=0) - truth.at(12).black_level_dn) * truth.at(12).gain_e_per_dn / 6000.0
    # photon noise of the mean of 200 frames adds 0.09 % to 2 %
    assert response.std() == pytest.approx(0.02, rel=4 / math.sqrt(2 * response.size) + 0.002)
    whole = sensor.pixels(truth, 1, 0, 0, 128, 128)
    part = sensor.pixels(truth, 1, 30, 20, 50, 40)
    assert np.array_equal(part.response, whole.response[20:60, 30:80])
    assert np.corrcoef(response.ravel(), whole.response.ravel())[0, 1] > 0.99
    dark = frames(truth, 5, bits=12)
    assert chi2_p_value(dark, exact_probabilities(0.0, truth.at(12), truth.full_well_e)) > 1e-3


def test_hot_pixels_stay_in_place_and_have_shot_noise() -> None:
    truth = SensorTruth(hot_pixels=200, width_px=128, height_px=128)
    images = frames(truth, 300, bits=12).astype(float)
    whole = sensor.pixels(truth, 1, 0, 0, 128, 128)
    state = truth.at(12)
    assert len(whole.hot_e) == 200
    # 120 DN of 39.2 e-; the mean of 200 exponential values scatters by 7 %
    assert whole.hot_e.mean() == pytest.approx(4704, rel=0.2)
    mean_e = (
        images[:, whole.hot_row, whole.hot_column].mean(axis=0) - state.black_level_dn
    ) * state.gain_e_per_dn
    cut = whole.hot_e < 9_000
    u_e = np.sqrt((whole.hot_e + 50) / 300)
    z = (mean_e - whole.hot_e)[cut] / u_e[cut]
    assert scipy.stats.kstest(z, "norm").pvalue > 1e-3
    part = sensor.pixels(truth, 1, 30, 20, 50, 40)
    inside = (whole.hot_column >= 30) & (whole.hot_column < 80) & (whole.hot_row >= 20) & (whole.hot_row < 60)
    assert np.array_equal(part.hot_e, whole.hot_e[inside])
    assert np.array_equal(part.hot_column, whole.hot_column[inside] - 30)


def integrated(beam: GaussianBeam, ny: int, nx: int) -> NDArray[np.float64]:
    """The beam over pixels by 12 x 12 Gauss nodes each: exact to rounding for these sizes."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    x = (np.arange(nx)[:, None] + 0.5 * nodes).ravel() - beam.x_px
    y = (np.arange(ny)[:, None] + 0.5 * nodes).ravel() - beam.y_px
    along = x * math.cos(beam.rotation_rad) + y[:, None] * math.sin(beam.rotation_rad)
    across = -x * math.sin(beam.rotation_rad) + y[:, None] * math.cos(beam.rotation_rad)
    height = np.exp(-0.5 * ((along / beam.sigma_x_px) ** 2 + (across / beam.sigma_y_px) ** 2))
    cells = height.reshape(ny, 12, nx, 12)
    return beam.peak_e * np.einsum("yixj,i,j->yx", cells, weights / 2, weights / 2)


@pytest.mark.parametrize(
    ("sigma_x_px", "sigma_y_px", "rotation_rad"),
    [(6.0, 6.0, 0.0), (3.0, 5.0, 0.3), (3.0, 5.0, math.pi / 2), (12.0, 7.0, -1.2), (2.0, 2.5, 2.5)],
)
def test_light_is_the_integral_over_each_pixel(
    sigma_x_px: float, sigma_y_px: float, rotation_rad: float
) -> None:
    beam = GaussianBeam(40.37, 29.81, sigma_x_px, sigma_y_px, rotation_rad, 7000.0)
    light_e = np.zeros((64, 80))
    add_beam(light_e, beam, 0, 64, 0, 80)
    assert light_e == pytest.approx(integrated(beam, 64, 80), abs=max(2e-7 * 7000, 1e-3))


@pytest.mark.slow
def test_light_of_a_very_long_ellipse_is_all_there() -> None:
    beam = GaussianBeam(130.2, 90.7, 25.0, 2.0, 0.6, 7000.0)
    light_e = np.zeros((180, 260))
    add_beam(light_e, beam, *beam_box(beam, 180, 260))
    assert light_e == pytest.approx(integrated(beam, 180, 260), abs=1e-3)
    assert light_e.sum() == pytest.approx(7000 * 2 * math.pi * 25 * 2, rel=1e-4)


def test_box_leaves_out_less_than_a_thousandth_of_an_electron_a_pixel() -> None:
    for beam in (
        GaussianBeam(40.4, 29.8, 3.0, 5.0, 0.7, 7000.0),
        GaussianBeam(2.0, 63.0, 6.0, 6.0, 0.0, 9000.0),
    ):
        y0, y1, x0, x1 = beam_box(beam, 64, 80)
        outside = integrated(beam, 64, 80)
        outside[y0:y1, x0:x1] = 0.0
        assert outside.max() < 1e-3
    for beam in (
        GaussianBeam(-100.0, 30.0, 6.0, 6.0, 0.0, 7e3),
        GaussianBeam(math.nan, 1.0, 6.0, 6.0, 0.0, 7e3),
        DARK,
    ):
        assert beam_box(beam, 64, 80) == (0, 0, 0, 0)


@njit  # the state must stay a 64-bit number without sign, which plain Python has not
def fill_poisson(out: NDArray[np.int64], mean: float) -> None:
    state = stream_key(1, 2, 3, 4)
    for i in range(len(out)):
        state, number = poisson(state, mean)
        out[i] = int(number)


@pytest.mark.parametrize("mean", [0.01, 3.0, 9.9, 10.0, 45.0, 2000.0])
def test_poisson_numbers(mean: float) -> None:
    values = np.empty(100_000, dtype=np.int64)
    fill_poisson(values, mean)
    top = int(mean + 12 * math.sqrt(mean) + 10)
    p = scipy.stats.poisson.pmf(np.arange(top + 1), mean)
    assert values.max() <= top
    assert chi2_p_value(values, p) > 1e-3


def test_normal_numbers() -> None:
    values = np.empty((500_000, 2))
    frame_normals(9, 0, 1, 0, ziggurat(), values)
    flat = values.ravel()
    assert scipy.stats.kstest(flat, "norm").pvalue > 1e-3
    # the tail beyond the ziggurat's last layer, 3.654: 258 of a million
    beyond = int((np.abs(flat) > 3.6541528853610088).sum())
    expected = 2 * scipy.stats.norm.sf(3.6541528853610088) * flat.size
    assert abs(beyond - expected) < 4 * math.sqrt(expected)
    assert abs(np.corrcoef(values[:, 0], values[:, 1])[0, 1]) < 4 / math.sqrt(len(values))
    assert abs(np.corrcoef(values[1:, 0], values[:-1, 0])[0, 1]) < 4 / math.sqrt(len(values))
