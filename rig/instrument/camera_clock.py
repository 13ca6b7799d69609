"""How the camera's clock runs against the computer's, as it is known at one moment of a run."""

import math
from dataclasses import dataclass

_TELLS_PPM = 100.0
"""Any quartz is right within so much: a rate that is known no better says nothing."""


def rate_text(drift_ppm: float, u_drift_ppm: float) -> str:
    """Rate and standard uncertainty with two digits of the latter, 0.1 ppb at the finest."""
    digits = min(max(1 - math.floor(math.log10(max(u_drift_ppm, 1e-9))), 0), 4)
    return f"{drift_ppm:+.{digits}f} ± {max(u_drift_ppm, 10.0**-digits):.{digits}f} ppm"


@dataclass(frozen=True, slots=True)
class CameraClock:
    """Rate of the camera's clock against the computer's, less 1, and the steps that were taken off its times.

    NaN where it is not known: a camera without a clock, or frames made on demand.
    """

    drift_ppm: float = math.nan
    u_drift_ppm: float = math.nan
    steps: int = 0
    largest_step_s: float = 0.0

    @property
    def known(self) -> bool:
        """Whether the rate says anything."""
        return self.u_drift_ppm <= _TELLS_PPM

    @property
    def text(self) -> str:
        """Rate and steps in one line; empty where neither is known."""
        parts = []
        if self.known:
            parts.append(f"{rate_text(self.drift_ppm, self.u_drift_ppm)} against the computer's")
        if self.steps:
            times = "once" if self.steps == 1 else f"{self.steps} times, at most"
            parts.append(f"stepped {times} by {self.largest_step_s:+.4g} s")
        return ", ".join(parts)
