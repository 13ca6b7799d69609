"""Alarms are active, cleared, acknowledged, and each has its times."""

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import RigError
from rig.desk.alarm_list import AFTER_S, AlarmKey, AlarmList, AlarmRow, AlarmState

CAMERA, SPOT, TRIP, DIED = AlarmKey.CAMERA, AlarmKey.SPOT, AlarmKey.TRIP, AlarmKey.SESSION_DIED


class Clock:
    """The time of the day, which a test sets."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def alarms(clock: Clock) -> AlarmList:
    return AlarmList(clock)


def only(alarms: AlarmList) -> AlarmRow:
    (row,) = alarms.rows()
    return row


def test_an_alarm_is_active_acknowledged_and_gone_once_its_cause_is(alarms: AlarmList, clock: Clock) -> None:
    alarms.see({CAMERA: "no frame since 12:00"})
    assert only(alarms).state is AlarmState.ACTIVE
    assert only(alarms).cries
    clock.now_s = 1005.0
    alarms.acknowledge(CAMERA)
    row = only(alarms)
    assert (row.state, row.acknowledged_s) == (AlarmState.ACKNOWLEDGED, 1005.0)
    assert not row.cries
    clock.now_s = 1010.0
    alarms.see({})
    assert alarms.rows() == []


def test_one_that_was_not_seen_stays_as_cleared_until_somebody_has(alarms: AlarmList, clock: Clock) -> None:
    alarms.see({SPOT: "blocked"})
    clock.now_s = 1003.0
    alarms.see({})
    row = only(alarms)
    assert (row.state, row.cleared_s, row.cause) == (AlarmState.CLEARED, 1003.0, "blocked")
    assert not row.cries
    alarms.acknowledge(SPOT)
    assert alarms.rows() == []


def test_one_that_comes_again_cries_again_and_is_counted(alarms: AlarmList) -> None:
    for _ in range(3):
        alarms.see({SPOT: ""})
        alarms.see({})
    assert only(alarms).times == 3
    alarms.see({SPOT: ""})
    alarms.acknowledge(SPOT)
    alarms.see({SPOT: "still"})
    assert only(alarms).state is AlarmState.ACKNOWLEDGED
    alarms.see({})
    alarms.see({SPOT: ""})
    assert only(alarms).cries


def test_a_trip_is_acknowledged_by_looking_only(alarms: AlarmList) -> None:
    alarms.see({TRIP: "trip 5 (INTERLOCK): the interlock opened"})
    with pytest.raises(RigError, match="check that nobody is in the beam path"):
        alarms.acknowledge(TRIP)
    assert only(alarms).cries
    # whoever acknowledged the trip has acknowledged this
    alarms.see({})
    assert alarms.rows() == []


def test_what_has_happened_stays_until_it_is_acknowledged(alarms: AlarmList) -> None:
    alarms.see({}, [(DIED, "run-1 was killed")])
    alarms.see({})
    assert only(alarms).state is AlarmState.ACTIVE
    alarms.acknowledge(DIED)
    assert alarms.rows() == []
    with pytest.raises(RigError, match="not in the list any more"):
        alarms.acknowledge(DIED)


def test_a_condition_of_a_moment_is_no_alarm(alarms: AlarmList, clock: Clock) -> None:
    key = AlarmKey.CONTROLLER
    alarms.see({key: ""})
    alarms.see({})
    alarms.see({key: ""})
    assert alarms.rows() == []
    clock.now_s += AFTER_S[key]
    alarms.see({key: ""})
    assert only(alarms).state is AlarmState.ACTIVE


def test_what_is_to_be_seen_first_comes_first(alarms: AlarmList, clock: Clock) -> None:
    held = {SPOT: "", AlarmKey.INTERLOCK: "", AlarmKey.ENVIRONMENT: "", CAMERA: ""}
    alarms.see(held)
    clock.now_s += AFTER_S[AlarmKey.ENVIRONMENT]
    alarms.see(held)
    alarms.acknowledge(CAMERA)
    assert [row.key for row in alarms.rows()] == [AlarmKey.INTERLOCK, SPOT, AlarmKey.ENVIRONMENT, CAMERA]


@pytest.mark.parametrize("key", AlarmKey)
def test_every_alarm_has_a_remedy(key: AlarmKey) -> None:
    assert all((key, key.remedy))
    assert not key.endswith(".")


def test_what_is_left_of_an_earlier_session_is_seen_last_and_not_heard(alarms: AlarmList) -> None:
    alarms.see({CAMERA: ""}, [(DIED, "run-1 was killed")])
    alarms.session_begins()
    assert [(row.key, row.state) for row in alarms.rows()] == [
        (CAMERA, AlarmState.ACTIVE),
        (DIED, AlarmState.CLEARED),
    ]
    alarms.see({}, [(DIED, "run-2 was killed")])
    assert next(row for row in alarms.rows() if row.key == DIED).cries
