"""What is judged of half-cycles during a run: the start by first amplitude and plane, steps as events."""

import math

import numpy as np
import pytest

from acquisition.record.events import EventKind
from calibration import deflection_unit
from calibration.light_lever import Lever
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.instrument import Block
from rig.measure.readings import StepEvents
from rig.measure.session_orders import StartJudge
from rig.settings import Configuration


def judge(lever: Lever | None) -> StartJudge:
    config = Configuration(camera={"driver": "simulated"})
    return StartJudge(config, deflection_unit(lever))


def swings(amplitude: float) -> list[HalfCycle]:
    return [
        HalfCycle(k, k * 10**9, 1e-5, amplitude, 1e-3 * amplitude, 1.0, 1e-5, 0.0, 1, 0) for k in range(2)
    ]


@pytest.mark.parametrize(("amplitude_arcsec", "accepted"), [(124.0, True), (10.0, False), (1000.0, False)])
def test_a_first_amplitude_in_arcsec_has_limits(amplitude_arcsec: float, accepted: bool) -> None:
    lever = Lever(arm_m=1.0, pixel_pitch_m=5e-6)
    rejection = judge(lever).rejection(swings(amplitude_arcsec * ARCSEC_RAD), [], 1.0)
    assert (rejection == "") is accepted
    if not accepted:
        assert f"first amplitude {amplitude_arcsec:.1f} arcsec" in rejection


@pytest.mark.parametrize("amplitude_px", [10.0, 1000.0])
def test_a_first_amplitude_in_px_has_none(amplitude_px: float) -> None:
    assert judge(None).rejection(swings(amplitude_px), [], 1.0) == ""


def balance(rotation_deg_per_min: float, u_deg_per_min: float = 0.01) -> Balance:
    per_min = math.pi / 180.0 / 60.0
    known = {
        "unit": DeflectionUnit.RAD,
        "amplitude": 124.0 * ARCSEC_RAD,
        "transverse_ratio": 0.001,
        "rotation_rad_per_s": rotation_deg_per_min * per_min,
        "u_rotation_rad_per_s": u_deg_per_min * per_min,
    }
    return Balance(**{**dict.fromkeys(Balance.__slots__, math.nan), **known})


@pytest.mark.parametrize(
    ("rate", "u", "rejected"),
    [(0.1, 0.01, False), (1.72, 0.01, True), (-1.72, 0.01, True), (0.3, 0.1, False)],
)
def test_a_plane_that_turns_is_no_start(rate: float, u: float, rejected: bool) -> None:
    """It is known some periods after the start was accepted otherwise, and judged once."""
    started = judge(Lever(arm_m=1.0, pixel_pitch_m=5e-6))
    unknown = balance(math.nan)
    assert started.rejection(swings(124.0 * ARCSEC_RAD), [unknown, unknown], 10.0) == ""
    why = started.rejection([], [unknown, balance(rate, u)], 20.0)
    assert bool(why) is rejected
    if rejected:
        assert f"{rate:+.2f} deg/min, at most 0.2 deg/min" in why
    assert started.rejection([], [balance(9.0)], 30.0) == ""


HALF_PERIOD_NS = 2_000_000_000


def half_cycle(index: int, rest_arcsec: float, background_dn: float) -> Block:
    """One block that ends with a turning point."""
    spots = [Spot(1.0, 2.0, 0.01, 0.01, 6.0, 6.0, 0.0, 150.0, background_dn, 1.0, 0)] * 10
    swing = HalfCycle(
        index, index * HALF_PERIOD_NS, 1e-4, 5e-4, 1e-8, 2.0, 1e-4, rest_arcsec * ARCSEC_RAD, 1, 0
    )
    nothing = Deflections(*[np.empty(0)] * 5, DeflectionUnit.RAD)
    return Block(spots=spots, deflections=nothing, half_cycles=[swing], balances=[])


@pytest.mark.parametrize(
    ("rest_arcsec", "background_dn", "kind", "text"),
    [
        (10.0, 0.0, EventKind.REST_STEP, "the rest position moved by +10.0 arcsec"),
        (0.0, 4.0, EventKind.LIGHT_STEP, "the background moved by +4.0 DN"),
    ],
)
def test_a_step_is_an_event_at_its_half_cycle(
    rest_arcsec: float, background_dn: float, kind: str, text: str
) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.02, (60, 2))
    steps, found = StepEvents(DeflectionUnit.RAD), []
    for index, (rest, light) in enumerate(noise):
        late = index >= 40
        found += steps.take(half_cycle(index, rest + late * rest_arcsec, 6.0 + light + late * background_dn))
    (event,) = found
    assert event.kind == kind
    assert event.text == text
    assert abs(event.time_ns - 40 * HALF_PERIOD_NS) <= 2 * HALF_PERIOD_NS


def test_a_draught_that_pushes_the_swing_is_an_event_whenever_it_comes() -> None:
    period_s, decay, noise = 4.07, 0.004, np.random.default_rng(1).normal(0.0, 0.01, 80)
    for phase in (0.0, 0.7, 1.5):
        events, found = StepEvents(DeflectionUnit.RAD), []
        for index in range(80):
            late = index >= 40
            # a push of 3 arcsec changes amplitude or phase, as it comes while the pendulum is fast or turns
            amplitude = 100.0 * np.exp(-decay * index) + late * 3.0 * np.cos(phase) + noise[index]
            delay_s = late * 3.0 * np.sin(phase) / 85.0 * period_s / (2 * np.pi)
            time_ns = round((index * period_s / 2 + delay_s) * 1e9)
            swing = HalfCycle(index, time_ns, 1e-4, amplitude * ARCSEC_RAD, 1e-8, 2.0, 1e-4, 0.0, 1, 0)
            found += events.take(half_cycle(index, 0.0, 0.0)._replace(half_cycles=[swing], spots=[]))
        (event,) = found
        assert event.kind == EventKind.PUSH
        assert float(event.text.split()[5]) == pytest.approx(3.0, abs=0.2)
        assert abs(event.time_ns * 1e-9 - 40 * period_s / 2) < 2 * period_s
