"""`rig balance`: look at the swing, say what is wrong, advise one turn, learn from it, look again."""

import datetime
import json
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.weights import TrimmedPendulum, TrimWeight, imperfect_weights
from processing.balance import (
    Balance,
    Fault,
    Turn,
    WeightResponses,
    find_faults,
)
from processing.errors import ConfigurationError
from rig.balance.look import LooksView, look
from rig.balance.screen import print_advice, print_faults
from rig.devices import Devices
from rig.instrument import (
    DIRECTIONS,
    WEIGHTS,
    advice_text,
    complete,
    height_of,
    nominal_effects,
)
from rig.presentation import say
from rig.settings import Configuration

Floats = NDArray[np.float64]


class BalancingSession:
    """States, turns and what was learned, kept in a file of one JSON object a line."""

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
        """Take in a look: faults now, and those before the last turn (empty at first)."""
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
            self._write({"state": state, "balance": asdict(balance)})
        self._pending, self._state = None, state
        return faults, before

    def advice(self) -> Turn | None:
        """The next turn; None: within limits."""
        assert self._state is not None
        return self.responses.advise(self._state)

    def turned(self, weight: str, turns: float) -> None:
        """Something was turned; the next look learns from it."""
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
                # cut short by a power cut, or written by hand: the others are worth having
                say(f"{self._history}: line {number} cannot be read and is passed over")
                continue
            self.responses.learn(entry["weight"], turns, before, after, np.nan_to_num(u))
            pairs += 1
        say(f"{self._history}: {pairs} turns of earlier times are known")


def balance_rig(
    config: Configuration, history: Path | None, follow: int, seed: int, rrd: Path | None = None
) -> int:
    """Look, advise, ask what was turned, until told to end; with `follow` the simulated rig obeys.

    All looks are drawn into the live view that the configuration asks for, and into `rrd`.
    """
    config = complete(config)
    trimmed: TrimmedPendulum | None = None
    if follow:
        if not config.simulated:
            raise ConfigurationError("--follow turns the simulated rig's weights: a real one needs hands")
        nominal = {
            name: TrimWeight(
                getattr(config.balance, f"weight_{name}").mass_kg,
                getattr(config.balance, f"weight_{name}").pitch_m,
                DIRECTIONS[name],
            )
            for name in WEIGHTS
        }
        trimmed = TrimmedPendulum(config.simulation, imperfect_weights(nominal, seed), seed=seed)
    session = BalancingSession(config, history or config.session.output / "balance-history.jsonl")
    moves = 0
    stated = config

    def advise(balance: Balance) -> str:
        return advice_text(stated, balance, session.responses)

    with Devices(config) as devices, LooksView(config, rrd, advise) as view:
        if lit := devices.light():
            say(lit)
        while True:
            if trimmed is not None:
                config = config.model_copy(update={"simulation": trimmed.settings})
            balance = look(config, devices, _shower(config), view)
            faults, before = session.state(balance)
            print_faults(faults, before)
            turn = session.advice()
            print_advice(turn, faults)
            if trimmed is not None:
                if turn is None or moves >= follow:
                    return 0 if turn is None else 1
                trimmed.turn(turn.weight, turn.turns)
                session.turned(turn.weight, turn.turns)
                moves += 1
            elif not _ask(session):
                return 0 if turn is None else 1


def _faults(config: Configuration, balance: Balance) -> list[Fault]:
    return find_faults(balance, height_of(config, balance), config.balance)


def _shower(config: Configuration) -> Callable[[Balance], None]:
    return lambda balance: print_faults(_faults(config, balance), [], live=True)


def _ask(session: BalancingSession) -> bool:
    """What the operator has turned; False: to end."""
    while True:
        try:
            answer = input("turned (weight turns, e.g. x 1.5; Enter: look again; q: end)? ").split()
        except (EOFError, KeyboardInterrupt):
            return False
        if not answer:
            return True
        if answer[0] == "q":
            return False
        try:
            weight, turns = answer[0].lower(), float(answer[1])
            if weight not in WEIGHTS or not math.isfinite(turns):
                raise ValueError
        except (ValueError, IndexError):
            say(f"weights are {', '.join(WEIGHTS)}; turns a number, positive clockwise")
            continue
        session.turned(weight, turns)
        return True
