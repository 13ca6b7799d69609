"""The command `rig balance`: measures the balance, advises a turn of a weight, learns from it, repeats."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.weights import TrimmedPendulum, TrimWeight, imperfect_weights
from processing.balance import (
    Balance,
    Fault,
    find_faults,
)
from processing.errors import ConfigurationError
from rig.balance.learned_turns import LearnedTurns
from rig.balance.look import LooksView, look
from rig.balance.screen import print_advice, print_faults
from rig.devices import Devices
from rig.instrument import (
    DIRECTIONS,
    WEIGHTS,
    advice_text,
    complete,
    height_of,
)
from rig.presentation import say
from rig.settings import Configuration

Floats = NDArray[np.float64]


def balance_rig(
    config: Configuration, history: Path | None, follow: int, seed: int, rrd: Path | None = None
) -> int:
    """Measure, advise and ask which weight was turned, until the operator ends it.

    With `follow` the advice is applied to the simulated rig, for at most so many turns. All
    measurements are drawn into the configured live view and into `rrd`.
    """
    config = complete(config)
    trimmed: TrimmedPendulum | None = None
    if follow:
        if not config.simulated:
            raise ConfigurationError("--follow works with the simulated rig only: leave it out")
        nominal = {
            name: TrimWeight(
                getattr(config.balance, f"weight_{name}").mass_kg,
                getattr(config.balance, f"weight_{name}").pitch_m,
                DIRECTIONS[name],
            )
            for name in WEIGHTS
        }
        trimmed = TrimmedPendulum(config.simulation, imperfect_weights(nominal, seed), seed=seed)
    session = LearnedTurns(config, history or config.session.output / "balance-history.jsonl")
    moves = 0
    stated = config

    def advise(balance: Balance) -> str:
        return advice_text(stated, balance, session.responses)

    with Devices(config) as devices, LooksView(config, rrd, advise) as view:
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


def _ask(session: LearnedTurns) -> bool:
    """Ask the operator what was turned; False to end."""
    while True:
        try:
            answer = input("turned (weight turns, e.g. x 1.5; Enter: measure again; q: end)? ").split()
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
            say(f"enter a weight ({', '.join(WEIGHTS)}) and a number of turns, positive clockwise")
            continue
        session.turned(weight, turns)
        return True
