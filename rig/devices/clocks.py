"""Clocks: the host's against UTC, and the rate of the camera's clock during a run."""

import ctypes
import math
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import PTP_STATUS_FEATURES, Camera, Frame, HasFeatures
from acquisition.frames.guard import MAX_DRIFT_PPM, clock_rate_text
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import ClockAnchor, RecordedClockStep
from calibration import ClockRelation, relate_clocks
from processing.errors import DataError, DeviceError
from processing.units import seconds
from rig.control import run_in_thread
from rig.instrument import CameraClock

_TIME_ERROR, _UNSYNCHRONISED = 5, 0x40


class _Timex(ctypes.Structure):
    """The first members of Linux's struct timex, and memory for the others."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("frequency", ctypes.c_long),
        ("largest_error_us", ctypes.c_long),
        ("estimated_error_us", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_long * 32),
    )


def u_of_kernel_clock() -> float:
    """Standard uncertainty in s of the clock of the day; NaN unless the kernel calls it synchronised."""
    if not sys.platform.startswith("linux"):
        return math.nan
    state = _Timex()
    try:
        clock_state = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        return math.nan
    synchronised = 0 <= clock_state < _TIME_ERROR and not state.status & _UNSYNCHRONISED
    return float(state.estimated_error_us * 1e-6) if synchronised else math.nan


def impossible_rate_text(relation: ClockRelation) -> str:
    """The rate of the camera's clock in words if no clock that counts ns can have it; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MAX_DRIFT_PPM:
        return ""
    return clock_rate_text(relation.drift_ppm)


_SYNCHRONISED: Final = "Slave"
"""State of a camera's clock that follows the network's, in the words of IEEE 1588."""
_POLL_INTERVAL_S: Final = 0.5


def wait_for_network_clock(
    camera: Camera, timeout_s: float = 60.0, stop: threading.Event | None = None
) -> None:
    """Return when the camera reports that its clock follows the network's, or when `stop` is set.

    Raises DeviceError, with the camera's state, after `timeout_s`.
    """
    stop = stop or threading.Event()
    deadline_s = time.monotonic() + timeout_s
    while (state := _clock_state(camera)) != _SYNCHRONISED:
        if time.monotonic() > deadline_s:
            raise DeviceError(
                f"camera.ptp = true: after {timeout_s:g} s its clock is not the network's, its state is "
                f"{state or 'not known'}; is a clock running there (ptp4l), and does the switch pass it on?"
            )
        if stop.wait(min(_POLL_INTERVAL_S, timeout_s)):
            return


def _clock_state(camera: Camera) -> str:
    if not isinstance(camera, HasFeatures):
        return ""
    values = map(camera.feature_value, PTP_STATUS_FEATURES)
    return next((str(value) for value in values if value is not None), "")


_ANCHOR_INTERVAL_NS = 10_000_000_000
_MIN_STEP_NS = 2_000_000
_MAX_SLEW = 1e-3
"""Largest change of rate that is no step; systems that correct a clock smoothly use at most half of it."""


class HostClockReading(NamedTuple):
    """Both clocks of the computer at the same moment."""

    host_time_ns: int
    utc_ns: int
    duration_ns: int
    """Duration of the reading."""


