"""Compiles what is compiled at its first use, before a camera delivers frames that could be lost."""

import threading
from collections.abc import Callable

import numpy as np

from processing.spot import SensorModel, SpotTracker
from processing.swing import compile_kernels

_SIDE_PX, _SIGMA_PX = 64, 4.0
_SAY_AFTER_S = 2.0


def prepare_kernels(sensor: SensorModel, say: Callable[[str], None]) -> None:
    """Track a drawn spot and detect drawn swings once.

    After an installation that takes about a minute, later on (from the cache) less than a second.
    `say` gets a line where it takes longer than two seconds.
    """
    text = "compiling the numerical kernels; once after an installation, about a minute"
    timer = threading.Timer(_SAY_AFTER_S, say, [text])
    timer.daemon = True
    timer.start()
    try:
        _track(sensor)
        compile_kernels()
    finally:
        timer.cancel()


def _track(sensor: SensorModel) -> None:
    """A frame that is searched and one that is followed, in the type that such a camera delivers."""
    y, x = np.mgrid[0:_SIDE_PX, 0:_SIDE_PX] - 0.5 * (_SIDE_PX - 1)
    spot = 0.5 * sensor.full_scale_dn * np.exp(-0.5 * (x**2 + y**2) / _SIGMA_PX**2)
    image = spot.astype(np.uint8 if sensor.full_scale_dn <= np.iinfo(np.uint8).max else np.uint16)
    tracker = SpotTracker(sensor)
    for _ in range(2):
        tracker.track(image)
