"""Clocks: how closely the host's follows UTC, how fast the camera's runs, and its wait for the network's."""

import ctypes
import math
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CLOCK_STATES, Camera, HasFeatures
from acquisition.frame import Frame
from calibration import ClockRelation
from processing.errors import DeviceError

U_FREE_RUNNING: Final = 50e-6
"""Relative standard uncertainty of a computer's free-running quartz oscillator."""
U_SYNCHRONISED: Final = 1e-6
"""Of one that follows a time server which states no better."""
U_QUARTZ: Final = 0.7e-6
"""Of a quartz that follows the room, 1 ppm up and down in an hour: no record of minutes shows it."""
_PATIENCE_S = 3.0
NO_TIME_NS: Final = 1 << 62
"""Later than any clock, 146 years; sums of times no longer fit."""
_TIME_ERROR, _UNSYNCHRONISED = 5, 0x40


@dataclass(frozen=True, slots=True)
class HostClock:
    """`u_rate` is the relative standard uncertainty of the host's second."""

    synchronised: bool
    text: str
    u_rate: float


@dataclass(frozen=True, slots=True)
class KernelClock:
    """What the kernel says of its clock of the day; `u_s` is NaN where it says nothing."""

    synchronised: bool
    u_s: float


class _Timex(ctypes.Structure):
    """The first members of Linux's struct timex, and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("frequency", ctypes.c_long),
        ("largest_error_us", ctypes.c_long),
        ("estimated_error_us", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_long * 32),
    )


def kernel_clock() -> KernelClock:
    """State of the kernel's clock, in microseconds of time; on other systems than Linux it is unknown."""
    if not sys.platform.startswith("linux"):
        return KernelClock(False, math.nan)
    state = _Timex()
    try:
        answer = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        return KernelClock(False, math.nan)
    synchronised = 0 <= answer < _TIME_ERROR and not state.status & _UNSYNCHRONISED
    return KernelClock(synchronised, state.estimated_error_us * 1e-6 if synchronised else math.nan)


def ntp_state() -> HostClock:
    """State reported by chrony, else by systemd; without either the clock is taken as free-running."""
    tracking = _ask("chronyc", "-n", "tracking")
    if tracking:
        fields = dict(line.split(":", 1) for line in tracking.splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        locked = fields.get("Leap status") == "Normal"
        # "0.012 ppm": chrony's estimate of the error of the rate
        skew = fields.get("Skew", "").split()
        u_rate = float(skew[0]) * 1e-6 if locked and skew else U_FREE_RUNNING
        shown = ("Reference ID", "Stratum", "System time", "Frequency", "Skew", "Leap status")
        text = "chrony: " + "; ".join(f"{name} {fields[name]}" for name in shown if name in fields)
        return HostClock(locked, text, u_rate)
    answer = _ask("timedatectl", "show", "-p", "NTPSynchronized", "--value").strip()
    if answer:
        locked = answer == "yes"
        return HostClock(
            locked, f"systemd: NTPSynchronized={answer}", U_SYNCHRONISED if locked else U_FREE_RUNNING
        )
    return HostClock(False, "neither chrony nor systemd answers", U_FREE_RUNNING)


def _ask(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=_PATIENCE_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


MOST_PPM: Final = 1000.0
"""A quartz is right within 100 ppm: a clock that runs otherwise counts in another unit than was believed."""
_WINDOW_NS: Final = 3_000_000_000
"""Between the middles of its first and last third are 2 s: a delay of 2 ms, kept up, makes `MOST_PPM`."""
_FEWEST: Final = 60
_IN_A_ROW: Final = 3
_SPREAD: Final = 0.2
"""A wrong unit shows the same each time; a busy computer's delays do not within a fifth of themselves."""


def wrong_rate(relation: ClockRelation) -> str:
    """How fast the camera's clock runs, if that is not possible for one that counts ns; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MOST_PPM:
        return ""
    return _as_fast(relation.drift_ppm)


def _as_fast(drift_ppm: float) -> str:
    return f"the camera's clock runs {1.0 + 1e-6 * drift_ppm:.6g} times as fast as the computer's"


def _drift_ppm(seen: NDArray[np.int64]) -> float:
    """Rate of camera times against host times, (n, 2) in ns, minus 1; NaN if the host's do not rise.

    From the medians of the first and the last third, which frames that come late now and then do not move.
    The thread that reads the camera waits for it: a fit of all frames would cost some of them.
    """
    since_ns, third = seen - seen[0], len(seen) // 3
    device_ns, host_ns = np.median(since_ns[-third:], axis=0) - np.median(since_ns[:third], axis=0)
    return (device_ns / host_ns - 1.0) * 1e6 if host_ns > 0 else math.nan


class ClockWatch:
    """Compares the clocks over the first seconds of frames, whatever the driver.

    A wrong unit shows in any stretch of frames, each time as much. Frames that a busy computer takes late,
    and then catches up with, can look like one in a single stretch: the clock is refused only if three in a
    row, of `window_ns` each, show the same.
    """

    def __init__(self, window_ns: int = _WINDOW_NS) -> None:
        self._window_ns = window_ns
        self._frames: list[tuple[int, int]] = []
        self._found: list[float] = []
        self._done = False

    def begin_again(self) -> None:
        """The camera was opened again: the stretch begins again."""
        self._frames.clear()

    def see(self, frame: Frame) -> None:
        """Take the next frame into account; raises DeviceError if the clock cannot be right."""
        if self._done:
            return
        if frame.device_time_ns < 0:
            self._done = True
            return
        if frame.device_time_ns >= NO_TIME_NS:
            return
        seen = self._frames
        seen.append((frame.device_time_ns, frame.host_time_ns))
        if seen[-1][1] - seen[0][1] < self._window_ns or len(seen) < _FEWEST:
            return
        drift_ppm = _drift_ppm(np.array(seen, dtype=np.int64))
        seen.clear()
        if not abs(drift_ppm) > MOST_PPM:
            # times that do not rise are for the preflight and rig calibrate clock to report
            self._done = not math.isnan(drift_ppm)
            return
        self._found = [*self._found, drift_ppm][-_IN_A_ROW:]
        mean = sum(self._found) / len(self._found)
        same = all(abs(drift - mean) < _SPREAD * abs(mean) for drift in self._found)
        if len(self._found) == _IN_A_ROW and same:
            raise DeviceError(
                f"{_as_fast(mean)}, at most {MOST_PPM:g} ppm are possible: its times cannot be used; "
                "the driver misreads its unit, or the computer's clock was set: see rig doctor"
            )


_FOLLOWS: Final = "Slave"
_POLL_S: Final = 0.5


def wait_for_network_clock(
    camera: Camera, timeout_s: float = 60.0, ended: threading.Event | None = None
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
