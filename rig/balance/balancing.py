"""The command `rig balance`: measures the balance, advises a turn of a weight, learns from it, repeats."""

import math
from collections.abc import Callable
from pathlib import Path

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.weights import TrimmedPendulum, TrimWeight, imperfect_weights
from processing.balance import Balance, Turn, find_faults
from processing.errors import ConfigurationError, DataError
from rig.balance import history
from rig.balance.learned_turns import LearnedTurns
from rig.balance.look import LooksView, look
from rig.balance.reporter import OnTerminal, Reporter
from rig.devices import Audited, Devices
from rig.instrument import DIRECTIONS, WEIGHTS, advice_for, complete, height_of
from rig.orders import light_told
from rig.presentation import say
from rig.settings import Configuration

_LOOKS_A_TURN = 5
_LEAST_SWING_ARCSEC = 10.0


class SimulatedOperator:
    """Turns the weights of the simulated pendulum and lets it swing.

    Its weights deviate at random from their drawings (`seed`) unless `weights` are given.
    """

    def __init__(
        self, config: Configuration, seed: int, weights: dict[str, TrimWeight] | None = None
    ) -> None:
        if weights is None:
            settings = {name: getattr(config.balance, f"weight_{name}") for name in WEIGHTS}
            nominal = {
                name: TrimWeight(weight.mass_kg, weight.pitch_m, DIRECTIONS[name])
                for name, weight in settings.items()
            }
            weights = imperfect_weights(nominal, seed)
        self._pendulum = TrimmedPendulum(config.simulation, weights, seed=seed)
        self._usual_arcsec = self._swing_arcsec = config.simulation.release.amplitude_arcsec

    @property
    def simulation(self) -> SimulationSettings:
        """The simulated rig as it is now."""
        settings = self._pendulum.settings
        release = settings.release.model_copy(update={"amplitude_arcsec": self._swing_arcsec})
        return settings.model_copy(update={"release": release})

    def follow(self, turn: Turn) -> None:
        """Turn a weight, then let the pendulum swing no more than the advice allows."""
        for part in turn.parts:
            self._pendulum.turn(turn.weight, part)
        self._swing_arcsec = min(self._usual_arcsec, turn.swing_arcsec)

    def swing_less(self) -> bool:
        """Half the amplitude; False if it is small already."""
        if self._swing_arcsec <= _LEAST_SWING_ARCSEC:
            return False
        self._swing_arcsec = max(0.5 * self._swing_arcsec, _LEAST_SWING_ARCSEC)
        return True


def history_path(config: Configuration, stated: Path | None) -> Path:
    """The file in which turns are kept; turns of simulated weights teach nothing of the real ones."""
    name = "balance-history-simulated.jsonl" if config.simulated else "balance-history.jsonl"
    return stated or config.session.output / name


def show_history(config: Configuration, stated: Path | None, *, forget: bool) -> None:
    """Print what was learned from earlier turns; with `forget` take the last one back first."""
    config = complete(config)
    path = history_path(config, stated)
    if forget:
        say(history.forget_last(path))
    history.show(config, path)


