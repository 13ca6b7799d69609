"""When a run ends by itself, and whether its start is accepted."""

from collections.abc import Sequence
from dataclasses import dataclass

from processing.angle import ARCSEC_RAD
from processing.balance import Balance
from processing.swing import Swing


@dataclass(slots=True)
class EndOfRun:
    """Watches amplitude and time; says once why the run is over.

    The amplitude must stay below the limit for three half-cycles in a row, so that one disturbed
    half-cycle does not end a measurement of an hour.
    """

    final_amplitude: float
    max_duration_s: float
    _below: int = 0

    def reason(self, swings: Sequence[Swing], elapsed_s: float) -> str | None:
        """None while the run goes on; else the reason, as it is recorded."""
        for swing in swings:
            self._below = self._below + 1 if swing.amplitude < self.final_amplitude else 0
            if self._below >= 3:
                return "final amplitude reached"
        if elapsed_s >= self.max_duration_s:
            return f"time limit of {self.max_duration_s:g} s reached"
        return None


@dataclass(slots=True)
class StartJudge:
    """Accepts a start whose first amplitude and transverse motion lie within limits; says why not.

    The first two half-cycles that nothing is wrong with are judged, and the balance of the first
    periods. Amplitudes in the unit of the deflection, `unit_rad` is that of the words.
    """

    lowest_amplitude: float
    highest_amplitude: float
    highest_transverse_ratio: float
    patience_s: float
    unit_rad: float = ARCSEC_RAD
    accepted: bool = False
    first_amplitude: float = 0.0
    _good: int = 0
    _balance_seen: bool = False

    def rejection(self, swings: Sequence[Swing], balances: Sequence[Balance], elapsed_s: float) -> str:
        """Why the start is not accepted; nothing while it is being judged and after it was accepted."""
        if self.accepted:
            return ""
        for swing in swings:
            if swing.flags:
                continue
            self._good += 1
            self.first_amplitude = max(self.first_amplitude, swing.amplitude)
        if self._good >= 2 and not self.lowest_amplitude <= self.first_amplitude <= self.highest_amplitude:
            first, lowest, highest = (
                amplitude / self.unit_rad
                for amplitude in (self.first_amplitude, self.lowest_amplitude, self.highest_amplitude)
            )
            return f"first amplitude {first:.1f} arcsec, {lowest:.1f} to {highest:.1f} are wanted"
        for balance in balances:
            if balance.amplitude_rad < 0.5 * self.lowest_amplitude:
                continue
            self._balance_seen = True
            if balance.transverse_ratio > self.highest_transverse_ratio:
                return (
                    f"transverse motion is {100 * balance.transverse_ratio:.1f} % of the swing, "
                    f"at most {100 * self.highest_transverse_ratio:.1f} % is wanted"
                )
        self.accepted = self._good >= 2 and self._balance_seen
        if not self.accepted and elapsed_s > self.patience_s:
            return f"no two clean half-cycles within {self.patience_s:g} s"
        return ""
