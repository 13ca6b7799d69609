"""Packed grey formats of Video4Linux, as sensors on a Raspberry Pi deliver them.

The kernel's test driver has none of them, so that buffers are made here from the kernel's description.
"""

import numpy as np
import pytest

from acquisition.cameras.v4l2.kernel import PixelLayout
from acquisition.cameras.v4l2.layouts import choose, image_bytes, to_image


@pytest.mark.parametrize(("fourcc", "bits", "group"), [("Y10P", 10, 4), ("Y12P", 12, 2)])
@pytest.mark.parametrize("width", [32, 30])
def test_packed_pixels_are_those_of_the_sensor(fourcc: str, bits: int, group: int, width: int) -> None:
    height, row_bytes = 5, 64  # rows are longer than their pixels
    pixels = np.random.default_rng(4).integers(0, 1 << bits, (height, width))
    low = bits - 8
    buffer = bytearray(height * row_bytes)
    for y in range(height):
        for x in range(width):
            start = y * row_bytes + x // group * (group + 1)
            buffer[start + x % group] = int(pixels[y, x]) >> low
            buffer[start + group] |= (int(pixels[y, x]) & ((1 << low) - 1)) << (low * (x % group))
    layout = PixelLayout(width, height, fourcc, row_bytes, len(buffer))
    assert image_bytes(layout) == len(buffer)
    image = to_image(memoryview(buffer), layout)
    assert np.array_equal(image, pixels)
    assert image.dtype == np.uint16
    assert not image.flags.writeable


def test_whole_words_are_preferred_to_packed_pixels() -> None:
    assert choose(["Y10P", "Y10 "], "mono10") == "Y10 "
    assert choose(["Y10P", "pBAA"], None) == "Y10P"
    assert choose(["Y14 "], "mono14") == "Y14 "
