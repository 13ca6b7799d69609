"""Judges every measurement, learns the effect of turns from those that are sound, and advises."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.balance import (
    Balance,
    Fault,
    Room,
    Turn,
    Unreachable,
    WeightResponses,
    find_faults,
    implausible,
    names_with_units,
)
from rig.balance import history
from rig.instrument import height_of, nominal_effects, sensor_room
from rig.presentation import say
from rig.settings import Configuration

Floats = NDArray[np.float64]

_GONE = 0.9
_SMALL_SWING_ARCSEC = 10.0


class BalanceMeasurement(NamedTuple):
    """One measurement: the last balance (None: no swing seen), lost and cut spots, (ny, nx) of the sensor."""

    balance: Balance | None
    lost_fraction: float
    sensor_shape: tuple[int, int]


class LearnedTurns:
    """States, turns and learned responses; each sound measurement appends a line of JSON to `path`.

    `room` is the sensor's, known from the first look on.
    """

    def __init__(self, config: Configuration, path: Path) -> None:
        self._config = config
        self._path = path
        self.limits = config.balance
        self.room: Room | None = None
        self.faults: list[Fault] = []
        self.before: list[Fault] = []
        self._lost_fraction = 0.0
        self._turned: list[tuple[str, tuple[float, ...]]] = []
        self._state: Floats | None = None
        self._relearn()

    def take(self, look: BalanceMeasurement) -> str:
        """Take a measurement; returns why it is rejected, empty if it is sound.

        A sound one sets `faults`, and `before` to those before the last turn (empty at first). After a
        rejected one the turns made are kept, and learned from at the next sound one.
        """
        self._lost_fraction = look.lost_fraction
        self.room = sensor_room(self._config, look.sensor_shape)
        balance = look.balance
        if balance is None:
            return f"no swing was seen in {self.limits.seconds:g} s"
        if look.lost_fraction > self._config.preflight.max_lost_fraction:
            return (
                f"{100 * look.lost_fraction:.0f} % of the spots were lost or cut: the spot leaves the sensor,"
                " or something covers it"
            )
        height_m, u_height_m = height_of(self._config, balance)
        faults = find_faults(balance, (height_m, u_height_m), self.limits)
        state = np.array([faults[0].value, faults[1].value, height_m])
        u_state = np.array([faults[0].u_value, faults[1].u_value, u_height_m])
        radius_m = np.nan if self._config.pendulum is None else self._config.pendulum.ball_radius_m
        if why := implausible(state, np.nan_to_num(u_state), self.limits, radius_m, self.room):
            return why
        self.before, self.faults = self.faults, faults
        self._learn(balance, state, u_state)
        self._turned, self._state = [], state
        return ""

    def advice(self) -> Turn | Unreachable | None:
        """The next turn after a sound measurement; None if all values are within limits."""
        assert self._state is not None
        return self.responses.advise(self._state, self.room)

    def way_back(self) -> Turn | None:
        """After a look that showed nothing: half of the last turn back; None if there was none."""
        if not self._turned:
            return None
        weight = self._turned[-1][0]
        net = sum(sum(parts) for name, parts in self._turned if name == weight)
        back = round(-0.5 * net, 2)
        why = "half of the last turn back, to see the spot again"
        return Turn(weight, back, why, swing_arcsec=_SMALL_SWING_ARCSEC) if back else None

    @property
    def spot_is_gone(self) -> bool:
        """Whether the last look saw next to nothing, after a turn: a smaller swing would not help."""
        return bool(self._turned) and self._lost_fraction > _GONE

    def turned(self, weight: str, parts: Sequence[float]) -> None:
        """Store the turns made, in sequence; their effect is learned from the next sound measurement."""
        self._turned.append((weight, tuple(parts)))

    def forget(self) -> None:
        """Take the last learned turn out of the history."""
        say(history.forget_last(self._path))
        self._relearn()

    def _learn(self, balance: Balance, state: Floats, u_state: Floats) -> None:
        weights = {name for name, _ in self._turned}
        if not weights or self._state is None:
            numbers = {key: getattr(balance, name) for name, key in names_with_units(balance.unit).items()}
            history.append(self._path, state=state, balance=numbers)
            return
        parts = tuple(part for _, turns in self._turned for part in turns)
        weight = next(iter(weights))
        pair = history.Pair("", weight, parts, self._state, state, np.nan_to_num(u_state))
        why = (
            f"weights {' and '.join(sorted(weights))} were turned between two measurements"
            if len(weights) > 1
            else history.refusal(self._config, self.responses, pair)
        )
        if why:
            say(f"nothing is learned from this turn: {why}")
            for name, turns in self._turned:
                self.responses.turned(name, turns)
            return
        self.responses.learn(weight, parts, pair.before, state, pair.u)
        history.append_pair(self._path, pair)

    def _relearn(self) -> None:
        self.responses = WeightResponses(nominal_effects(self._config), self.limits)
        used = 0
        for pair in history.read(self._path):
            if why := history.refusal(self._config, self.responses, pair):
                say(f"{self._path}: the turn of {pair.utc} is not used: {why}")
                continue
            self.responses.learn(pair.weight, pair.parts, pair.before, pair.after, np.nan_to_num(pair.u))
            used += 1
        if used:
            say(f"{self._path}: {used} turns of earlier sessions are used")
