"""Fixtures of the USB3 Vision driver's tests."""

import pytest

from tests.acquisition.cameras.usb3vision.device import VisionDevice


@pytest.fixture
def device() -> VisionDevice:
    """A camera that waits long for a slow reader."""
    return VisionDevice(frames_inside=1000)
