"""Packed grey formats of Video4Linux, as sensors on a Raspberry Pi deliver them.

The kernel's test driver has none of them, so that buffers are made here from the kernel's description.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.camera import CameraSettings, ColourPlane, PixelFormat
from acquisition.cameras.drivers import V4l2Settings
from acquisition.cameras.pixel_formats import preferred_name
from acquisition.cameras.v4l2 import devices, kernel
from acquisition.cameras.v4l2.camera import LinuxSource
from acquisition.cameras.v4l2.devices import LAYOUTS, VideoDevice, find_device, image_bytes, to_image
from acquisition.cameras.v4l2.kernel import PixelLayout
from processing.errors import DeviceError


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
    layout = PixelLayout(width, height, fourcc, row_bytes)
    assert image_bytes(layout) == len(buffer)
    image = to_image(memoryview(buffer), layout)
    assert np.array_equal(image, pixels)
    assert image.dtype == np.uint16
    assert not image.flags.writeable


# of each mosaic, the colours of its first two rows, as the kernel's description has them
MOSAICS = {
    "RGGB": ("RG", "GB"), "GRBG": ("GR", "BG"), "GBRG": ("GB", "RG"), "BA81": ("BG", "GR"),
    "RG10": ("RG", "GB"), "BA10": ("GR", "BG"), "GB10": ("GB", "RG"), "BG10": ("BG", "GR"),
    "RG12": ("RG", "GB"), "BA12": ("GR", "BG"), "GB12": ("GB", "RG"), "BG12": ("BG", "GR"),
    "RG16": ("RG", "GB"), "GR16": ("GR", "BG"), "GB16": ("GB", "RG"), "BYR2": ("BG", "GR"),
    "pRAA": ("RG", "GB"), "pgAA": ("GR", "BG"), "pGAA": ("GB", "RG"), "pBAA": ("BG", "GR"),
    "pRCC": ("RG", "GB"), "pgCC": ("GR", "BG"), "pGCC": ("GB", "RG"), "pBCC": ("BG", "GR"),
}  # fmt: skip
LEVELS = {"R": 0xB7, "G": 0x5A, "B": 0x21}


@pytest.mark.parametrize("fourcc", MOSAICS)
def test_one_colour_of_a_mosaic(fourcc: str) -> None:
    """Every pixel says its colour in its high bits and, with the low ones, its row."""
    width, height = 24, 10
    bits = {"AA": 10, "CC": 12, "10": 10, "12": 12, "16": 16, "R2": 16}.get(fourcc[2:], 8)
    low = bits - 8
    group = {"AA": 4, "CC": 2}.get(fourcc[2:], 0)
    colours = [[MOSAICS[fourcc][y % 2][x % 2] for x in range(width)] for y in range(height)]
    values = np.array(
        [[(LEVELS[c] << low) | (y & ((1 << low) - 1)) for c in row] for y, row in enumerate(colours)]
    )
    if group:
        rows = bytearray()
        for row in values.tolist():
            for first in range(0, width, group):
                pixels = row[first : first + group]
                rows += bytes(pixel >> low for pixel in pixels)
                rows.append(sum((p & ((1 << low) - 1)) << (low * i) for i, p in enumerate(pixels)))
        buffer = bytes(rows)
    else:
        buffer = values.astype("u1" if bits == 8 else "<u2").tobytes()
    layout = PixelLayout(width, height, fourcc, len(buffer) // height)
    planes: tuple[ColourPlane, ...] = ("red", "green", "blue")
    for plane in planes:
        image = to_image(memoryview(buffer), layout, plane)
        letter = plane[0].upper()
        row = next(y for y in (0, 1) if ("B" if plane == "blue" else "R") in colours[y])
        assert image.shape == (height // 2, width // 2)
        assert image.flags.c_contiguous
        assert not image.flags.writeable
        assert (image >> low == LEVELS[letter]).all()
        assert np.array_equal(image, values[row::2, colours[row].index(letter) :: 2])


def chosen(offered: list[str], wanted: PixelFormat | None, plane: ColourPlane | None = None) -> str:
    return preferred_name("camera", offered, wanted, plane, LAYOUTS)


def test_a_mosaic_is_taken_where_a_colour_is_asked_for() -> None:
    assert chosen(["RGGB", "pRAA", "GREY"], None) == "GREY"
    assert chosen(["RGGB", "pRAA", "GREY"], None, "red") == "RGGB"
    assert chosen(["pRAA", "RG10"], "mono10", "red") == "RG10"
    with pytest.raises(DeviceError, match=r"no grey pixel format, only pRAA; set camera\.colour_plane"):
        chosen(["pRAA"], None)
    with pytest.raises(DeviceError, match=r"no Bayer format, only GREY; leave camera\.colour_plane out"):
        chosen(["GREY"], None, "red")


def test_whole_words_are_preferred_to_packed_pixels() -> None:
    assert chosen(["Y10P", "Y10 "], "mono10") == "Y10 "
    assert chosen(["Y10P", "pBAA"], None) == "Y10P"
    assert chosen(["Y14 "], "mono14") == "Y14 "


@pytest.mark.parametrize(
    ("path", "serial", "expected"),
    [
        (None, None, r"several cameras: /dev/video0 A 1; /dev/video2 B 2; set camera\.v4l2\.device"),
        (None, "7", "no camera has the serial number '7'; there are: /dev/video0 A 1; /dev/video2 B 2"),
        ("7", None, "/dev/video7: is not a camera; there are: /dev/video0 A; /dev/video1 A; /dev/video2 B"),
        (None, "2", "/dev/video2"),
        ("0", "2", "/dev/video0"),
        (None, "3", "video3: no permission"),
    ],
)
def test_one_device_is_chosen_or_all_are_named(
    monkeypatch: pytest.MonkeyPatch, path: str | None, serial: str | None, expected: str
) -> None:
    """The second device gives no images that can be read, and the last one may not be opened."""
    found = [
        VideoDevice("/dev/video0", "A", "usb-1", "1", ("GREY",), ()),
        VideoDevice("/dev/video1", "A", "usb-1", "1", ("MJPG",), ()),
        VideoDevice("/dev/video2", "B", "usb-2", "2", ("YUYV",), ()),
        VideoDevice("/dev/video3", "", "", "3", (), (), "/dev/video3: no permission"),
    ]
    monkeypatch.setattr(devices, "list_devices", lambda: found)
    if expected.startswith("/dev/video") and ":" not in expected:
        assert find_device(path, serial).path == expected
    else:
        with pytest.raises(DeviceError, match=expected):
            find_device(path, serial)


def test_an_exposure_is_set_in_the_kernels_steps_of_a_tenth_of_a_millisecond(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written: list[int] = []
    source, controls = (
        LinuxSource(V4l2Settings()),
        {kernel.EXPOSURE_ABSOLUTE: SimpleNamespace(lowest=1, highest=99)},
    )
    monkeypatch.setattr(source, "_controls", lambda: controls)
    monkeypatch.setattr(kernel, "set_control", lambda _device, _name, steps: written.append(steps))
    source._set_exposure(CameraSettings(exposure_us=2000.0))
    assert written == [20]
