"""Fixtures of the USB3 Vision driver's tests."""

from collections.abc import Iterator

import pytest

from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from tests.acquisition.cameras.usb3vision.backend import camera_on
from tests.acquisition.cameras.usb3vision.device import VisionDevice


@pytest.fixture
def device() -> VisionDevice:
    """A camera that waits long for a slow reader."""
    return VisionDevice(frames_inside=1000)


@pytest.fixture
def camera(device: VisionDevice) -> Iterator[Usb3VisionCamera]:
    """The driver with this camera open."""
    camera = camera_on(device)
    camera.open()
    yield camera
    camera.close()