def balance_rig(
    config: Configuration,
    path: Path | None,
    follow: int,
    seed: int | None,
    rrd: Path | None = None,
    operator: SimulatedOperator | None = None,
    reporter: Reporter | None = None,
) -> int:
    """Measure, advise and ask which weight was turned, until the operator ends it.

    What is stated as turned is turned at the simulated rig, by `operator` if given, else by one whose weights
    are drawn with `seed`; with `follow` the advice is applied there, for at most so many turns. All
    measurements are drawn into the configured live view and into `rrd`, and reported by `reporter`, on
    the terminal by default.
    """
    config = complete(config)
    if follow and not config.simulated:
        raise ConfigurationError("--follow works with the simulated rig only: leave it out")
    if seed is not None and not config.simulated:
        raise ConfigurationError(f"--seed {seed} works with the simulated rig only: leave it out")
    if operator is None and config.simulated:
        operator = SimulatedOperator(config, 1 if seed is None else seed)
    reporter = OnTerminal() if reporter is None else reporter
    session = LearnedTurns(config, history_path(config, path))
    stated = config

    def advise(balance: Balance) -> str:
        return advice_for(stated, balance, session.responses, session.room).markdown

    moves = looks = 0
    swing_arcsec = math.inf
    folder = history_path(config, path).parent
    with (
        Devices(config, folder, "rig balance") as devices,
        light_told(devices, config, folder),
        LooksView(config, rrd, advise, reporter.way) as view,
    ):
        while True:
            if operator is not None:
                config = config.model_copy(update={"simulation": operator.simulation})
            looks += 1
            try:
                why = session.take(look(config, devices, _shower(config, reporter), view, swing_arcsec))
            except DataError as error:
                why = str(error)
            if why:
                turn = _after_rejection(session, why, reporter)
                ended = False
                # what the starter can do of the hint
                smaller = 0.5 * min(swing_arcsec, config.session.initial_amplitude_arcsec)
                swing_arcsec = max(smaller, _LEAST_SWING_ARCSEC)
            else:
                advice = session.advice()
                reporter.found(session.faults, session.before, advice)
                ended, turn = advice is None, advice if isinstance(advice, Turn) else None
                swing_arcsec = math.inf if turn is None else turn.swing_arcsec
            if operator is None or not follow:
                stated_turn = _ask(session, devices, reporter)
                if stated_turn is None:
                    return 0 if ended else 1
                if operator is not None and stated_turn.weight:
                    operator.follow(stated_turn)
            elif why and not session.spot_is_gone and operator.swing_less():
                continue
            elif turn is None or moves >= follow or looks > _LOOKS_A_TURN * follow:
                return 0 if ended else 1
            else:
                operator.follow(turn)
                session.turned(turn.weight, turn.parts)
                devices.audit(Audited.WEIGHT, "as advised", weight=turn.weight, turns=turn.parts)
                moves += 1


def _after_rejection(session: LearnedTurns, why: str, reporter: Reporter) -> Turn | None:
    """Say why a measurement was rejected and what helps; returns the turn back that may."""
    turn = session.way_back()
    hint = ""
    if not session.spot_is_gone:
        hint = "let it swing by half as much, and measure again"
        hint += "; if that does not help:" if turn else ""
    reporter.rejected(why, hint, turn)
    return turn


def _shower(config: Configuration, reporter: Reporter) -> Callable[[Balance], None]:
    return lambda balance: reporter.live(find_faults(balance, height_of(config, balance), config.balance))


_MOST_TURNS = 50.0
"""No weight's thread is longer: more was typed by mistake."""
_NOTHING = Turn("", 0.0, "")


def _ask(session: LearnedTurns, devices: Devices, reporter: Reporter) -> Turn | None:
    """Ask the operator what was turned: a turn, one without a weight for none; None to end."""
    while True:
        try:
            answer = reporter.ask().split()
        except (EOFError, KeyboardInterrupt):
            return None
        if not answer or answer == ["m"]:
            return _NOTHING
        if answer[0] == "q":
            return None
        if answer[0] == "f":
            session.forget()
            continue
        try:
            weight, parts = answer[0].lower(), [float(word) for word in answer[1:]]
            if weight not in WEIGHTS or not parts or not all(abs(part) <= _MOST_TURNS for part in parts):
                raise ValueError
        except ValueError:
            reporter.wrong(
                f"{' '.join(answer)!r}: should be a weight ({', '.join(WEIGHTS)}) and its turns, up to "
                f"{_MOST_TURNS:g}, with a point, positive clockwise: {WEIGHTS[0]} -0.5"
            )
            continue
        session.turned(weight, parts)
        devices.audit(Audited.WEIGHT, "stated by the operator", weight=weight, turns=parts)
        return Turn(weight, parts[0], "", sum(parts[1:]))
