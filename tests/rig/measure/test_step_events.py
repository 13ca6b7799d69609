"""A knock that shifts the rest position, and a lamp switched on, are events of a run."""

import numpy as np
import pytest

from acquisition.record.events import EventKind
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.instrument import Block
from rig.measure.readings import StepEvents

HALF_PERIOD_NS = 2_000_000_000


def half_cycle(index: int, rest_arcsec: float, background_dn: float) -> Block:
    """One block that ends with a turning point."""
    spots = [Spot(1.0, 2.0, 0.01, 0.01, 6.0, 6.0, 0.0, 150.0, background_dn, 1.0, 0)] * 10
    swing = HalfCycle(
        index, index * HALF_PERIOD_NS, 1e-4, 5e-4, 1e-8, 2.0, 1e-4, rest_arcsec * ARCSEC_RAD, 1, 0
    )
    nothing = Deflections(*[np.empty(0)] * 5, DeflectionUnit.RAD)
    return Block(spots=spots, deflections=nothing, swings=[swing], balances=[])


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
            found += events.take(half_cycle(index, 0.0, 0.0)._replace(swings=[swing], spots=[]))
        (event,) = found
        assert event.kind == EventKind.PUSH
        assert float(event.text.split()[5]) == pytest.approx(3.0, abs=0.2)
        assert abs(event.time_ns * 1e-9 - 40 * period_s / 2) < 2 * period_s
