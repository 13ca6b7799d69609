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
_IN_A_ROW: Final = 3
_SPREAD: Final = 0.2


def wrong_rate(relation: ClockRelation) -> str:
    """How fast the camera's clock runs, if that is not possible for one that counts ns; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MOST_PPM:
        return ""
    return f"the camera's clock runs {1.0 + 1e-6 * relation.drift_ppm:.6g} times as fast as the computer's"


class ClockWatch:
    """Compares the clocks over the first seconds of frames, whatever the driver.

    A wrong unit shows in any stretch of frames, each time as much. Frames that a busy computer takes late,
    and then catches up with, can look like one in a single stretch: the clock is refused only if three in a
    row, of `window_ns` each, show the same.
    """

    def __init__(self, window_ns: int = 3_000_000_000) -> None:
        self._window_ns = window_ns
        self._frames: list[tuple[int, int, int]] = []
        self._found: list[float] = []
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
        if seen[-1][1] - seen[0][1] < self._window_ns or len(seen) < _FEWEST:
            return
        device_ns, host_ns, sequence = np.array(seen, dtype=np.int64).T
        seen.clear()
        try:
            relation = relate_clocks(device_ns, host_ns, sequence)
        except DataError:
            return  # times that do not rise are for the preflight and rig calibrate clock to report
        wrong = wrong_rate(relation)
        if not wrong:
            self._done = True
            return
        self._found = [*self._found, relation.drift_ppm][-_IN_A_ROW:]
        mean = sum(self._found) / len(self._found)
        same = all(abs(drift - mean) < _SPREAD * abs(mean) for drift in self._found)
        if len(self._found) == _IN_A_ROW and same:
            raise DeviceError(
                f"{wrong}, at most {MOST_PPM:g} ppm are possible: its times cannot be used; "
                "the driver misreads its unit, or the computer's clock was set: see rig doctor"
            )
