"""The loop of `rig balance` with looks and answers that are given: what is measured, asked and turned."""

import math
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from processing.balance import Balance, Turn
from processing.spot import SpotFlag
from rig.prepare import balancing
from rig.prepare.balancing import SimulatedOperator, _start_swing, balance_rig, measure
from rig.prepare.dialogue import Reporter
from rig.prepare.learned_turns import BalanceMeasurement
from tests.rig.prepare.random_starts import modelled_look, random_start

CONFIG = random_start(1).config
SHAPE = (640, 640)


def sound() -> Balance:
    release = CONFIG.simulation.release.model_copy(update={"amplitude_arcsec": 40.0})
    balance = modelled_look(CONFIG.simulation.model_copy(update={"release": release}), 1).balance
    assert balance is not None
    return balance


class Told(Reporter):
    """What was reported, in one word each, and the answers."""

    def __init__(self, *answers: str) -> None:
        self.words: list[str] = []
        self._answers = iter(answers)

    def ask(self) -> str:
        return next(self._answers)

    def report_measurement(self, *_: Any) -> None:
        self.words.append("sound")

    def report_rejection(self, *_: Any) -> None:
        self.words.append("rejected")

    def report_invalid(self, problem: str) -> None:
        self.words.append("invalid")

    def report_forgotten(self, text: str) -> None:
        self.words.append("forgotten")


def test_answers_are_followed_and_a_swing_that_is_too_large_is_halved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = iter([None, None, sound(), sound()])
    swings, states = [], []

    def measured(config: Any, _devices: Any, _show: Any, _view: Any, swing_arcsec: float) -> Any:
        swings.append(swing_arcsec)
        states.append(config.simulation)
        return BalanceMeasurement(next(looks), 0.0, SHAPE)

    monkeypatch.setattr(balancing, "measure", measured)
    told = Told("m", "x 60", "x -60", "z 1", "f", "m", "f", "x 0.5 -0.25", "q")
    assert balance_rig(CONFIG, tmp_path / "history.jsonl", 0, 2, None, told) == 1, "not balanced"
    assert told.words == [
        *("rejected", "rejected", "invalid", "invalid", "invalid", "forgotten"),
        *("sound", "forgotten", "sound", "sound"),
    ]
    initial = CONFIG.session.initial_amplitude_arcsec
    assert swings[:3] == [math.inf, 0.5 * initial, 0.25 * initial]
    operator = SimulatedOperator(CONFIG, 2)
    assert states[:3] == [operator.simulation] * 3
    operator.follow(Turn("x", 0.5, "", -0.25))
    assert states[3].axes == operator.simulation.axes != states[2].axes


@pytest.mark.parametrize(("swing_arcsec", "pulse_s"), [(math.inf, 0.2), (31.0, 0.05), (1.0, 0.01)])
def test_the_starter_pushes_as_much_less_as_the_swing_is_to_be(
    swing_arcsec: float, pulse_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For the whole amplitude of 124 arcsec 0.2 s, and never less than 0.01 s."""
    start = CONFIG.start.model_copy(update={"way": "starter", "starter_pulse_s": 0.2})
    session = CONFIG.session.model_copy(update={"initial_amplitude_arcsec": 124.0})
    config = CONFIG.model_copy(update={"start": start, "session": session})
    pulses: list[float] = []
    starter = SimpleNamespace(starter_pulse=pulses.append)
    control = SimpleNamespace(submit=lambda command: command(starter))
    devices: Any = SimpleNamespace(required_control=lambda _: control)
    monkeypatch.setattr(balancing, "wait_for_command", lambda _: None)
    assert _start_swing(config, devices, swing_arcsec) == 0.0
    assert pulses == pytest.approx([pulse_s])


def test_the_spots_that_were_lost_or_cut_are_a_share_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [SimpleNamespace(time_ns=k, image=SimpleNamespace(shape=SHAPE)) for k in range(5)]
    flags: Iterable[int] = iter([SpotFlag.LOST, 0, SpotFlag.EDGE, SpotFlag.OUTLIERS, 0])
    looks = iter([replace(sound(), rotation_rad_per_s=rate) for rate in (math.nan, 1e-5)])

    def process(taken: list[Any]) -> Any:
        spots = [SimpleNamespace(flags=flag) for _, flag in zip(taken, flags, strict=False)]
        return SimpleNamespace(spots=spots, balances=[next(looks)])

    blocks = iter([frames[:3], [], frames[3:]])
    stream = SimpleNamespace(
        start_camera=lambda: None, begin=lambda: frames[0], drained=False, failure=None,
        take=lambda _count, _wait_s: next(blocks), close=lambda: None,
    )  # fmt: skip
    camera = SimpleNamespace(info=SimpleNamespace(full_scale_dn=255))
    devices: Any = SimpleNamespace(
        camera=lambda _: nullcontext(camera), light=str, darken=lambda: None, stream=lambda *_: stream
    )
    monkeypatch.setattr(balancing, "prepare_kernels", lambda *_: None)
    monkeypatch.setattr(balancing, "ask_acknowledgement", lambda _: None)
    monkeypatch.setattr(balancing, "LightWatch", lambda _: SimpleNamespace(look=lambda: None, alarm=""))
    monkeypatch.setattr(balancing, "Pipeline", lambda *_: SimpleNamespace(process=process))
    view: Any = SimpleNamespace(begin=lambda *_: None, block=lambda *_: None)
    shown: list[Balance] = []
    found = measure(CONFIG, devices, shown.append, view)
    assert found.lost_fraction == pytest.approx(2 / 5)
    assert len(shown) == 2, "until the rotation is known"
    assert found.sensor_shape == SHAPE
