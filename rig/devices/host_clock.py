"""Clocks: how closely the host's follows UTC, in a record too, and the camera's wait for the network's."""

import ctypes
import math
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from acquisition.camera import CLOCK_STATES, Camera, HasFeatures
from acquisition.frames.guard import MOST_PPM, as_fast
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import ClockAnchor
from calibration import ClockRelation
from processing.errors import DeviceError
from processing.ticks import seconds

U_FREE_RUNNING: Final = 50e-6
"""Relative standard uncertainty of a computer's free-running quartz oscillator."""
U_SYNCHRONISED: Final = 1e-6
"""Of one that follows a time server which states no better."""
U_QUARTZ: Final = 0.7e-6
"""Of a quartz that follows the room, 1 ppm up and down in an hour: no record of minutes shows it."""
_PATIENCE_S = 3.0
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


def wrong_rate(relation: ClockRelation) -> str:
    """How fast the camera's clock runs, if that is not possible for one that counts ns; else empty."""
    if abs(relation.drift_ppm) - 3.0 * relation.u_drift_ppm <= MOST_PPM:
        return ""
    return as_fast(relation.drift_ppm)


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


_PERIOD_NS = 10_000_000_000
_LEAST_STEP_NS = 2_000_000
_FASTEST_SLEW = 1e-3
"""Systems that correct their clock without a step change its rate by at most 0.5 per mille."""


class HostClockReading(NamedTuple):
    """Both clocks of the computer at the same moment, and how far apart in time they were read."""

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
    """Anchors every 10 s and after every step."""

    def __init__(self, read: Callable[[], HostClockReading] = read_clocks) -> None:
        self._read = read
        self._last: HostClockReading | None = None
        self._due_ns = 0

    def take(self, time_ns: int) -> tuple[ClockAnchor | None, list[Event]]:
        """An anchor, if one is due, and an event, if the clock of the day has stepped; `time_ns` is the time
        of the latest frame.
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
        state = kernel_clock()
        u_utc_s = math.hypot(state.u_s, 0.5e-9 * now.apart_ns)
        return ClockAnchor(time_ns, now.host_time_ns, now.utc_ns, u_utc_s, state.synchronised), events