def read_clocks() -> HostClockReading:
    """Read the clock of the day between two readings of the monotonic one."""
    start_ns = time.monotonic_ns()
    utc_ns = time.time_ns()
    end_ns = time.monotonic_ns()
    return HostClockReading((start_ns + end_ns) // 2, utc_ns, end_ns - start_ns)


class ClockAnchors:
    """Anchors of the computer's two clocks, every 10 s and after every step of the clock of the day."""

    def __init__(self) -> None:
        self._last: HostClockReading | None = None
        self._due_ns = 0

    def take(self, time_ns: int) -> tuple[ClockAnchor | None, list[Event]]:
        """An anchor, if one is due, and an event, if the clock of the day has stepped.

        `time_ns` is the time of the latest frame.
        """
        now, last = read_clocks(), self._last
        self._last = now
        events: list[Event] = []
        if last is not None:
            elapsed_ns = now.host_time_ns - last.host_time_ns
            step_ns = (now.utc_ns - last.utc_ns) - elapsed_ns
            allowed_ns = _MIN_STEP_NS + _MAX_SLEW * elapsed_ns + now.duration_ns + last.duration_ns
            if abs(step_ns) > allowed_ns:
                text = f"the computer's clock of the day moved by {seconds(step_ns):+.3f} s"
                events.append(Event(time_ns, EventKind.CLOCK_STEP, text))
        if now.host_time_ns < self._due_ns and not events:
            return None, []
        self._due_ns = now.host_time_ns + _ANCHOR_INTERVAL_NS
        u_utc_s = math.hypot(u_of_kernel_clock(), 0.5e-9 * now.duration_ns)
        synchronised = math.isfinite(u_utc_s)
        return ClockAnchor(time_ns, now.host_time_ns, now.utc_ns, u_utc_s, synchronised), events


_MAX_PAIRS = 800
"""Largest number of pairs; at this number every second one is removed, also of later ones."""
_BLOCK_FRAMES = 8
"""Smallest number of frames of a long block that are used (fewer than twice as many); more would not improve
the rate."""
_FIRST_FIT_NS, _FIT_INTERVAL_NS = 3_000_000_000, 10_000_000_000
"""Time to the first fit, which is early so that a user sees a value, and between fits."""


class ClockRate:
    """Rate of the camera's clock: every 10 s of the run a line is fitted to some hundred pairs of times.

    A thread of its own fits it, so that frames do not wait for the 10 ms that a fit takes; a later call
    raises its error.
    """

    def __init__(self) -> None:
        self._pairs: list[tuple[int, int, int]] = []
        self._stride = 1
        self._frame_count = 0
        self._due_ns = 0
        self._fit: Future[tuple[float, float] | None] | None = None
        self._rate_ppm = (math.nan, math.nan)
        self._steps_s: list[float] = []

    def take(self, frames: Sequence[Frame], steps: Iterable[RecordedClockStep] = ()) -> CameraClock:
        """The present estimate, after frames and the clock's steps before them."""
        self._steps_s += [seconds(step.step_ns) for step in steps]
        for frame in frames[:: max(1, len(frames) // _BLOCK_FRAMES)]:
            # the time is negative if the camera has no clock
            if frame.device_time_ns >= 0:
                self._add_pair(frame)
        if self._fit is not None and self._fit.done():
            fit, self._fit = self._fit, None
            self._rate_ppm = fit.result() or self._rate_ppm
        largest_s = max(self._steps_s, key=abs, default=0.0)
        return CameraClock(*self._rate_ppm, len(self._steps_s), largest_s)

    def _add_pair(self, frame: Frame) -> None:
        host_ns = frame.host_time_ns
        self._frame_count += 1
        if self._frame_count % self._stride == 0:
            self._pairs.append((frame.device_time_ns, host_ns, frame.sequence))
            if len(self._pairs) >= _MAX_PAIRS:
                del self._pairs[1::2]
                self._stride *= 2
        if not self._due_ns:
            self._due_ns = host_ns + _FIRST_FIT_NS
        if host_ns >= self._due_ns and self._fit is None:
            self._due_ns = host_ns + _FIT_INTERVAL_NS
            self._fit = run_in_thread(_fitted_rate_ppm, np.array(self._pairs, dtype=np.int64))


def _fitted_rate_ppm(table: NDArray[np.int64]) -> tuple[float, float] | None:
    """The rate and its u from rows of camera's time, host's time and number; None with too few pairs."""
    # of frames that were read at the same moment, the first is kept
    keep = np.concatenate(([True], np.diff(np.maximum.accumulate(table[:, 1])) > 0))
    device_ns, host_ns, sequence = table[keep].T
    try:
        relation = relate_clocks(device_ns, host_ns, sequence)
    except DataError:
        return None
    return relation.drift_ppm, relation.u_drift_ppm
