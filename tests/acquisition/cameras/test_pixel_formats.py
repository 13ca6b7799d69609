"""Unpacking of packed pixels against numpy's bit operations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.camera import CameraSettings
from acquisition.cameras.drivers import buffer_count
from acquisition.cameras.pixel_formats import BAYER_FORMATS, FORMATS
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.link import UsbLink
from acquisition.cameras.usb3vision.transfers import BlockingTransfers, Transfers
from tests.acquisition.cameras.usb3vision.backend import camera_on
from tests.acquisition.cameras.usb3vision.description import FORMATS as CODES
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.packing import pack


def test_the_numbers_are_those_of_the_naming_convention() -> None:
    for item in (*FORMATS, *BAYER_FORMATS):
        assert CODES.get(item.name, item.code) == item.code
        assert (item.code >> 16) & 0xFF == item.transport_bits


BY_NAME = {item.name: item for item in FORMATS}


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


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 333.3, 500.0, 2000.0])
def test_a_tenth_of_a_second_is_kept(rate_hz: float) -> None:
    assert buffer_count(rate_hz, 640 * 480, 4, 4096) / rate_hz >= 0.1


def test_bounds_hold_for_what_is_asked_too() -> None:
    assert buffer_count(None, 1, 64, 4096) == 64
    assert buffer_count(2000.0, 1, 4, 32) == 32
    assert buffer_count(2000.0, 100_000_000, 4, 4096) == 2
    assert buffer_count(2000.0, 10_000_000, 4, 4096) * 10_000_000 <= 256 * 2**20


def test_a_usb_camera_reads_a_tenth_of_a_second_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def transfers(_self: Usb3VisionCamera, link: UsbLink, ahead: int) -> Transfers:
        asked.append(ahead)
        return BlockingTransfers(link)

    monkeypatch.setattr(Usb3VisionCamera, "_transfers", transfers)
    camera = camera_on(VisionDevice())
    camera.open()
    for wanted_hz in (20.0, 200.0):
        applied = camera.configure(CameraSettings(frame_rate_hz=wanted_hz, exposure_us=100.0))
        assert applied.frame_rate_hz == pytest.approx(wanted_hz, rel=0.01)
        camera.start()
        camera.stop()
    camera.close()
    assert asked == [4, 21]
