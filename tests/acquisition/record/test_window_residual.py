"""Windows without what the fitted spot says: every pixel comes back, by the rule that the documents state."""

import math
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from acquisition.record.codec import decode_window, encode_window
from acquisition.record.topics import WINDOW
from processing.spot import Spot

GAIN_E_PER_DN, READ_NOISE_E = 39.2, 7.0
SIZE = st.floats(allow_nan=True, allow_infinity=True, width=64) | st.floats(-50.0, 300.0)
SPOTS = st.builds(
    Spot,
    *[SIZE, SIZE, st.just(0.01), st.just(0.01)],
    *[SIZE, SIZE, st.floats(-2.0, 2.0), SIZE, SIZE, st.just(1.0), st.just(0)],
)


def shot_noise(spot: Spot, seed: int, dtype: str = "u1", per_dn: float = 1.0) -> np.ndarray[Any, Any]:
    """Pixels of a spot on a sensor, 80 px wide; the window's first pixel is (100, 200)."""
    y, x = np.mgrid[200:280, 100:180].astype(float)
    cos, sin = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
    along = ((x - spot.x_px) * cos + (y - spot.y_px) * sin) / spot.sigma_x_px
    across = ((y - spot.y_px) * cos - (x - spot.x_px) * sin) / spot.sigma_y_px
    gain_e = GAIN_E_PER_DN / per_dn
    light_e = spot.amplitude_dn * gain_e * np.exp(-0.5 * (along**2 + across**2))
    random = np.random.default_rng(seed)
    electrons = random.poisson(light_e) + random.normal(0.0, READ_NOISE_E, light_e.shape)
    image = np.rint(electrons / gain_e + spot.background_dn).clip(0, 2 ** (8 * np.dtype(dtype).itemsize) - 1)
    return image.astype(dtype)


def field(message: bytes) -> dict[str, Any]:
    found = dict(zip(WINDOW.names, WINDOW.decode(message), strict=True))
    return found | {
        "pixels": zstandard.decompress(found["pixels"]) if found["compressed"] else found["pixels"]
    }


def spot(
    seed: int, sigma: tuple[float, float] = (6.0, 7.0), rotation_rad: float = 0.0, scale: float = 1.0
) -> Spot:
    x_px, y_px = np.random.default_rng(seed).uniform((135.0, 235.0), (145.0, 245.0)).tolist()
    return Spot(x_px, y_px, 0.01, 0.01, *sigma, rotation_rad, 170.0 * scale, 6.0 * scale, 1.0, 0)


@given(
    image=npst.arrays(
        st.sampled_from([np.uint8, np.uint16]), st.tuples(st.integers(1, 9), st.integers(1, 9))
    ),
    origin=st.tuples(st.integers(0, 5000), st.integers(0, 5000)),
    spot=st.none() | SPOTS,
    transposed=st.booleans(),
)
@settings(max_examples=120, deadline=None)
def test_pixels_come_back_whatever_the_spot_is(
    image: np.ndarray[Any, Any], origin: tuple[int, int], spot: Spot | None, transposed: bool
) -> None:
    image = image.T if transposed else image
    window = decode_window(WINDOW, encode_window(7, 8, image, *origin, spot))
    assert (window.sequence, window.time_ns, window.origin_px) == (7, 8, origin)
    assert window.image.dtype == image.dtype
    np.testing.assert_array_equal(window.image, image)


@pytest.mark.parametrize(("dtype", "scale"), [("u1", 1.0), ("u2", 16.0)])
def test_a_spot_comes_back_by_the_rule_of_the_documents(dtype: str, scale: float) -> None:
    """docs/reference/record.md in plain Python, one pixel after the other."""
    image = shot_noise(spot(1, scale=scale), 1, dtype, scale)
    stored = field(encode_window(1, 2, image, 100, 200, spot(1, scale=scale)))
    table = [round(4096 * math.exp(-i / 512)) for i in range(9216)] + [0]
    planes, width, height = stored["bit_planes"], stored["width_px"], stored["height_px"]
    assert 0 < planes < 8 * image.itemsize
    in_plane = math.ceil(width * height / 8)
    for row in range(height):
        for column in range(width):
            i = min((256 * column - stored["model_x"]) ** 2 * stored["model_inverse_x"] >> 40, 9216)
            j = min((256 * row - stored["model_y"]) ** 2 * stored["model_inverse_y"] >> 40, 9216)
            height_dn8 = stored["model_amplitude"] * table[j] >> 12
            drawn = (height_dn8 * table[i] + (stored["model_background"] << 12) + 2**14) >> 15
            place, bit = divmod(row * width + column, 8)
            folded = sum(
                (stored["pixels"][plane * in_plane + place] >> (7 - bit) & 1) << plane
                for plane in range(planes)
            )
            rest = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
            assert (drawn + rest) % 2 ** (8 * image.itemsize) == image[row, column]


@pytest.mark.parametrize(("dtype", "scale", "at_most"), [("u1", 1.0, 0.6), ("u2", 16.0, 0.8)])
def test_an_upright_spot_takes_much_less_room(dtype: str, scale: float, at_most: float) -> None:
    spots = [spot(seed, scale=scale) for seed in range(60)]
    images = [shot_noise(spot, seed, dtype, scale) for seed, spot in enumerate(spots)]
    whole, rest = (
        b"".join(
            encode_window(0, 0, image, 100, 200, known) for image, known in zip(images, given, strict=True)
        )
        for given in ([None] * 60, spots)
    )
    compressor = zstandard.ZstdCompressor(level=1)
    assert len(compressor.compress(rest)) < at_most * len(compressor.compress(whole))


def test_a_tilted_spot_is_stored_as_it_is() -> None:
    tilted = spot(3, (4.0, 8.0), 0.7)
    image = shot_noise(tilted, 3)
    stored = field(encode_window(1, 2, image, 100, 200, tilted))
    assert (stored["bit_planes"], stored["model_inverse_x"]) == (0, 0)
    assert stored["pixels"] == image.tobytes()
