"""The loop of `rig balance`: measure the balance, advise a turn of a weight, learn from it, repeat."""

import math
from collections.abc import Callable
from pathlib import Path

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import TrimmedPendulum, TrimWeight, imperfect_weights
from processing.balance import Balance, Turn, balance_checks
from processing.errors import ConfigurationError, DataError, DeviceError
from processing.spot import SpotFlag
from processing.units import nanoseconds
from rig.devices import (
    AuditEntry,
    Devices,
    LightWatch,
    ask_acknowledgement,
    light_shown_to_desk,
    wait_for_command,
)
from rig.instrument import (
    DIRECTIONS,
    WEIGHTS,
    Pipeline,
    advice_for,
    complete,
    mass_centre_height,
    optics_of,
    prepare_kernels,
)
from rig.prepare.dialogue import Reporter
from rig.prepare.learned_turns import BalanceMeasurement, LearnedTurns, forget_last_turn, show_turns
from rig.settings import Configuration
from rig.terminal import answer, say
from rig.view import BalanceView

_BAD_SPOT = SpotFlag.LOST | SpotFlag.EDGE
_MIN_PULSE_S = 0.01


def measure(
    config: Configuration,
    devices: Devices,
    show: Callable[[Balance], None],
    view: BalanceView,
    swing_arcsec: float = math.inf,
) -> BalanceMeasurement:
    """Measure the balance until all of it is known, or `balance.seconds` have passed.

    `show` is called with each balance. The starter or magnet that starts runs also starts this swing, the
    starter with at most `swing_arcsec`. Raises DataError without frames, DeviceError if the laser goes
    dark or the camera fails.
    """
    if config.lever is None:
        raise ConfigurationError("rig balance needs [lever], because its limits are in arcsec")
    balance: Balance | None = None
    with devices.camera(config) as camera:
        optics = optics_of(config, camera.info.full_scale_dn)
        prepare_kernels(optics.sensor, say)
        # lit only while frames are taken: at other times the operator's hands may be at the pendulum
        ask_acknowledgement(devices)
        if message := devices.light():
            say(message)
        stream = devices.stream(config, camera)
        light = LightWatch(devices)
        try:
            stream.start_camera()
            first = stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all")
            shape = (first.image.shape[0], first.image.shape[1])
            pipeline = Pipeline(optics, shape)
            view.begin(first, camera.info)
            lost = taken = 0
            begin_ns = first.time_ns + nanoseconds(_start_swing(config, devices, swing_arcsec))
            end_ns = begin_ns + nanoseconds(config.balance.seconds)
            is_held = begin_ns > first.time_ns
            while not stream.drained:
                frames = stream.take(32, 0.1)
                light.look()
                if light.alarm:
                    raise DeviceError(light.alarm)
                if is_held and frames and frames[-1].time_ns >= begin_ns:
                    wait_for_command(devices.required_control("the magnet").submit(lambda c: c.release()))
                    is_held = False
                if not frames or is_held:
                    continue
                block = pipeline.process(frames)
                view.block(frames, block)
                taken += len(frames)
                lost += sum(bool(spot.flags & _BAD_SPOT) for spot in block.spots)
                for balance in block.balances:
                    show(balance)
                # the rotation of the line is the last quantity that becomes known
                is_complete = balance is not None and math.isfinite(balance.rotation_rad_per_s)
                if is_complete or frames[-1].time_ns >= end_ns:
                    break
        finally:
            devices.darken()
            stream.close()
    if balance is None and stream.failure is not None:
        raise stream.failure
    return BalanceMeasurement(balance, lost / max(taken, 1), shape)


def _start_swing(config: Configuration, devices: Devices, swing_arcsec: float) -> float:
    """Let the starter push or the magnet hold; returns the time in s after which the magnet must release."""
    start = config.start
    if start.way == "starter":
        fraction = min(1.0, swing_arcsec / config.session.initial_amplitude_arcsec)
        pulse_s = max(fraction * start.starter_pulse_s, _MIN_PULSE_S)
        wait_for_command(devices.required_control("the starter").submit(lambda c: c.starter_pulse(pulse_s)))
    if start.way != "magnet":
        return 0.0
    wait_for_command(devices.required_control("the magnet").submit(lambda c: c.hold()))
    return config.phases.rest_window_s


_MAX_MEASUREMENTS_PER_TURN = 5
_MIN_SWING_ARCSEC = 10.0
"""Amplitude to which a swing is reduced at most."""


class SimulatedOperator:
    """A simulated operator, who turns weights; if none are given they deviate at random from drawings."""

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
        self._full_swing_arcsec = self._swing_arcsec = config.simulation.release.amplitude_arcsec

    @property
    def simulation(self) -> SimulationSettings:
        """Settings of the simulated rig in its present state."""
        settings = self._pendulum.settings
        release = settings.release.model_copy(update={"amplitude_arcsec": self._swing_arcsec})
        return settings.model_copy(update={"release": release})

    def follow(self, turn: Turn) -> None:
        """Turn a weight, then let the pendulum swing no more than the advice allows."""
        for part in turn.parts:
            self._pendulum.turn(turn.weight, part)
        self._swing_arcsec = min(self._full_swing_arcsec, turn.swing_arcsec)

    def swing_less(self) -> bool:
        """Halve the amplitude; returns False if it is small already."""
        if self._swing_arcsec <= _MIN_SWING_ARCSEC:
            return False
        self._swing_arcsec = max(0.5 * self._swing_arcsec, _MIN_SWING_ARCSEC)
        return True


