"""Accepts or rejects the start of a run by its first half-cycles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.swing import Swing
from processing.units import ARCSEC_RAD
from rig.instrument import Optics
from rig.settings import Configuration

_SURELY = 2.0
"""Standard uncertainties beyond the limit of the rotation."""


@dataclass(frozen=True, slots=True)
class StartLimits:
    """Limits of the first amplitude, of the transverse motion and of the rotation about the vertical.

    Amplitudes are in `unit`; in px they are not limited, because the limits are configured in arcsec.
    After `attempts` rejected starts the run fails.
    """

    lowest_amplitude: float
    highest_amplitude: float
    highest_transverse_ratio: float
    highest_spin_deg_per_min: float
    patience_s: float
    attempts: int
    unit: DeflectionUnit


def start_limits(config: Configuration, optics: Optics) -> StartLimits:
    """The configured limits."""
    wanted_rad = config.session.initial_amplitude_arcsec * ARCSEC_RAD
    start, in_px = config.start, optics.unit is DeflectionUnit.PX
    return StartLimits(
        lowest_amplitude=0.0 if in_px else start.lowest_amplitude * wanted_rad,
        highest_amplitude=math.inf if in_px else start.highest_amplitude * wanted_rad,
        highest_transverse_ratio=start.max_transverse_ratio,
        highest_spin_deg_per_min=config.balance.spin_deg_per_min,
        patience_s=start.patience_s,
        attempts=start.attempts,
        unit=optics.unit,
    )


class StartJudge:
    """Judges one start by its first two unflagged half-cycles and the balance of its first periods.

    After that the rotation is judged once, by the first balance that knows it, about five periods after the
    release. `first_amplitude` is the larger amplitude of these half-cycles, 0 before the first.
    """

    def __init__(self, limits: StartLimits) -> None:
        self._limits = limits
        self._accepted = False
        self._good = 0
        self._balance_seen = False
        self._rotation_judged = False
        self.first_amplitude = 0.0

    def rejection(self, swings: Sequence[Swing], balances: Sequence[Balance], elapsed_s: float) -> str:
        """Why the start is rejected; empty while it is being judged and after it was accepted."""
        return self._of_first_swings(swings, balances, elapsed_s) or self._of_rotation(balances)

    def _of_rotation(self, balances: Sequence[Balance]) -> str:
        for balance in balances:
            rate, u = (
                math.degrees(value) * 60.0
                for value in (balance.rotation_rad_per_s, balance.u_rotation_rad_per_s)
            )
            if self._rotation_judged or not math.isfinite(rate):
                continue
            self._rotation_judged = True
            highest = self._limits.highest_spin_deg_per_min
            if abs(rate) - _SURELY * u > highest:
                return (
                    f"the plane of swing turns by {rate:+.2f} deg/min, at most {highest:g} deg/min is "
                    "allowed: let the pendulum settle before the release"
                )
        return ""

    def _of_first_swings(self, swings: Sequence[Swing], balances: Sequence[Balance], elapsed_s: float) -> str:
        limits = self._limits
        if self._accepted:
            return ""
        for swing in swings:
            if not swing.flags:
                self._good += 1
                self.first_amplitude = max(self.first_amplitude, swing.amplitude)
        if (
            self._good >= 2
            and not limits.lowest_amplitude <= self.first_amplitude <= limits.highest_amplitude
        ):
            first, lowest, highest = (
                amplitude / limits.unit.shown_size
                for amplitude in (self.first_amplitude, limits.lowest_amplitude, limits.highest_amplitude)
            )
            return (
                f"first amplitude {first:.1f} {limits.unit.shown}, {lowest:.1f} to {highest:.1f} are required"
            )
        for balance in balances:
            if balance.amplitude < 0.5 * limits.lowest_amplitude:
                continue
            self._balance_seen = True
            if balance.transverse_ratio > limits.highest_transverse_ratio:
                return (
                    f"transverse motion is {100 * balance.transverse_ratio:.1f} % of the swing, "
                    f"at most {100 * limits.highest_transverse_ratio:.1f} % is allowed"
                )
        self._accepted = self._good >= 2 and self._balance_seen
        if not self._accepted and elapsed_s > limits.patience_s:
            return f"no two clean half-cycles within {limits.patience_s:g} s"
        return ""
