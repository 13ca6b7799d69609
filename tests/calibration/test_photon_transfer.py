"""The sensor calibration agrees with the simulated sensor and with the formulas of EMVA 1288."""

import numpy as np
import pytest

from acquisition.simulation.settings import SensorTruth
from calibration.sensor import photon_transfer
from processing.errors import DataError
from tests.calibration.simulated_sensor import even_frames, random_sensor, transfer_frames


@pytest.mark.parametrize(("pedestal_dn", "noise_dn"), [(2.0, 0.3), (2.0, 1.5), (10.0, 0.25), (1.4, 0.02)])
def test_levels_without_light_are_no_calibration(pedestal_dn: float, noise_dn: float) -> None:
    """With the cap on, or from the simulated camera, a gain of 17.76 and a PRNU of 28 were filed."""
    rng = np.random.default_rng(1)
    frames = [
        np.clip(np.rint(rng.normal(pedestal_dn, noise_dn, (120, 160))), 0, 255).astype(np.uint8)
        for _ in range(14)
    ]
    with pytest.raises(DataError, match=r"not brighter than the dark|are equal|does not grow"):
        photon_transfer(list(zip(frames[4::2], frames[5::2], strict=True)), frames[:4], 255)


def test_a_slope_within_its_scatter_is_no_gain() -> None:
    """Levels that differ by less than the noise shows."""
    rng = np.random.default_rng(1)

    def frame(signal_dn: float) -> np.ndarray:
        noise_dn = np.sqrt(1.0 + 0.02 * signal_dn)
        return np.rint(rng.normal(10.0 + signal_dn, noise_dn, (60, 60))).astype(np.uint8)

    levels_dn = [1.0, 1.2, 1.4, 1.6, 1.8]
    with pytest.raises(DataError, match="does not grow with the signal"):
        photon_transfer([(frame(one), frame(one)) for one in levels_dn], [frame(0.0) for _ in range(4)], 255)


@pytest.mark.parametrize("noise_dn", [0.36, 0.5])
def test_rounding_moves_neither_dark_level_nor_noise_by_more_than_is_said(noise_dn: float) -> None:
    z, z_noise = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        level = rng.uniform(2.0, 3.0)

        def frame(mean: float, rng: np.random.Generator = rng, level: float = level) -> np.ndarray:
            noise = np.sqrt(noise_dn**2 + 0.1 * mean) * rng.standard_normal((64, 64))
            return np.clip(np.rint(level + mean + noise), 0, 255).astype(np.uint8)

        darks = [frame(0.0) for _ in range(8)]
        found = photon_transfer([(frame(mean), frame(mean)) for mean in range(20, 101, 20)], darks, 255)
        assert found.read_noise_resolved
        brightest = found.points[-1]
        assert brightest.u_variance_dn2 / brightest.variance_dn2 == pytest.approx(np.sqrt(2) / 64, rel=0.1)
        z.append((found.dark_level_dn - level) / found.u_dark_level_dn)
        gain = found.gain_e_per_dn
        z_noise.append((found.read_noise_e / gain - noise_dn) * gain / found.u_read_noise_e)
    assert np.sqrt(np.mean(np.square(z_noise))) < 1 + 3 / np.sqrt(40)
    # an rms of 20 deviations lies within 3/sqrt(40) of 1; the integers' mean was off by up to 20
    assert np.sqrt(np.mean(np.square(z))) < 1 + 3 / np.sqrt(40)


