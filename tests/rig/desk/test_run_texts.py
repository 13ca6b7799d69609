"""What a run is said to be doing."""

import re
from typing import Any

import pytest

from rig.desk.panels.run_texts import first_fit, sorted_events, step_bar, time_left
from rig.instrument import Phase
from rig.measure import FIRST_HALF_CYCLES

AT_ONCE = ["devices", "preflight", "recording", "closing"]
ALL = ["devices", "rest", "warm-up", "preflight", "release", "recording", "closing"]


@pytest.mark.parametrize(
    ("state", "start_way", "steps", "present"),
    [
        ({}, "magnet", ALL, "devices"),
        ({"phase": Phase.MEASURING}, "at once", AT_ONCE, "recording"),
        # what a run does counts, whatever its configuration says
        ({"phase": Phase.REST}, "at once", ALL, "rest"),
        ({"phase": Phase.WARM_UP, "progress": "3 of 5 s"}, "by hand", ALL, "warm-up: 3 of 5 s"),
    ],
)
def test_steps_with_the_present_one_against_its_limit(
    state: dict[str, Any], start_way: str, steps: list[str], present: str
) -> None:
    shown = step_bar(state, start_way)
    assert re.findall(r"<li aria-current=step>([^<]*)", shown) == [present]
    assert [text.partition(":")[0] for text in re.findall(r"<li[^>]*>([^<]*)", shown)] == steps


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({}, "too early to say"),
        ({"remaining_s": 125.0, "u_remaining_s": 4.0}, "2:05 min ± 4 s"),
        ({"remaining_s": 60.0, "u_remaining_s": 0.0, "at_most_s": 60.0}, "1:00 min"),
        # the uncertainty exceeds the value: it is a bound
        ({"remaining_s": 0.0, "u_remaining_s": 1165.0, "at_most_s": 71.0}, "at most 1:11 min"),
        ({"remaining_s": 3.0, "u_remaining_s": 4.0, "at_most_s": 71.0}, "at most 0:11 min"),
        ({"remaining_s": None, "u_remaining_s": None, "at_most_s": 71.0}, "at most 1:11 min"),
    ],
)
def test_time_left(state: dict[str, float], words: str) -> None:
    assert time_left(state) == words


def test_the_first_fit_is_promised_only_while_it_is_ahead() -> None:
    assert first_fit({"half_cycles": 12}).endswith(f"from {FIRST_HALF_CYCLES} half-cycles on; 12 so far")
    assert first_fit({"half_cycles": 66}) == "the first fit of 66 half-cycles is being made"


def test_events_stand_in_the_order_of_time_and_say_a_trip_once() -> None:
    trip = "trip 1 (PERSON): LIGHT OFF was pressed at the desk"
    events = [
        {"time_s": time_s, "kind": kind, "level": level, "text": text}
        for time_s, kind, level, text in (
            (0.4, "beam", "information", "one Gaussian"),
            (0.0, "start", "information", "first frame"),
            (5.2, "controller", "information", f"laser off: {trip}"),
            (5.1, "trip", "trip", trip),
            (6.0, "laser dark", "alarm", trip),
            (7.0, "laser dark", "alarm", "the relay does not close"),
        )
    ]
    assert [(one["kind"], one["text"]) for one in sorted_events(events)] == [
        ("start", "first frame"),
        ("beam", "one Gaussian"),
        ("trip", trip),
        ("controller", "laser off"),
        ("laser dark", ""),
        ("laser dark", "the relay does not close"),
    ]
