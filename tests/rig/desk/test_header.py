"""What the head of the page says of light that waits for a person."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from rig.control import LatchedTrip, Loop, SafetyNow, TripCause
from rig.desk import header
from rig.desk.alarm_list import AlarmKey, AlarmRow

CHECK = ". Check that nobody is in the beam path."
AGAIN = "Light again: once the trip is acknowledged"
OPEN = SafetyNow(interlock=Loop.OPEN, interlock_age_s=0.1)
PRESSED, OPENED = (
    LatchedTrip(5, cause, "it was so", lit=True) for cause in (TripCause.PERSON, TripCause.INTERLOCK)
)
NO_TRIP = "The laser is dark, and waits for a person"


@pytest.mark.parametrize(
    ("trip", "now", "awaits", "source", "why", "acknowledge", "again"),
    [
        (None, OPEN, True, True, NO_TRIP, ("", False, False), ("Light again", True, True)),
        (None, SafetyNow(), False, True, NO_TRIP, ("", False, True), (AGAIN, False, False)),
        (PRESSED, SafetyNow(), False, True, "It was so",
         ("Acknowledge trip 5 …", True, True), (AGAIN, True, False)),
        (OPENED, OPEN, False, None, "Trip 5 (INTERLOCK): it was so",
         ("Acknowledge trip 5: close the interlock first", True, False), (AGAIN, False, False)),
    ],
)  # fmt: skip
def test_a_light_that_waits_says_why_and_what_may_be_pressed(
    monkeypatch: pytest.MonkeyPatch, trip: LatchedTrip | None, now: SafetyNow, awaits: bool,
    source: bool | None, why: str, acknowledge: tuple[str, bool, bool], again: tuple[str, bool, bool],
) -> None:  # fmt: skip
    for name in ("ui", "trip_dialog", "in_background"):
        monkeypatch.setattr(header, name, MagicMock())
    lighting = SimpleNamespace(awaits_light=awaits, relight=None)
    safety = SimpleNamespace(trip=trip, now=now)
    tab = MagicMock()
    header._build_relight(MagicMock(lighting=lighting, safety=safety, picture_source=source), tab)
    assert tab.label.call_args.args[0]() == why + CHECK
    for call, said in zip(tab.button.call_args_list, (acknowledge, again), strict=True):
        assert (call.args[0](), call.kwargs["visible"](), call.kwargs["enabled"]()) == said
    tab.on_refresh.call_args.args[0]()
    shown = header.ui.element().classes().__enter__().set_visibility
    shown.assert_called_once_with(awaits or trip is not None)


def test_alarms_are_counted_by_their_states() -> None:
    cleared = [AlarmRow(key, "", 1.0, cleared_s=2.0) for key in (AlarmKey.SPOT, AlarmKey.CAMERA)]
    assert header._counts([AlarmRow(AlarmKey.TRIP, "", 1.0), *cleared]) == "Alarms: 1 active, 2 cleared"
    assert header._counts([]) == "Alarms: none"
