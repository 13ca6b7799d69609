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
from tests.rig.made_up import balance_of, half_cycle

LEVER = Lever(arm_m=1.0, pixel_pitch_m=5e-6)
HALF_PERIOD_NS = 2_000_000_000


def judge(lever: Lever | None = LEVER) -> StartJudge:
    return StartJudge(Configuration(camera={"driver": "simulated"}), deflection_unit(lever))


@pytest.mark.parametrize(
    ("lever", "amplitude", "said"),
    [
        (LEVER, 124.0 * ARCSEC_RAD, ""),
        (LEVER, 10.0 * ARCSEC_RAD, "first amplitude 10.0 arcsec"),
        (LEVER, 1000.0 * ARCSEC_RAD, "first amplitude 1000.0 arcsec"),
        # one in px has no limits
        (None, 10.0, ""),
        (None, 1000.0, ""),
    ],
)
def test_a_first_amplitude_in_arcsec_has_limits(lever: Lever | None, amplitude: float, said: str) -> None:
    rejection = judge(lever).rejection([half_cycle(k, amplitude) for k in range(2)], [], 1.0)
    assert said in rejection
    assert bool(rejection) is bool(said)


def balance(rotation_deg_per_min: float, u_deg_per_min: float = 0.01) -> Balance:
    per_min = math.pi / 180.0 / 60.0
    return balance_of(
        amplitude=124.0 * ARCSEC_RAD,
        transverse_ratio=0.001,
        rotation_rad_per_s=rotation_deg_per_min * per_min,
        u_rotation_rad_per_s=u_deg_per_min * per_min,
    )


@pytest.mark.parametrize(
    ("rate", "u", "rejected"),
    [(0.1, 0.01, False), (1.72, 0.01, True), (-1.72, 0.01, True), (0.3, 0.1, False)],
)
def test_a_plane_that_turns_is_no_start(rate: float, u: float, rejected: bool) -> None:
    """It is known some periods after the start was accepted otherwise, and judged once."""
    started, unknown = judge(), balance(math.nan)
    first = [half_cycle(k, 124.0 * ARCSEC_RAD) for k in range(2)]
    assert started.rejection(first, [unknown, unknown], 10.0) == ""
    why = started.rejection([], [unknown, balance(rate, u)], 20.0)
    assert bool(why) is rejected
    assert not rejected or f"{rate:+.2f} deg/min, at most 0.2 deg/min" in why
    assert started.rejection([], [balance(9.0)], 30.0) == ""


def block(turned: HalfCycle, background_dn: float | None = None) -> Block:
    """One that ends with a turning point."""
    spots = [] if background_dn is None else [Spot(*[1.0] * 7, 150.0, background_dn, 1.0, 0)] * 10
    nothing = Deflections(*[np.empty(0)] * 5, DeflectionUnit.RAD)
    return Block(spots=spots, deflections=nothing, half_cycles=[turned], balances=[])


@pytest.mark.parametrize(
    ("rest_arcsec", "background_dn", "kind", "text"),
    [
        (10.0, 0.0, EventKind.REST_STEP, "the rest position moved by +10.0 arcsec"),
        (-10.0, 0.0, EventKind.REST_STEP, "the rest position moved by -10.0 arcsec"),
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
        turned = half_cycle(index, 5e-4, rest=(rest + late * rest_arcsec) * ARCSEC_RAD)
        found += steps.take(block(turned, 6.0 + light + late * background_dn))
    (event,) = found
    assert (event.kind, event.text) == (kind, text)
    assert abs(event.time_ns - 40 * HALF_PERIOD_NS) <= 2 * HALF_PERIOD_NS


@pytest.mark.parametrize("phase", [0.0, 0.7, 1.5])
def test_a_draught_that_pushes_the_swing_is_an_event_whenever_it_comes(phase: float) -> None:
    decay, noise = 0.004, np.random.default_rng(1).normal(0.0, 0.01, 80)
    events, found = StepEvents(DeflectionUnit.RAD), []
    for index in range(80):
        late = index >= 40
        # a push of 3 arcsec changes amplitude or phase, as it comes while the pendulum is fast or turns
        amplitude = 100.0 * np.exp(-decay * index) + late * 3.0 * np.cos(phase) + noise[index]
        delay_s = late * 3.0 * np.sin(phase) / 85.0 * 4.0 / (2 * np.pi)
        found += events.take(block(half_cycle(index, amplitude * ARCSEC_RAD, late_s=delay_s)))
    (event,) = found
    assert event.kind == EventKind.PUSH
    assert float(event.text.split()[5]) == pytest.approx(3.0, abs=0.2)
    assert abs(event.time_ns - 40 * HALF_PERIOD_NS) < 4 * HALF_PERIOD_NS
