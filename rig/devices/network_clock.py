"""Waits until a camera's clock follows that of the network (IEEE 1588): its times jump when it begins to."""

import threading
import time
from typing import Final

from acquisition.camera import CLOCK_STATES, Camera, HasFeatures
from processing.errors import DeviceError

_FOLLOWS: Final = "Slave"
_PATIENCE_S: Final = 60.0
_POLL_S: Final = 0.5


def wait_for_network_clock(
    camera: Camera, timeout_s: float = _PATIENCE_S, ended: threading.Event | None = None
) -> None:
    """Return when the camera says that it follows, or when `ended` is set.

    Raises DeviceError, with the camera's state, after `timeout_s`.
    """
    ended = ended or threading.Event()
    deadline_s = time.monotonic() + timeout_s
    while (state := _state(camera)) != _FOLLOWS:
        if time.monotonic() > deadline_s:
            raise DeviceError(
                f"camera.ptp = true: after {timeout_s:g} s its clock is not the network's, its state is "
                f"{state or 'not known'}; is a clock running there (ptp4l), and does the switch pass it on?"
            )
        if ended.wait(min(_POLL_S, timeout_s)):
            return


def _state(camera: Camera) -> str:
    if isinstance(camera, HasFeatures):
        for name in CLOCK_STATES:
            value = camera.feature_value(name)
            if value is not None:
                return str(value)
    return ""