def test_agrees_with_the_emva_1288_formulas() -> None:
    truth = random_sensor(np.random.default_rng(2)).model_copy(update={"hot_pixels": 0, "prnu": 0.0})
    pairs, darks, exposures = transfer_frames(truth, 5)
    full_scale = 2**truth.bit_depth - 1
    found = photon_transfer(pairs, darks, full_scale, exposures_us=exposures)
    # EMVA 1288 release 3.1: eqs. 14-18 and 22-24, written down without a look at the code under test
    mu, sigma2 = [], []
    for a, b in pairs:
        a64, b64 = a.astype(float), b.astype(float)
        mu.append(0.5 * (a64 + b64).mean())
        sigma2.append(0.5 * ((a64 - b64) ** 2).mean() - 0.5 * (a64.mean() - b64.mean()) ** 2)
    d0, d1 = darks[0].astype(float), darks[1].astype(float)
    mu_dark = 0.5 * (d0 + d1).mean()
    s2_dark = 0.5 * ((d0 - d1) ** 2).mean() - 0.5 * (d0.mean() - d1.mean()) ** 2
    x, y = np.array(mu) - mu_dark, np.array(sigma2) - s2_dark
    below = np.array(mu) <= 0.7 * full_scale
    overall_gain_dn_per_e = float(x[below] @ y[below] / (x[below] @ x[below]))
    sigma_d_e = float(np.sqrt(s2_dark - 1 / 12)) / overall_gain_dn_per_e
    # the standard's line is unweighted and forced through the dark point: its own scatter is larger
    n = pairs[0][0].size
    u_standard = np.sqrt(2 / n * np.sum((x[below] * np.array(sigma2)[below]) ** 2)) / (x[below] @ x[below])
    assert 1 / found.gain_e_per_dn == pytest.approx(overall_gain_dn_per_e, abs=4 * u_standard)
    assert found.read_noise_e == pytest.approx(sigma_d_e, rel=4 * np.sqrt(1 / n) + 0.01)
    assert found.dark_level_dn == pytest.approx(mu_dark, abs=4 * np.sqrt(s2_dark / n))
    assert found.linearity_error < 0.01


@pytest.mark.parametrize("bend", [0.0, 0.01])
def test_a_response_that_bends_by_one_per_cent_moves_the_gain_by_no_more_than_is_said(bend: float) -> None:
    """It came out 4 u too large: as if no sensor bent."""
    z, bends, electrons_per_dn = [], [], 20.0
    for seed in range(3):
        rng = np.random.default_rng(seed)

        def frame(level_dn: float, rng: np.random.Generator = rng) -> np.ndarray:
            electrons = rng.poisson(level_dn * electrons_per_dn, (200, 200)) + rng.normal(0, 20.0, (200, 200))
            dn = electrons / electrons_per_dn
            return np.clip(np.rint(12.0 + dn * (1.0 - bend * dn / 255)), 0, 255).astype(np.uint8)

        pairs = [(frame(level), frame(level)) for level in np.linspace(12.0, 165.0, 8)]
        found = photon_transfer(pairs, [frame(0.0) for _ in range(8)], 255)
        assert found.u_gain_e_per_dn < 0.012 * electrons_per_dn
        z.append((found.gain_e_per_dn - electrons_per_dn) / found.u_gain_e_per_dn)
        bends.append(found.non_linearity)
    assert np.mean(bends) == pytest.approx(bend, abs=0.004)
    assert abs(np.mean(z)) < 1.5
    assert np.sqrt(np.mean(np.square(z))) < 1.9


def test_hot_pixels_and_prnu_are_found() -> None:
    truth = random_sensor(np.random.default_rng(3)).model_copy(update={"hot_pixels": 12, "prnu": 0.02})
    pairs, darks, _ = transfer_frames(truth, 9)
    found = photon_transfer(pairs, darks, 2**truth.bit_depth - 1)
    dark = np.mean([image.astype(float) for image in darks], axis=0)
    for x, y in found.hot_pixels:
        assert dark[y, x] > truth.black_level_dn + 3
    assert len(found.hot_pixels) >= 8
    assert found.prnu == pytest.approx(0.02, abs=4 * found.u_prnu)


def test_light_that_falls_off_to_the_sides_is_no_prnu_and_leaves_its_uncertainty() -> None:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    even = 1.0 + 0.1 * x - 0.02 * (x**2 + y**2)
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        response = rng.normal(1.0, 0.01, even.shape)

        def frame(
            signal_dn: float, rng: np.random.Generator = rng, light: np.ndarray = even * response
        ) -> np.ndarray:
            noise_dn = np.sqrt(6.0 + 0.4 * signal_dn * light)
            return np.rint(60.0 + signal_dn * light + noise_dn * rng.standard_normal(light.shape)).astype(
                np.uint16
            )

        levels_dn = np.linspace(200.0, 2800.0, 5)
        found = photon_transfer(
            [(frame(one), frame(one)) for one in levels_dn], [frame(0.0), frame(0.0)], 4095
        )
        # of a mean of two with 28² DN² of response, half of 1126 DN² of noise, and the dark frames' 3 DN²
        u2_spatial = 2 / 4096 * ((784 + 563 + 3) ** 2 + 563**2)
        assert found.u_prnu == pytest.approx(np.sqrt(u2_spatial) / (2 * 28 * 2800), rel=0.1)
        # the dark frames' variance scatters by sqrt(2/4095) of itself
        u_read = np.hypot(np.sqrt(0.5 / 4095), found.u_gain_e_per_dn / found.gain_e_per_dn)
        assert found.u_read_noise_e / found.read_noise_e == pytest.approx(u_read, rel=0.05)
        z.append((found.prnu - 0.01) / found.u_prnu)
    assert np.sqrt(np.mean(np.square(z))) < 1 + 4 / np.sqrt(2 * len(z))


