"""Unpacking of packed pixels against numpy's bit operations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.cameras.pixel_formats import BAYER_FORMATS, BY_NAME, FORMATS
from tests.acquisition.cameras.usb3vision.description import FORMATS as CODES
from tests.acquisition.cameras.usb3vision.packing import pack


def test_the_numbers_are_those_of_the_naming_convention() -> None:
    for item in (*FORMATS, *BAYER_FORMATS):
        assert CODES.get(item.name, item.code) == item.code
        assert (item.code >> 16) & 0xFF == item.transport_bits


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["Mono8", "Mono10", "Mono12", "Mono14", "Mono16", "Mono10p", "Mono10Packed", "Mono12p", "Mono12Packed"],
)
@given(width=st.integers(1, 40), height=st.integers(1, 9), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)  # the first call compiles the kernel
def test_packed_and_unpacked_is_the_same_image(name: str, width: int, height: int, seed: int) -> None:
    item = BY_NAME[name]
    pixels = np.random.default_rng(seed).integers(0, item.full_scale_dn + 1, (height, width))
    raw = np.frombuffer(pack(pixels, item.code), np.uint8)
    assert raw.size == item.byte_count(width, height)
    image = item.image(raw, width, height)
    assert image.shape == (height, width)
    assert np.array_equal(image, pixels)


def test_extreme_pixels_do_not_touch_their_neighbours() -> None:
    for name in ("Mono10p", "Mono10Packed", "Mono12p", "Mono12Packed"):
        item = BY_NAME[name]
        for lit in range(8):
            pixels = np.zeros((1, 8), np.int64)
            pixels[0, lit] = item.full_scale_dn
            image = item.image(np.frombuffer(pack(pixels, item.code), np.uint8), 8, 1)
            assert np.array_equal(image, pixels)


@pytest.mark.parametrize(
    ("name", "width_px", "whole"),
    [
        ("Mono8", 3, True),
        ("Mono12p", 4, True),
        ("Mono12p", 5, False),
        ("Mono10p", 6, False),
        ("Mono16", 5, True),
    ],
)
def test_rows_are_padded_only_where_they_end_with_a_byte(name: str, width_px: int, whole: bool) -> None:
    assert BY_NAME[name].rows_end_with_bytes(width_px) is whole
