"""The rate of the camera's clock during a run, from frames that are spread over the whole of it."""

import math
import threading
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.record.topics import RecordedClockStep
from calibration import relate_clocks
from processing.errors import DataError
from processing.ticks import seconds
from rig.instrument import CameraClock

_MOST_FRAMES = 800
"""When there are so many, every second is left out, and of those to come as many."""
_LOOKED_AT = 8
"""Frames of a block; more tell no more."""
_FIRST_NS, _BETWEEN_NS = 3_000_000_000, 10_000_000_000
"""Between looks; the first is soon, so that it is seen to be read."""


class ClockRate:
    """Keeps some hundred pairs of times, and puts a line through them every ten seconds of the run.

    With `beside` the line is found by a thread of its own: it takes 10 ms, for which frames would wait. Its
    failure is raised by the next call.
    """

    def __init__(self, *, beside: bool = True) -> None:
        self._beside = beside
        self._pairs: list[tuple[int, int, int]] = []
        self._every = 1
        self._passed = 0
        self._due_ns = 0
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        self._rate_ppm = (math.nan, math.nan)
        self._steps_s: list[float] = []

    def take(self, frames: Sequence[Frame], steps: Iterable[RecordedClockStep] = ()) -> CameraClock:
        """Take frames and the clock's steps before them into account; the clock as it is known now."""
        self._steps_s += [seconds(step.step_ns) for step in steps]
        for frame in frames[:: max(1, len(frames) // _LOOKED_AT)]:
            # one without a clock has none to be read
            if frame.device_time_ns >= 0:
                self.pair(frame.sequence, frame.device_time_ns, frame.host_time_ns)
        return self.now

    def take_rows(self, rows: NDArray[Any]) -> CameraClock:
        """The same of rows of a record."""
        rows = rows[:: max(1, len(rows) // _LOOKED_AT)]
        for device_ns, host_ns, sequence in rows[["device_time_ns", "host_time_ns", "sequence"]].tolist():
            if device_ns >= 0:
                self.pair(sequence, device_ns, host_ns)
        return self.now

    def pair(self, sequence: int, device_ns: int, host_ns: int) -> None:
        """Take one frame's times into account."""
        self._passed += 1
        if self._passed % self._every == 0:
            self._pairs.append((device_ns, host_ns, sequence))
            if len(self._pairs) >= _MOST_FRAMES:
                del self._pairs[1::2]
                self._every *= 2
        if not self._due_ns:
            self._due_ns = host_ns + _FIRST_NS
        if host_ns >= self._due_ns and (self._thread is None or not self._thread.is_alive()):
            self._due_ns = host_ns + _BETWEEN_NS
            table = np.array(self._pairs, dtype=np.int64)
            if self._beside:
                self._thread = threading.Thread(target=self._look, args=(table,), name="clock", daemon=True)
                self._thread.start()
            else:
                self._look(table)

    @property
    def now(self) -> CameraClock:
        """The clock as it is known now. Raises what the last look has raised."""
        error, self._error = self._error, None
        if error is not None:
            raise error
        drift_ppm, u_drift_ppm = self._rate_ppm
        largest_s = max(self._steps_s, key=abs, default=0.0)
        return CameraClock(drift_ppm, u_drift_ppm, len(self._steps_s), largest_s)

    def _look(self, table: NDArray[np.int64]) -> None:
        try:
            # of frames that were read at the same moment the first
            keep = np.concatenate(([True], np.diff(np.maximum.accumulate(table[:, 1])) > 0))
            device_ns, host_ns, sequence = table[keep].T
            relation = relate_clocks(device_ns, host_ns, sequence)
        except DataError:
            # too few as yet
            return
        except Exception as error:
            self._error = error
            return
        self._rate_ppm = (relation.drift_ppm, relation.u_drift_ppm)
