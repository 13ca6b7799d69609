"""What the State panel says: of what time it is, and why another panel is empty."""

import math
from dataclasses import replace

import pytest

from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from rig.instrument import CameraClock, Phase, Snapshot
from rig.presentation import Shown
from rig.view.state_text import empty_panels, state_text

PARAMETERS = {"b": Shown("b", "", "exponent"), "gamma": Shown("γ", "MPa", "pressure")}
KNOWN = CameraClock(30.0, 0.1)
BEGUN = Snapshot(phase=Phase.MEASURING, frame_age_s=0.001)


def said(snapshot: Snapshot, *, balanced: bool = True, with_lever: bool = True) -> str:
    parameters = PARAMETERS if with_lever else {}
    return "; ".join(empty_panels(snapshot, parameters, balanced=balanced, with_lever=with_lever))


def test_the_state_says_of_what_time_it_is() -> None:
    text = state_text(BEGUN, DeflectionUnit.RAD, "15:04:05", ["the balance is empty"])
    assert "- state of 15:04:05\n" in text
    assert "1 ms old when they were processed" in text
    assert "- the balance is empty\n" in text


def test_every_empty_panel_has_a_reason() -> None:
    text = said(BEGUN, balanced=False)
    assert "amplitude and period are empty until a half-cycle" in text
    assert "the balance is empty until" in text
    assert "the clock is empty until" in text
    assert "enough half-cycles for a first fit" in text
    assert "until the record begins" in said(replace(BEGUN, phase=Phase.WARM_UP))
    assert "without [lever]" in said(BEGUN, with_lever=False)


@pytest.mark.parametrize(("u", "vague"), [(0.4, False), (0.6, True), (math.nan, True)])
def test_a_parameter_that_is_not_drawn_is_named(u: float, vague: bool) -> None:
    found = {"b": Estimate(1.0, 0.01), "gamma": Estimate(1.0, u)}
    text = said(replace(BEGUN, clock=KNOWN, half_cycles=90, estimates=found, estimated_from=80))
    assert text == ("not known to a half of their values yet, hence not drawn: γ" if vague else "")
