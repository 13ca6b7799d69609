"""Alarms are active, cleared, acknowledged, and each has its times."""

from itertools import count

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import RigError
from rig.desk.alarm_list import ALARM_DELAY_S, AlarmKey, AlarmList, AlarmRow, AlarmState

CAMERA, SPOT, TRIP, DIED = AlarmKey.CAMERA, AlarmKey.SPOT, AlarmKey.TRIP, AlarmKey.SESSION_DIED


@pytest.fixture
def alarms() -> AlarmList:
    """A list whose clock is a second later at each look."""
    seconds = count(1000)
    return AlarmList(lambda: float(next(seconds)))


def only(alarms: AlarmList) -> AlarmRow:
    (row,) = alarms.rows()
    return row


def test_an_alarm_is_active_acknowledged_and_gone_once_its_cause_is(alarms: AlarmList) -> None:
    alarms.update({CAMERA: "no frame since 12:00"})
    assert (only(alarms).state, only(alarms).raised_s, only(alarms).is_loud) == (
        AlarmState.ACTIVE,
        1000.0,
        True,
    )
    alarms.acknowledge(CAMERA)
    row = only(alarms)
    assert (row.state, row.acknowledged_s, row.is_loud) == (AlarmState.ACKNOWLEDGED, 1001.0, False)
    alarms.update({CAMERA: "still"})
    assert (only(alarms).state, only(alarms).cause) == (AlarmState.ACKNOWLEDGED, "still")
    alarms.update({})
    assert alarms.rows() == []


def test_one_that_was_not_seen_stays_as_cleared_until_somebody_has_and_cries_again(alarms: AlarmList) -> None:
    for times in (1, 2, 3):
        alarms.update({SPOT: "blocked"})
        assert only(alarms).is_loud
        alarms.update({})
        row = only(alarms)
        assert (row.state, row.cause, row.count, row.is_loud) == (AlarmState.CLEARED, "blocked", times, False)
    assert row.cleared_s == 1005.0
    alarms.acknowledge(SPOT)
    assert alarms.rows() == []


def test_a_trip_is_acknowledged_by_looking_only(alarms: AlarmList) -> None:
    alarms.update({TRIP: "trip 5 (INTERLOCK): the interlock opened"})
    with pytest.raises(RigError, match="check that nobody is in the beam path"):
        alarms.acknowledge(TRIP)
    assert only(alarms).is_loud
    # whoever acknowledged the trip has acknowledged this
    alarms.update({})
    assert alarms.rows() == []


def test_what_has_happened_stays_until_it_is_acknowledged_or_a_session_begins(alarms: AlarmList) -> None:
    alarms.update({}, [(DIED, "run-1 was killed")])
    alarms.update({})
    assert only(alarms).state is AlarmState.ACTIVE
    alarms.acknowledge(DIED)
    assert alarms.rows() == []
    with pytest.raises(RigError, match="not in the list any more"):
        alarms.acknowledge(DIED)
    alarms.update({CAMERA: ""}, [(DIED, "run-1 was killed")])
    alarms.session_begins()
    assert [(row.key, row.state) for row in alarms.rows()] == [
        (CAMERA, AlarmState.ACTIVE),
        (DIED, AlarmState.CLEARED),
    ]
    alarms.update({}, [(DIED, "run-2 was killed")])
    assert next(row for row in alarms.rows() if row.key == DIED).is_loud


def test_a_condition_of_a_moment_is_no_alarm() -> None:
    now_s = 1000.0
    alarms, key = AlarmList(lambda: now_s), AlarmKey.CONTROLLER
    for conditions in ({key: ""}, {}, {key: ""}):
        alarms.update(conditions)
    assert alarms.rows() == []
    now_s += ALARM_DELAY_S[key]
    alarms.update({key: ""})
    assert only(alarms).state is AlarmState.ACTIVE


def test_what_is_to_be_seen_first_comes_first(alarms: AlarmList) -> None:
    held = {SPOT: "", AlarmKey.INTERLOCK: "", AlarmKey.ENVIRONMENT: "", CAMERA: ""}
    alarms.update(held)
    # a second later, for which it must hold
    alarms.update(held)
    alarms.acknowledge(CAMERA)
    assert [row.key for row in alarms.rows()] == [AlarmKey.INTERLOCK, SPOT, AlarmKey.ENVIRONMENT, CAMERA]


def test_every_alarm_has_a_remedy() -> None:
    assert all(key and key.remedy and not key.endswith(".") for key in AlarmKey)
