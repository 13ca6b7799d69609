"""Buffers of the drivers: at least 100 ms of the camera's rate, unless the user asks for another number."""

import pytest

from acquisition.camera import CameraSettings
from acquisition.cameras.drivers import buffer_count
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.link import UsbLink
from acquisition.cameras.usb3vision.transfers import BlockingTransfers, Transfers
from tests.acquisition.cameras.usb3vision.backend import camera_on
from tests.acquisition.cameras.usb3vision.device import VisionDevice


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 333.3, 500.0, 2000.0])
def test_a_tenth_of_a_second_is_kept(rate_hz: float) -> None:
    assert buffer_count(None, rate_hz, 640 * 480, 4, 4096) / rate_hz >= 0.1


def test_bounds_hold_for_what_is_asked_too() -> None:
    assert buffer_count(7, 2000.0, 1, 64, 4096) == 7
    assert buffer_count(None, None, 1, 64, 4096) == 64
    assert buffer_count(None, 2000.0, 1, 4, 32) == 32
    assert buffer_count(None, 2000.0, 100_000_000, 4, 4096) == 2
    assert buffer_count(1000, 50.0, 10_000_000, 4, 4096) * 10_000_000 <= 256 * 2**20


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
