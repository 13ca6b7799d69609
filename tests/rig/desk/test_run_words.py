"""What a run is said to be doing."""

import re

import pytest

from rig.desk.panels.run_words import first_fit, strip, time_left
from rig.instrument import Phase
from rig.measure import FIRST_HALF_CYCLES


def steps(text: str) -> list[str]:
    return re.findall(r"<li[^>]*>([^<]*)</li>", text)


def test_the_present_step_is_marked_and_has_its_value_against_its_limit() -> None:
    shown = strip({"phase": "warm-up", "progress": "3 of 5 s"}, "by hand")
    assert steps(shown) == [
        "devices", "rest", "warm-up: 3 of 5 s", "preflight", "release", "recording", "closing"
    ]  # fmt: skip
    assert re.findall(r"<li aria-current=step>([^<]*)", shown) == ["warm-up: 3 of 5 s"]


def test_a_run_that_begins_at_once_has_neither_rest_nor_release() -> None:
    assert steps(strip({"phase": Phase.MEASURING}, "at once")) == [
        "devices", "preflight", "recording", "closing"
    ]  # fmt: skip


def test_the_step_a_run_is_at_is_always_shown() -> None:
    assert "<li aria-current=step>rest</li>" in strip({"phase": Phase.REST}, "at once")


def test_what_has_said_nothing_yet_opens_its_devices() -> None:
    assert "<li aria-current=step>devices</li>" in strip({}, "magnet")


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
