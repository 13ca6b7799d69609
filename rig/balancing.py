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
from calibration.axes import Axes
from processing.balance import Balance
from processing.balance_advice import (
    Fault,
    Turn,
    WeightResponses,
    find_faults,
)
from processing.errors import ConfigurationError, DataError
from processing.spot import SpotTracker
from rig.balance_state import DIRECTIONS, WEIGHTS, height_of, limits_of, nominal_effects
from rig.config import Configuration
from rig.devices import Devices
from rig.instrument import camera_settings, complete, sensor_model
from rig.measuring import frame_policy
from rig.pipeline import Pipeline
from rig.stream import FrameStream
from rig.view.balance_screen import print_advice, print_faults
from rig.view.terminal import say

Floats = NDArray[np.float64]


def look(config: Configuration, devices: Devices, show: Callable[[Balance], None]) -> Balance:
    """Some periods of swinging; `show` gets every balance, the last one is returned. Raises DataError."""
    calibrated = config.lever is not None
    found: Balance | None = None
    with devices.camera(config) as camera:
        sensor = sensor_model(config, camera.info.full_scale_dn)
        camera.camera.start()
        stream = FrameStream(
            camera.camera,
            camera_settings(config),
            policy=frame_policy(config),
            timeout_s=config.camera.timeout_s,
        )
        try:
            first = stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all")
            shape = (first.image.shape[0], first.image.shape[1])
            pipeline = Pipeline(SpotTracker(sensor), config.lever, config.axes or Axes(), shape)
            end_ns = first.time_ns + round(1e9 * config.balance.seconds)
            while not stream.drained:
                frames = stream.take(32, 0.1)
                if not frames:
                    continue
                for balance in pipeline.process(frames).balances:
                    found = balance
                    show(balance)
                if frames[-1].time_ns >= end_ns:
                    break
        finally:
            stream.close()
    if found is None:
        raise stream.failure or DataError(
            f"no swing was seen in {config.balance.seconds:g} s: let the pendulum swing, some arcsec or more"
        )
    if not calibrated:
        raise ConfigurationError("rig balance needs [lever]: without it nothing is known in arcsec")
    return found


class BalancingSession:
    """States, turns and what was learned, kept in a file of one JSON object a line."""

    def __init__(self, config: Configuration, history: Path) -> None:
        self._config = config
        self._history = history
        self.limits = limits_of(config)
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
        for line in self._history.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            if entry.get("weight") in WEIGHTS:
                before, after, u = (
                    np.array(entry[key], dtype=np.float64) for key in ("before", "after", "u")
                )
                self.responses.learn(entry["weight"], entry["turns"], before, after, np.nan_to_num(u))
                pairs += 1
        say(f"{self._history}: {pairs} turns of earlier times are known")


def balance_rig(config: Configuration, history: Path | None, follow: int, seed: int) -> int:
    """Look, advise, ask what was turned, until told to end; with `follow` the simulated rig obeys."""
    config = complete(config)
    trimmed: TrimmedPendulum | None = None
    if follow:
        if config.camera.driver != "simulated":
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
    with Devices(config) as devices:
        devices.light()
        while True:
            if trimmed is not None:
                config = config.model_copy(update={"simulation": trimmed.settings})
            balance = look(config, devices, _shower(config))
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
    return find_faults(balance, height_of(config, balance), limits_of(config))


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
