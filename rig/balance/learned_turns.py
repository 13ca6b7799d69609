"""Learns the effect of a turn of each weight from repeated measurements, and keeps them in a file."""

import datetime
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.balance import (
    Balance,
    Fault,
    Turn,
    WeightResponses,
    find_faults,
    names_with_units,
)
from rig.instrument import (
    WEIGHTS,
    height_of,
    nominal_effects,
)
from rig.presentation import say
from rig.settings import Configuration

Floats = NDArray[np.float64]


class LearnedTurns:
    """States, turns and learned responses; each measurement appends a line of JSON to `history`."""

    def __init__(self, config: Configuration, history: Path) -> None:
        self._config = config
        self._history = history
        self.limits = config.balance
        self.responses = WeightResponses(nominal_effects(config), self.limits)
        self._pending: tuple[str, float] | None = None
        self._state: Floats | None = None
        self._before: list[Fault] = []
        if history.exists():
            self._relearn()

    def state(self, balance: Balance) -> tuple[list[Fault], list[Fault]]:
        """Add a measurement; returns the faults now, and those before the last turn (empty at first)."""
        height_m, u_height_m = height_of(self._config, balance)
        faults = find_faults(balance, (height_m, u_height_m), self.limits)
        state = np.array([faults[0].value, faults[1].value, height_m])
        u_state = np.array([faults[0].u_value, faults[1].u_value, u_height_m])
        before, self._before = self._before, faults
        if self._pending is not None and self._state is not None:
            weight, turns = self._pending
            self.responses.learn(weight, turns, self._state, state, np.nan_to_num(u_state))
            self._write(
                {"weight": weight, "turns": turns, "before": self._state, "after": state, "u": u_state}
            )
        else:
            numbers = {key: getattr(balance, name) for name, key in names_with_units(balance.unit).items()}
            self._write({"state": state, "balance": numbers})
        self._pending, self._state = None, state
        return faults, before

    def advice(self) -> Turn | None:
        """The next turn; None if all values are within limits."""
        assert self._state is not None
        return self.responses.advise(self._state)

    def turned(self, weight: str, turns: float) -> None:
        """Store the turn made; its effect is learned from the next measurement."""
        self._pending = (weight, turns)

    def _write(self, entry: dict[str, object]) -> None:
        self._history.parent.mkdir(parents=True, exist_ok=True)
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in entry.items()}
        with self._history.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"utc": now, **plain}) + "\n")

    def _relearn(self) -> None:
        pairs = 0
        for number, line in enumerate(self._history.read_text(encoding="utf-8").splitlines(), start=1):
            try:
                entry = json.loads(line)
                if entry.get("weight") not in WEIGHTS:
                    continue
                turns = float(entry["turns"])
                before, after, u = (
                    np.array(entry[key], dtype=np.float64) for key in ("before", "after", "u")
                )
            except (ValueError, TypeError, KeyError, AttributeError):
                # truncated by a power failure or edited by hand; the other lines are still valid
                say(f"{self._history}: line {number} cannot be read and is skipped")
                continue
            self.responses.learn(entry["weight"], turns, before, after, np.nan_to_num(u))
            pairs += 1
        say(f"{self._history}: {pairs} turns of earlier sessions are used")