def test_two_dark_frames_serve_and_a_level_that_wanders_is_no_noise() -> None:
    truth = random_sensor(np.random.default_rng(8))
    pairs, (first, second, *_), _ = transfer_frames(truth, 8)
    steady, wandering = (
        photon_transfer(pairs, [first, second + offset], 2**truth.bit_depth - 1) for offset in (0, 3)
    )
    assert steady.read_noise_e == pytest.approx(truth.read_noise_e, rel=0.1)
    assert wandering.read_noise_e == pytest.approx(steady.read_noise_e, rel=0.05)


def test_the_knee_of_a_small_full_well_is_found() -> None:
    truth = SensorTruth(
        width_px=64, height_px=64, bit_depth=12, gain_e_per_dn=2.4, full_well_e=6000.0, black_level_dn=60.0
    )
    darks = even_frames(truth, 100, 4, seed=1, run=0, ambient_dn=0)
    pairs = []
    for run, exposure in enumerate(np.linspace(8, 95, 14)):
        a, b = even_frames(truth, exposure, 2, seed=1, run=1 + run, ambient_dn=3300.0)
        pairs.append((a, b))
    found = photon_transfer(pairs, darks, 4095)
    assert found.saturates
    # the noise is greatest up to a level and 3 sqrt(6000) e- below it
    level_e = (95 - 8) / 13 / 100 * 3300.0 * 2.4
    assert abs(found.full_well_e - 6000) < level_e + 3 * np.sqrt(6000)
    assert any("pixels are saturated" in line for line in found.rejected)
    assert abs(found.gain_e_per_dn - 2.4) < 4 * found.u_gain_e_per_dn


def test_a_converter_too_coarse_for_the_noise_is_said() -> None:
    truth = SensorTruth(width_px=64, height_px=64)
    pairs, darks, _ = transfer_frames(truth.model_copy(update={"full_well_e": 15_000.0}), 4)
    found = photon_transfer(pairs, darks, 255)
    assert not found.read_noise_resolved
    assert found.u_dark_level_dn > 0.25
    assert abs(found.gain_e_per_dn - truth.gain_e_per_dn) < 4 * found.u_gain_e_per_dn


def test_frames_that_cannot_serve_are_named() -> None:
    truth = random_sensor(np.random.default_rng(4))
    full_scale = 2**truth.bit_depth - 1
    pairs, darks, _ = transfer_frames(truth, 6)
    burnt = np.full_like(pairs[0][0], full_scale)
    darker = (pairs[4][1] * 0.9).astype(pairs[4][1].dtype)
    names = [*(f"level {k}" for k in range(9)), "burnt"]
    found = photon_transfer(
        [*pairs[:4], (pairs[4][0], darker), *pairs[5:], (burnt, burnt)], darks, full_scale, names=names
    )
    assert any(line.startswith("level 4:") and "lamp" in line for line in found.rejected)
    assert any(line.startswith("burnt:") and "full scale" in line for line in found.rejected)


@pytest.mark.parametrize(
    ("levels", "darks", "words"),
    [(9, 1, "dark frames"), (3, 4, "usable levels"), (-1, 4, "full scale")],
)
def test_too_little_is_refused(levels: int, darks: int, words: str) -> None:
    truth = random_sensor(np.random.default_rng(5))
    full_scale = 2**truth.bit_depth - 1
    pairs, dark, _ = transfer_frames(truth, 7)
    if levels < 0:
        pairs = [(np.full_like(a, full_scale), np.full_like(b, full_scale)) for a, b in pairs]
    with pytest.raises(DataError, match=words):
        photon_transfer(pairs[: levels if levels > 0 else None], dark[:darks], full_scale)
