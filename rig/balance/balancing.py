"""The command `rig balance`: measures the balance, advises a turn of a weight, learns from it, repeats."""

import math
from collections.abc import Callable
from pathlib import Path

from processing.balance import Balance, Turn, find_faults
from processing.errors import ConfigurationError, DataError
from rig.balance import history
from rig.balance.learned_turns import LearnedTurns
from rig.balance.look import LooksView, look
from rig.balance.screen import print_advice, print_faults
from rig.balance.simulated_operator import SimulatedOperator
from rig.devices import Devices
from rig.instrument import WEIGHTS, advice_text, complete, height_of, turn_text
from rig.presentation import say
from rig.settings import Configuration

_LOOKS_A_TURN = 5


def history_path(config: Configuration, stated: Path | None) -> Path:
    """The file in which turns are kept."""
    return stated or config.session.output / "balance-history.jsonl"


def show_history(config: Configuration, stated: Path | None, *, forget: bool) -> int:
    """Print what was learned from earlier turns; with `forget` take the last one back first."""
    config = complete(config)
    path = history_path(config, stated)
    if forget:
        pair = history.forget_last(path)
        say("nothing was learned yet" if pair is None else f"the turn of weight {pair.weight} is forgotten")
    history.show(config, path)
    return 0


def balance_rig(
    config: Configuration,
    path: Path | None,
    follow: int,
    seed: int,
    rrd: Path | None = None,
    operator: SimulatedOperator | None = None,
) -> int:
    """Measure, advise and ask which weight was turned, until the operator ends it.

    With `follow` the advice is applied to the simulated rig, for at most so many turns, by `operator` if
    given. All measurements are drawn into the configured live view and into `rrd`.
    """
    config = complete(config)
    if follow and not config.simulated:
        raise ConfigurationError("--follow works with the simulated rig only: leave it out")
    if follow and operator is None:
        operator = SimulatedOperator(config, seed)
    session = LearnedTurns(config, history_path(config, path))
    stated = config

    def advise(balance: Balance) -> str:
        return advice_text(stated, balance, session.responses, session.room)

    moves = looks = 0
    with (
        Devices(config, history_path(config, path).parent) as devices,
        LooksView(config, rrd, advise) as view,
    ):
        while True:
            if operator is not None:
                config = config.model_copy(update={"simulation": operator.simulation})
            looks += 1
            try:
                why = session.take(look(config, devices, _shower(config), view))
            except DataError as error:
                why = str(error)
            if why:
                turn = _after_rejection(session, why)
                ended = False
            else:
                print_faults(session.faults, session.before)
                advice = session.advice()
                print_advice(advice, session.faults)
                ended, turn = advice is None, advice if isinstance(advice, Turn) else None
            if operator is None:
                if not _ask(session, devices):
                    return 0 if ended else 1
            elif why and not session.spot_is_gone and operator.swing_less():
                continue
            elif turn is None or moves >= follow or looks > _LOOKS_A_TURN * follow:
                return 0 if ended else 1
            else:
                operator.follow(turn)
                session.turned(turn.weight, turn.parts)
                devices.audit("weight turned", weight=turn.weight, turns=turn.parts)
                moves += 1


def _after_rejection(session: LearnedTurns, why: str) -> Turn | None:
    """Say why a measurement was rejected and what helps; returns the turn back that may."""
    say(f"this measurement is not used: {why}")
    turn = session.way_back()
    if not session.spot_is_gone:
        say("let it swing by half as much, and measure again" + ("; if that does not help:" if turn else ""))
    if turn is not None:
        say(turn_text(turn, []))
    return turn


def _shower(config: Configuration) -> Callable[[Balance], None]:
    return lambda balance: print_faults(
        find_faults(balance, height_of(config, balance), config.balance), [], live=True
    )


def _ask(session: LearnedTurns, devices: Devices) -> bool:
    """Ask the operator what was turned; False to end."""
    question = (
        "turned (weight turns, e.g. x 1.5, or x 1.5 -0.75 in sequence; Enter: measure again;"
        " f: forget the last turn learned; q: end)? "
    )
    while True:
        try:
            answer = input(question).split()
        except (EOFError, KeyboardInterrupt):
            return False
        if not answer:
            return True
        if answer[0] == "q":
            return False
        if answer[0] == "f":
            session.forget()
            continue
        try:
            weight, parts = answer[0].lower(), [float(word) for word in answer[1:]]
            if weight not in WEIGHTS or not parts or not all(map(math.isfinite, parts)):
                raise ValueError
        except ValueError:
            say(f"enter a weight ({', '.join(WEIGHTS)}) and a number of turns, positive clockwise")
            continue
        session.turned(weight, parts)
        devices.audit("weight turned", weight=weight, turns=parts)
        return True
