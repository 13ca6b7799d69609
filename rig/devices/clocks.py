"""Clocks: agreement of the host's with UTC, and the rate of the camera's during a run."""

import ctypes
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
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
    """Standard uncertainty in s of the clock of the day; NaN unless the kernel says it is synchronised."""
    if not sys.platform.startswith("linux"):
        return math.nan
    state = _Timex()
    try:
        answer = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        return math.nan
    synchronised = 0 <= answer < _TIME_ERROR and not state.status & _UNSYNCHRONISED
    return float(state.estimated_error_us * 1e-6) if synchronised else math.nan


def wrong_rate(relation: ClockRelation) -> str:
    """Rate of the camera's clock in words, if it is impossible for a clock that counts ns; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MAX_DRIFT_PPM:
        return ""
    return clock_rate_text(relation.drift_ppm)


_FOLLOWS: Final = "Slave"
_POLL_S: Final = 0.5


def wait_for_network_clock(
    camera: Camera, timeout_s: float = 60.0, ended: threading.Event | None = None
) -> None:
    """Return when the camera reports that its clock follows the network's, or when `ended` is set.

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
        for name in PTP_STATUS_FEATURES:
            value = camera.feature_value(name)
            if value is not None:
                return str(value)
    return ""


_PERIOD_NS = 10_000_000_000
_LEAST_STEP_NS = 2_000_000
_FASTEST_SLEW = 1e-3
"""Largest change of rate that is no step; systems that correct a clock smoothly use at most half of it."""


class HostClockReading(NamedTuple):
    """Both clocks of the computer at the same moment, and the time `apart_ns` between their readings."""

    host_time_ns: int
    utc_ns: int
    apart_ns: int


def read_clocks() -> HostClockReading:
    """Read the clock of the day between two readings of the monotonic one."""
    before = time.monotonic_ns()
    utc_ns = time.time_ns()
    after = time.monotonic_ns()
    return HostClockReading((before + after) // 2, utc_ns, after - before)


class ClockAnchors:
    """Anchors of the computer's two clocks, every 10 s and after every step of the clock of the day."""

    def __init__(self, read: Callable[[], HostClockReading] = read_clocks) -> None:
        self._read = read
        self._last: HostClockReading | None = None
        self._due_ns = 0

    def take(self, time_ns: int) -> tuple[ClockAnchor | None, list[Event]]:
        """An anchor, if one is due, and an event, if the clock of the day has stepped.

        `time_ns` is the time of the latest frame.
        """
        now, before = self._read(), self._last
        self._last = now
        events: list[Event] = []
        if before is not None:
            elapsed_ns = now.host_time_ns - before.host_time_ns
            step_ns = (now.utc_ns - before.utc_ns) - elapsed_ns
            allowed_ns = _LEAST_STEP_NS + _FASTEST_SLEW * elapsed_ns + now.apart_ns + before.apart_ns
            if abs(step_ns) > allowed_ns:
                text = f"the computer's clock of the day moved by {seconds(step_ns):+.3f} s"
                events.append(Event(time_ns, EventKind.CLOCK_STEP, text))
        if now.host_time_ns < self._due_ns and not events:
            return None, []
        self._due_ns = now.host_time_ns + _PERIOD_NS
        u_utc_s = math.hypot(u_of_kernel_clock(), 0.5e-9 * now.apart_ns)
        synchronised = math.isfinite(u_utc_s)
        return ClockAnchor(time_ns, now.host_time_ns, now.utc_ns, u_utc_s, synchronised), events


_MAX_PAIRS = 800
"""Largest number of pairs; at this number every second one is removed, also of later ones."""
_FRAMES_OF_BLOCK = 8
"""Number of frames of a block that are used; more would not improve the rate."""
_FIRST_NS, _BETWEEN_NS = 3_000_000_000, 10_000_000_000
"""Time to the first fit, which is early so that a user sees a value, and between fits."""


class ClockRate:
    """Rate of the camera's clock, from a line through some hundred pairs of times, each 10 s of the run.

    The line is fitted in a thread of its own, so that frames do not wait for the 10 ms that a fit takes; its
    error is raised by the next call.
    """

    def __init__(self) -> None:
        self._pairs: list[tuple[int, int, int]] = []
        self._every = 1
        self._passed = 0
        self._due_ns = 0
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        self._rate_ppm = (math.nan, math.nan)
        self._steps_s: list[float] = []

    def take(self, frames: Sequence[Frame], steps: Iterable[RecordedClockStep] = ()) -> CameraClock:
        """Take frames, and the clock's steps before them, into account; returns the present estimate."""
        self._steps_s += [seconds(step.step_ns) for step in steps]
        for frame in frames[:: max(1, len(frames) // _FRAMES_OF_BLOCK)]:
            # the time is negative if the camera has no clock
            if frame.device_time_ns >= 0:
                self._pair(frame)
        error, self._error = self._error, None
        if error is not None:
            raise error
        largest_s = max(self._steps_s, key=abs, default=0.0)
        return CameraClock(*self._rate_ppm, len(self._steps_s), largest_s)

    def _pair(self, frame: Frame) -> None:
        host_ns = frame.host_time_ns
        self._passed += 1
        if self._passed % self._every == 0:
            self._pairs.append((frame.device_time_ns, host_ns, frame.sequence))
            if len(self._pairs) >= _MAX_PAIRS:
                del self._pairs[1::2]
                self._every *= 2
        if not self._due_ns:
            self._due_ns = host_ns + _FIRST_NS
        if host_ns >= self._due_ns and (self._thread is None or not self._thread.is_alive()):
            self._due_ns = host_ns + _BETWEEN_NS
            table = np.array(self._pairs, dtype=np.int64)
            self._thread = threading.Thread(target=self._look, args=(table,), name="clock", daemon=True)
            self._thread.start()

    def _look(self, table: NDArray[np.int64]) -> None:
        try:
            # of frames that were read at the same moment, the first is kept
            keep = np.concatenate(([True], np.diff(np.maximum.accumulate(table[:, 1])) > 0))
            device_ns, host_ns, sequence = table[keep].T
            relation = relate_clocks(device_ns, host_ns, sequence)
        except DataError:
            # there are too few pairs as yet
            return
        except Exception as error:
            self._error = error
            return
        self._rate_ppm = (relation.drift_ppm, relation.u_drift_ppm)
