"""How closely the clock of this host follows UTC, according to chrony or systemd."""

import ctypes
import math
import shutil
import subprocess
import sys
from dataclasses import dataclass

_RATE_UNSYNCHRONISED = 50e-6
"""Relative standard uncertainty of a computer's free-running quartz oscillator."""
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
        u_rate = float(skew[0]) * 1e-6 if locked and skew else _RATE_UNSYNCHRONISED
        shown = ("Reference ID", "Stratum", "System time", "Frequency", "Skew", "Leap status")
        text = "chrony: " + "; ".join(f"{name} {fields[name]}" for name in shown if name in fields)
        return HostClock(locked, text, u_rate)
    answer = _ask("timedatectl", "show", "-p", "NTPSynchronized", "--value").strip()
    if answer:
        locked = answer == "yes"
        return HostClock(
            locked, f"systemd: NTPSynchronized={answer}", 1e-6 if locked else _RATE_UNSYNCHRONISED
        )
    return HostClock(False, "neither chrony nor systemd answers", _RATE_UNSYNCHRONISED)


def _ask(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_PATIENCE_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
