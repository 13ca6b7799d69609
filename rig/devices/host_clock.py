"""How closely the clock of this host follows UTC, according to chrony or systemd."""

import shutil
import subprocess
from dataclasses import dataclass

_RATE_UNSYNCHRONISED = 50e-6
"""Relative standard uncertainty of a computer's free-running quartz oscillator."""
_PATIENCE_S = 3.0


@dataclass(frozen=True, slots=True)
class HostClock:
    """`u_rate` is the relative standard uncertainty of the host's second."""

    synchronised: bool
    text: str
    u_rate: float


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
