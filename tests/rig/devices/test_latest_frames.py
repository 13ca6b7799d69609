"""The search of an exposure takes no frame that no camera may deliver."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus, Frame
from processing.errors import DeviceError
from rig.devices import find_exposure

INFO = CameraInfo("own", "Somebody", "Their own", "1", 10, 12, 255, has_clock=False)
EXPOSED = CameraSettings(exposure_us=100.0)


class Strange:
    """A driver of one's own: `made` gives what it delivers by its number."""

    def __init__(self, made: Callable[[int], Any]) -> None:
        self._made, self._number = made, 0

    def open(self) -> CameraInfo:
        return INFO

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return EXPOSED

    def start(self) -> None:
        self._number = 0

    def read(self, timeout_s: float) -> Frame | None:
        self._number += 1
        made: Frame = self._made(self._number - 1)
        return made

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    @property
    def status(self) -> CameraStatus:
        return CameraStatus()


ONE_BUFFER = np.zeros((12, 10), np.uint8)


def again(number: int) -> Frame:
    ONE_BUFFER[:] = number
    return Frame(ONE_BUFFER, number, number, time.monotonic_ns())


def floating(number: int) -> Frame:
    return Frame(np.full((12, 10), 0.5), number, number, time.monotonic_ns())


def growing(number: int) -> Frame:
    return Frame(np.ones((12, 10 + number), np.uint8), number, number, time.monotonic_ns())


STRANGE = [
    (again, "the image of frame 0 has changed since it was delivered"),
    (floating, r"shape \(12, 10\) and type float64"),
    (growing, "frame 1 has 11 x 12 pixels"),
    (lambda number: np.ones((12, 10), np.uint8), r"read\(\) returned ndarray"),
]


@pytest.mark.parametrize(("made", "said"), STRANGE)
def test_no_frame_is_taken_that_no_camera_may_deliver(made: Callable[[int], Any], said: str) -> None:
    with pytest.raises(DeviceError, match=said):
        find_exposure(Strange(made), INFO, EXPOSED)
