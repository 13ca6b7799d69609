"""Which alarms follow from what a desk sees."""

from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from acquisition.record.events import EventKind
from rig.control import ControlState, LatchedTrip, Light, Loop, SafetyNow, TripCause
from rig.desk.alarm_list import AlarmKey
from rig.desk.alarming import conditions, event_alarms
from rig.instrument import Phase

MEASURING = {"phase": Phase.MEASURING, "temperature_c": 20.0}
FRESH = {"frames_age_s": 0.1, "spot_lost_s": 0.0}


def told(state: dict[str, Any] | None = None, **news: Any) -> dict[str, Any]:
    """A session that measures, and says this."""
    return {"news": {**FRESH, "state": {**MEASURING, **(state or {})}, **news}, "session": "run-of-today"}


LIT = SafetyNow(light=Light.ON, light_age_s=0.1, interlock=Loop.CLOSED, interlock_age_s=0.1)
TRIP = LatchedTrip(5, TripCause.INTERLOCK, "the interlock opened", True)
PRESSED = LatchedTrip(6, TripCause.PERSON, "LIGHT OFF was pressed at the desk", True)


def dark(trip: LatchedTrip | None, **safety: Any) -> dict[str, Any]:
    """A session whose light was taken: it sees no spot."""
    news = told({"alarm": "the laser is dark"}, darkness="LIGHT OFF", spot_lost_s=3.0)
    return news | {"safety": replace(LIT, light=Light.OFF, trip=trip, **safety)}


@pytest.mark.parametrize(
    ("seen", "keys"),
    [
        ({}, set()),
        (told(), set()),
        ({"safety": LIT, "lit_by": "the live picture"}, set()),
        ({"safety": replace(LIT, trip=TRIP)}, {AlarmKey.TRIP}),
        # an own act, and what follows from it
        ({"safety": replace(LIT, trip=PRESSED)}, set()),
        (dark(PRESSED), set()),
        (dark(TRIP), {AlarmKey.TRIP}),
        # acknowledged, and dark until somebody asks for light
        (dark(None, needs_request=True), set()),
        ({"safety": replace(LIT, interlock=Loop.OPEN)}, {AlarmKey.INTERLOCK}),
        ({"safety": replace(LIT, light=Light.DISAGREES)}, {AlarmKey.LIGHT_DISAGREES}),
        (
            {"safety": replace(LIT, light_age_s=2.5), "lit_by": "the live picture"},
            {AlarmKey.LASER_UNKNOWN},
        ),
        ({"safety": replace(LIT, light_age_s=2.5)}, set()),
        ({"safety": replace(LIT, controller=ControlState.LOST)}, {AlarmKey.CONTROLLER}),
        (told() | {"news_age_s": 2.1}, {AlarmKey.SESSION_FROZEN}),
        # a busy machine: the news are late, the session lives
        (told() | {"news_age_s": 4.0, "beat_age_s": 0.3}, set()),
        (told() | {"news_age_s": 4.0, "beat_age_s": 2.1}, {AlarmKey.SESSION_FROZEN}),
        (told() | {"news_age_s": 10.1, "beat_age_s": 0.3}, {AlarmKey.SESSION_FROZEN}),
        (told(frames_age_s=1.6), {AlarmKey.CAMERA}),
        (told(frames_age_s=1.6, camera={"applied": {"frame_rate_hz": 0.5}}), set()),
        (told({"phase": Phase.PREFLIGHT}, frames_age_s=9.0), set()),
        (told(spot_lost_s=0.4), set()),
        (told(spot_lost_s=0.6), {AlarmKey.SPOT}),
        (told({"alarm": "the laser is dark"}, darkness="LIGHT OFF"), {AlarmKey.LASER_DARK}),
        (
            told({"alarm": "the controller is lost"}, darkness="the controller is lost")
            | {"safety": replace(LIT, light=Light.CONTROLLER_SILENT)},
            {AlarmKey.LASER_UNKNOWN},
        ),
        (told({"alarm": "the recorder has stalled"}), {AlarmKey.STALLED}),
        (told({"alarm": "the disk has not answered", "disk_silent_s": 3.0}), {AlarmKey.DISK_HANGS}),
        (told({"temperature_c": None}) | {"sensor_configured": True}, {AlarmKey.ENVIRONMENT}),
        (told({"temperature_c": None}), set()),
        (
            told({"disk_free_bytes": 1.1e9, "record_bytes_per_s": 1e6, "remaining_s": 3600.0}),
            {AlarmKey.DISK_FORECAST},
        ),
        (told({"disk_free_bytes": 9e9, "record_bytes_per_s": 1e6, "remaining_s": 3600.0}), set()),
        (
            told({"phase": Phase.PREFLIGHT}, preflight=[{"name": "saturation", "ok": False}]),
            {AlarmKey.PREFLIGHT},
        ),
        (
            told(balance={"failed_checks": ["plane of swing +1.719 deg/min, limit 0.2 deg/min"]}),
            {AlarmKey.BALANCE},
        ),
        (told(balance={"failed_checks": []}), set()),
        (told({"phase": Phase.RELEASE}, balance={"failed_checks": ["plane of swing"]}), set()),
        ({"picture_age_s": 2.1}, {AlarmKey.CAMERA}),
    ],
)
def test_conditions(seen: dict[str, Any], keys: set[AlarmKey]) -> None:
    assert set(conditions(**{"safety": SafetyNow(), "news": {}, **seen})) == keys


def events(*kinds: EventKind) -> list[dict[str, str]]:
    return [{"kind": str(kind), "level": kind.level, "text": "so it was"} for kind in kinds]


def test_events_that_are_warnings_are_alarms_with_their_own_words() -> None:
    kinds = (EventKind.GAP, EventKind.CAMERA_LOST, EventKind.RECORD, EventKind.SPOT_LOST, EventKind.REST)
    assert event_alarms(events(*kinds), []) == [
        (AlarmKey.DISTURBED, "gap: so it was"),
        (AlarmKey.DISTURBED, "camera lost: so it was"),
        (AlarmKey.DISK_FULL, "so it was"),
    ]


def test_a_run_that_somebody_has_darkened_has_neither_failed_nor_found_anything() -> None:
    ends = [(AlarmKey.SESSION_FAILED, "a: the laser is dark"), (AlarmKey.SESSION_DIED, "a: killed")]
    found = events(EventKind.LIGHT_STEP, EventKind.FAILED, EventKind.RECORD)
    assert event_alarms(found, ends, PRESSED) == [(AlarmKey.DISK_FULL, "so it was"), ends[1]]
    assert [key for key, _ in event_alarms(found, ends, TRIP)] == [
        AlarmKey.SESSION_FAILED,
        AlarmKey.DISK_FULL,
        AlarmKey.SESSION_FAILED,
        AlarmKey.SESSION_DIED,
    ]
