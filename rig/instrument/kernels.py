"""Compiles the numba kernels before a camera delivers frames, which would be lost meanwhile."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np

from acquisition.record.writer import compile_window
from processing import spot as spots
from processing import swing as swings
from processing.kernel import at_compilation
from processing.spot import SensorModel, SpotTracker

_SIDE_PX, _SIGMA_PX = 64, 4.0
_COMPILING = "compiling the numerical kernels (half a minute on an idle machine"
STILL_S = 20.0


def prepare_kernels(sensor: SensorModel, say: Callable[[str], None]) -> None:
    """Track a synthetic spot and detect synthetic swings once, which compiles the kernels.

    This takes half a minute after an installation, when a second process compiles those of the swings, and
    less than a second afterwards (from the cache). `say` is called with a line if something is compiled, and
    with another whenever it goes on for `STILL_S`.
    """
    with ExitStack() as until_all_is_done, ExitStack() as until_both_have_ended:

        def announce(kept: bool) -> None:
            until_all_is_done.enter_context(_going_on(say))
            if kept:
                say(f"{_COMPILING}, only once after an installation)")
                until_both_have_ended.enter_context(_compiling_swings())
            else:
                say(f"{_COMPILING}, at every start: no cache can be written; NUMBA_CACHE_DIR can name one)")

        with at_compilation(announce):
            compile_tracker(sensor)
            until_both_have_ended.close()
            swings.compile_kernels()


def compile_tracker(sensor: SensorModel) -> None:
    """Compile, or load from the cache, what follows a spot on this sensor and records it.

    Two frames of the camera's pixel type are tracked, the first searched, the second followed; one encoded.
    """
    y, x = np.mgrid[0:_SIDE_PX, 0:_SIDE_PX] - 0.5 * (_SIDE_PX - 1)
    spot = 0.5 * sensor.full_scale_dn * np.exp(-0.5 * (x**2 + y**2) / _SIGMA_PX**2)
    image = spot.astype(np.uint8 if sensor.full_scale_dn <= np.iinfo(np.uint8).max else np.uint16)
    tracker = SpotTracker(sensor)
    for _ in range(2):
        spot = tracker.track(image)
    compile_window(image, spot)
    spots.compile_kernels(sensor.pixel_noise)


@contextmanager
def _compiling_swings() -> Iterator[None]:
    """A process that fills the cache; what it could not compile is compiled by the one that waits for it."""
    program = "from processing.swing import compile_kernels; compile_kernels()"
    quiet = subprocess.DEVNULL
    process = subprocess.Popen([sys.executable, "-c", program], stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        yield
        process.wait()
    finally:
        process.kill()
        process.wait()


@contextmanager
def _going_on(say: Callable[[str], None]) -> Iterator[None]:
    """Says again and again that it still goes on."""
    begun_s, ended = time.monotonic(), threading.Event()

    def tell() -> None:
        while not ended.wait(STILL_S):
            say(f"still compiling, {time.monotonic() - begun_s:.0f} s so far")

    thread = threading.Thread(target=tell, name="compilation", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
