"""What a witness of the ground would give, from a short piece beside a pendulum at rest.

The ground changes the swing of a pendulum at rest from period to period. An undamped pendulum that the
witness's record drives shows what those changes would be; how far the two agree is all that a short piece
tells, and of how little it tells, its bounds say.
"""

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Flags, Floats
from processing.errors import DataError
from processing.fit import LEAST_LEFT, Signals, Witness, plain_signals
from processing.pendulum_at_rest import SwingAtRest, quadratures_of, swing_at_rest

_STEPS_A_PERIOD = 80
"""In which the record's drive is summed."""
_DELAYS = np.linspace(-0.25, 0.25, 11)
"""Lateness that is tried, in periods: lines of text and packets come late, by what the fit finds later."""
_OF_DELAY = 0.5
"""What the choice of the delay takes, in complex numbers."""
_ALIKE = 1.125
"""Steps follow one another with a correlation of 1/4, of pendulum and witness: so many are worth one."""
_FEWEST = 5
_REFINED = 3
_CHANCE = 0.95
_NORMAL_95 = 1.96
_MOST = 1 / LEAST_LEFT


@dataclass(frozen=True, slots=True, kw_only=True)
class WitnessAtRest:
    """How a witness goes with the swing of a pendulum at rest.

    Attributes
    ----------
    steps
        Changes of the swing from period to period that were compared.
    coherence
        Their squared coherence with what the witness predicts, all its components together.
    by_chance
        A squared coherence that one in twenty unrelated records exceeds.
    factor
        By which the amplitude of the changes would fall. Reading, air and pointing are in them: the ground's
        part falls by more.
    least, most
        Bounds of 95 %. No fit counts on more than what two seismometers at one place show.
    """

    steps: int
    coherence: float
    by_chance: float
    factor: float
    least: float
    most: float

    @property
    def related(self) -> bool:
        """Whether the witness feels what moves the pendulum, as far as this piece shows."""
        return self.coherence > self.by_chance


def witness_at_rest(time_s: Floats, deflection: Floats, witness: Witness) -> WitnessAtRest:
    """Compare a witness with a free pendulum at rest, along its slow mode.

    Parameters
    ----------
    time_s, deflection
        (n,) NaN where there is no spot.
    witness
        On the same clock, up to a quarter of a period.

    Raises
    ------
    DataError
        The pendulum or the witness was seen for too short a time; or the witness does not change at all.
    """
    from scipy.special import betaincinv

    rest = swing_at_rest(time_s, deflection)
    signals = plain_signals(witness, rest.period_s)
    if not np.all(np.ptp(signals.value, axis=0) > 0):
        raise DataError("its values do not change")
    compared = _compared(rest, signals)
    for _ in range(_REFINED):
        # a swing that wanders shows its period but roughly; where the witness explains why, it is known
        rest = rest.with_period(compared.period_s)
        compared = _compared(rest, signals)
    coherence, components = compared.coherence, signals.value.shape[1]
    # a step for the decay, and those that the gains take
    free = compared.steps - 1 - components - _OF_DELAY
    if free < _FEWEST - 1:
        raise DataError(
            f"witness and pendulum at rest have {compared.steps} periods in common; at least "
            f"{_FEWEST + 1 + components} are needed"
        )
    taken = components + _OF_DELAY
    of_chance = min(1.0, (1 - coherence) * (free + taken) / free)
    fisher, u = np.arctanh(np.sqrt(1 - of_chance)), np.sqrt(_ALIKE / (2 * (free - 1)))
    low, high = np.cosh(max(0.0, fisher - _NORMAL_95 * u)), np.cosh(fisher + _NORMAL_95 * u)
    return WitnessAtRest(
        steps=compared.steps,
        coherence=coherence,
        by_chance=float(betaincinv(taken, free / _ALIKE, _CHANCE)),
        factor=float(min(np.cosh(fisher), _MOST)),
        least=float(min(low, _MOST)),
        most=float(min(high, _MOST)),
    )


class _Compared(NamedTuple):
    """How many steps, their squared coherence with those predicted, and the period that the fit prefers."""

    steps: int
    coherence: float
    period_s: float


def _compared(rest: SwingAtRest, signals: Signals) -> _Compared:
    turning = quadratures_of(rest, rest.deflection[:, None])[0][:, 0]
    use = _covered(rest, signals)
    step, middle = np.diff(turning)[use], (0.5 * (turning[1:] + turning[:-1]))[use]
    alone = step - middle * (np.vdot(middle, step) / np.vdot(middle, middle))
    power = float(np.vdot(alone, alone).real)
    predicted = _predicted_steps(rest, signals)[:, :, use]
    found = []
    for columns in predicted:
        every = np.column_stack([middle, *columns])
        gains = np.linalg.lstsq(every, step, rcond=None)[0]
        after = step - every @ gains
        found.append((float(np.vdot(after, after).real), float(gains[0].imag)))
    least, turned = min(found)
    period_s = rest.period_s / (1 - turned / (2 * np.pi))
    return _Compared(len(step), 1 - least / power, period_s)


def _predicted_steps(rest: SwingAtRest, signals: Signals) -> NDArray[np.complex128]:
    """(delays, components, periods - 1) steps of an undamped pendulum that a component drives."""
    # at its own times and between them, so that each sample counts alike
    parts = ceil(_STEPS_A_PERIOD * signals.longest_step_s / rest.period_s)
    number = np.arange(len(signals.time_s))
    time_s = np.interp(np.arange(0, number[-1] + 0.5 / parts, 1 / parts), number, signals.time_s)
    turn = np.exp(2j * np.pi * time_s / rest.period_s)
    series = []
    for one in signals.value.T:
        drive = np.interp(time_s, signals.time_s, one) * turn.conj()
        summed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (drive[1:] + drive[:-1]))])
        angle = (turn * summed).imag
        angle /= np.std(angle)
        series += [np.interp(rest.time_s + delay * rest.period_s, time_s, angle) for delay in _DELAYS]
    turning = quadratures_of(rest, np.column_stack(series))[0]
    steps = np.diff(turning, axis=0).T
    return np.swapaxes(steps.reshape(signals.value.shape[1], len(_DELAYS), -1), 0, 1)


def _covered(rest: SwingAtRest, signals: Signals) -> Flags:
    """Which steps from period to period the witness was there for."""
    edges = rest.time_s[0] + rest.period_s * np.arange(rest.periods + 1)
    pause = np.flatnonzero(np.diff(signals.time_s) > signals.longest_step_s)
    # what lies a little beyond its ends is no gap: mostly it begins and ends with the pendulum's piece
    little_s = rest.period_s * float(np.max(np.abs(_DELAYS)))
    begins = np.concatenate([[-np.inf], signals.time_s[pause], [signals.time_s[-1] + little_s]])
    ends = np.concatenate([[signals.time_s[0] - little_s], signals.time_s[pause + 1], [np.inf]])
    return np.asarray(~np.any((edges[:-2, None] < ends) & (edges[2:, None] > begins), axis=1))
