"""The camera's clock against the host's: a clock that runs too fast or too slow counts in another unit."""

from typing import Final

import numpy as np

from acquisition.frame import Frame
from calibration import ClockRelation, relate_clocks
from processing.errors import DataError, DeviceError

MOST_PPM: Final = 1000.0
"""A quartz is right within 100 ppm: a clock that runs otherwise counts in another unit than was believed."""
_WINDOW_NS: Final = 3_000_000_000
_FEWEST: Final = 60


def wrong_rate(relation: ClockRelation) -> str:
    """How fast the camera's clock runs, if that is not possible for one that counts ns; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MOST_PPM:
        return ""
    return f"the camera's clock runs {1.0 + 1e-6 * relation.drift_ppm:.6g} times as fast as the computer's"


class ClockWatch:
    """Compares the clocks over the first seconds of frames, whatever the driver.

    A wrong unit shows in any stretch of frames. Frames that a busy computer takes late can look like one in
    a single stretch: the clock is refused only if two in a row, of three seconds each, show it.
    """

    def __init__(self) -> None:
        self._frames: list[tuple[int, int, int]] = []
        self._suspicions = 0
        self._done = False

    def begin_anew(self) -> None:
        """The camera was opened again: the stretch begins again."""
        self._frames.clear()

    def see(self, frame: Frame) -> None:
        """Take the next frame into account; raises DeviceError if the clock cannot be right."""
        if self._done:
            return
        if frame.device_time_ns < 0:
            self._done = True
            return
        seen = self._frames
        seen.append((frame.device_time_ns, frame.host_time_ns, frame.sequence))
        if seen[-1][1] - seen[0][1] < _WINDOW_NS or len(seen) < _FEWEST:
            return
        device_ns, host_ns, sequence = np.array(seen, dtype=np.int64).T
        seen.clear()
        try:
            wrong = wrong_rate(relate_clocks(device_ns, host_ns, sequence))
        except DataError as error:
            wrong = str(error)
        self._suspicions = self._suspicions + 1 if wrong else 0
        self._done = not wrong
        if self._suspicions == 2:
            raise DeviceError(
                f"{wrong}, at most {MOST_PPM:g} ppm are possible: its times cannot be used; "
                "the driver misreads its unit, or the computer's clock was set: see rig doctor"
            )