def _history_path(config: Configuration, path: Path | None) -> Path:
    """The file in which turns are stored; simulated turns have their own, because they teach nothing."""
    name = "balance-history-simulated.jsonl" if config.simulated else "balance-history.jsonl"
    return path or config.session.output / name


def show_history(config: Configuration, path: Path | None, *, forget: bool) -> None:
    """Print what was learned from earlier turns; with `forget` discard the last turn first."""
    config = complete(config)
    path = _history_path(config, path)
    if forget:
        message = forget_last_turn(path)
        say(message)
        answer(forgotten=message)
    show_turns(config, path)


def balance_rig(
    config: Configuration,
    path: Path | None,
    follow: int,
    seed: int | None,
    rrd: Path | None,
    reporter: Reporter,
) -> int:
    """Measure, advise and ask which weight was turned, until the operator ends it.

    With the simulated rig, a simulated operator, whose weights are random by `seed`, makes the stated turns;
    with `follow` > 0 it follows the advice, for at most that many turns. All measurements are drawn into the
    configured live view and into `rrd`, and reported by `reporter`.
    """
    config = complete(config)
    if follow and not config.simulated:
        raise ConfigurationError("--follow works with the simulated rig only: leave it out")
    if seed is not None and not config.simulated:
        raise ConfigurationError(f"--seed {seed} works with the simulated rig only: leave it out")
    operator = SimulatedOperator(config, 1 if seed is None else seed) if config.simulated else None
    path = _history_path(config, path)
    session = LearnedTurns(config, path)

    def advise(balance: Balance) -> str:
        return advice_for(config, balance, session.responses, session.room)

    def show(balance: Balance) -> None:
        reporter.report_live(balance_checks(balance, mass_centre_height(config, balance), config.balance))

    turns = measurements = 0
    swing_arcsec = math.inf
    with (
        Devices(config, path.parent, "rig balance") as devices,
        light_shown_to_desk(devices, path.parent),
        BalanceView(config, rrd, advise, reporter.report_trajectory) as view,
    ):
        while True:
            if operator is not None:
                config = config.model_copy(update={"simulation": operator.simulation})
            measurements += 1
            try:
                rejection = session.take(measure(config, devices, show, view, swing_arcsec))
            except DataError as error:
                rejection = str(error)
            if rejection:
                turn = _after_rejection(session, rejection, reporter)
                ended = False
                # the starter can follow the hint by itself
                smaller = 0.5 * min(swing_arcsec, config.session.initial_amplitude_arcsec)
                swing_arcsec = max(smaller, _MIN_SWING_ARCSEC)
            else:
                advice = session.advice()
                reporter.report_measurement(session.checks, session.earlier_checks, advice)
                # a fault that no weight cures remains a fault
                ended = advice is None and all(check.ok for check in session.checks if check.is_known)
                turn = advice if isinstance(advice, Turn) else None
                swing_arcsec = math.inf if turn is None else turn.swing_arcsec
            if operator is None or not follow:
                stated_turn = _ask(session, devices, reporter, is_sound=not rejection)
                if stated_turn is None:
                    return 0 if ended else 1
                if operator is not None and stated_turn.weight:
                    operator.follow(stated_turn)
            elif rejection and not session.spot_is_gone and operator.swing_less():
                continue
            elif turn is None or turns >= follow or measurements > _MAX_MEASUREMENTS_PER_TURN * follow:
                return 0 if ended else 1
            else:
                operator.follow(turn)
                session.note_turns(turn.weight, turn.parts)
                devices.audit(AuditEntry.WEIGHT, "as advised", weight=turn.weight, turns=turn.parts)
                turns += 1


def _after_rejection(session: LearnedTurns, reason: str, reporter: Reporter) -> Turn | None:
    """Report why a measurement was rejected, and the remedy; returns a turn back that may help."""
    turn = session.way_back()
    hint = ""
    if not session.spot_is_gone:
        hint = "let it swing by half as much, and measure again"
        hint += "; if that does not help:" if turn else ""
    reporter.report_rejection(reason, hint, turn)
    return turn


_MAX_TURNS = 50.0
"""Largest number of turns: no thread is longer, so that a larger number is a typing error."""
_NO_TURN = Turn("", 0.0, "")


def _ask(session: LearnedTurns, devices: Devices, reporter: Reporter, *, is_sound: bool) -> Turn | None:
    """Ask the operator for the turn made; returns a turn without a weight for none, None to end.

    After a sound measurement the advice is given again if a turn is forgotten, because it may rest on that
    turn.
    """
    while True:
        try:
            words = reporter.ask().split()
        except (EOFError, KeyboardInterrupt):
            return None
        if not words or words == ["m"]:
            return _NO_TURN
        if words[0] == "q":
            return None
        if words[0] == "f":
            reporter.report_forgotten(session.forget())
            if is_sound:
                reporter.report_measurement(session.checks, session.earlier_checks, session.advice())
            continue
        try:
            weight, parts = words[0].lower(), [float(word) for word in words[1:]]
            if weight not in WEIGHTS or not parts or not all(abs(part) <= _MAX_TURNS for part in parts):
                raise ValueError
        except ValueError:
            reporter.report_invalid(
                f"{' '.join(words)!r}: should be a weight ({', '.join(WEIGHTS)}) and its turns, up to "
                f"{_MAX_TURNS:g}, with a point, positive clockwise: {WEIGHTS[0]} -0.5"
            )
            continue
        session.note_turns(weight, parts)
        devices.audit(AuditEntry.WEIGHT, "stated by the operator", weight=weight, turns=parts)
        return Turn(weight, parts[0], "", sum(parts[1:]))
