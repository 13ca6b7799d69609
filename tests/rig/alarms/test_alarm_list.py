"""Alarms are active, cleared, acknowledged, shelved, and each has its times."""

from dataclasses import replace

import pytest

from processing.errors import RigError
from rig.alarms import CATALOGUE, AlarmKey, AlarmList, AlarmRow, AlarmState

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
    (past,) = alarms.past
    assert (past.raised_s, past.acknowledged_s, past.cleared_s) == (1000.0, 1005.0, 1010.0)


def test_one_that_was_not_seen_stays_as_cleared_until_somebody_has(alarms: AlarmList, clock: Clock) -> None:
    alarms.see({SPOT: ""})
    clock.now_s = 1003.0
    alarms.see({})
    row = only(alarms)
    assert (row.state, row.cleared_s, row.cause) == (AlarmState.CLEARED, 1003.0, CATALOGUE[SPOT].cause)
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


def test_a_shelved_one_is_silent_and_comes_back_by_itself(alarms: AlarmList, clock: Clock) -> None:
    alarms.see({CAMERA: ""})
    alarms.shelve(CAMERA)
    assert only(alarms).state is AlarmState.SHELVED
    clock.now_s += 599.0
    alarms.see({CAMERA: ""})
    assert not only(alarms).cries
    clock.now_s += 2.0
    alarms.see({CAMERA: ""})
    assert only(alarms).cries


def test_danger_is_not_shelved_and_a_trip_is_acknowledged_by_looking_only(alarms: AlarmList) -> None:
    alarms.see({TRIP: "trip 5 (INTERLOCK): the interlock opened"})
    with pytest.raises(RigError, match="danger is not shelved"):
        alarms.shelve(TRIP)
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
    clock.now_s += CATALOGUE[key].after_s
    alarms.see({key: ""})
    assert only(alarms).state is AlarmState.ACTIVE


def test_what_is_to_be_seen_first_comes_first(alarms: AlarmList) -> None:
    alarms.see({SPOT: "", AlarmKey.INTERLOCK: "", AlarmKey.CONFIGURATION: "", CAMERA: ""})
    alarms.acknowledge(CAMERA)
    assert [row.key for row in alarms.rows()] == [AlarmKey.INTERLOCK, SPOT, AlarmKey.CONFIGURATION, CAMERA]


@pytest.mark.parametrize("key", AlarmKey)
def test_every_alarm_has_a_cause_and_a_remedy(key: AlarmKey) -> None:
    alarm = CATALOGUE[key]
    assert all((alarm.title, alarm.cause, alarm.remedy))
    assert not alarm.title.endswith(".")


def test_a_list_goes_on_where_the_last_desk_ended(alarms: AlarmList, clock: Clock) -> None:
    alarms.see({CAMERA: "no frame", SPOT: "gone"}, [(DIED, "run-1: its process is gone")])
    alarms.acknowledge(CAMERA)
    alarms.shelve(SPOT)
    alarms.see({SPOT: "gone"})
    clock.now_s = 1100.0
    later = AlarmList(clock)
    later.restore(alarms.kept())
    assert [replace(row, earlier=False) for row in later.rows()] == alarms.rows()
    assert list(later.past) == list(alarms.past)
    (camera,) = later.past
    assert camera.key == CAMERA
    # what is still there is the same alarm; what is not has gone, and waits to be seen
    later.see({SPOT: "gone"})
    states = {row.key: (row.state, row.raised_s) for row in later.rows()}
    assert states == {SPOT: (AlarmState.SHELVED, 1000.0), DIED: (AlarmState.ACTIVE, 1000.0)}
    later.see({})
    assert {row.key: row.cleared_s for row in later.rows()} == {SPOT: 1100.0, DIED: None}


@pytest.mark.parametrize("kept", [b"", b"{", b'{"rows": [{"key": "of another version"}]}'])
def test_what_is_no_list_starts_an_empty_one(alarms: AlarmList, kept: bytes) -> None:
    alarms.restore(kept)
    assert alarms.rows() == []


def test_what_is_left_of_an_earlier_session_is_seen_last_and_not_heard(alarms: AlarmList) -> None:
    alarms.see({CAMERA: ""}, [(DIED, "run-1 was killed")])
    alarms.session_begins()
    assert [(row.key, row.earlier, row.cries) for row in alarms.rows()] == [
        (CAMERA, False, True),
        (DIED, True, False),
    ]
    alarms.see({}, [(DIED, "run-2 was killed")])
    assert next(row for row in alarms.rows() if row.key == DIED).cries


def test_a_cause_that_holds_after_a_new_desk_has_begun_to_look_is_heard(
    alarms: AlarmList, clock: Clock
) -> None:
    alarms.see({CAMERA: ""})
    later = AlarmList(clock)
    later.restore(alarms.kept())
    later.session_begins()
    later.see({CAMERA: ""})
    assert only(later).cries


def test_what_an_earlier_desk_has_left_is_seen_and_not_heard_before_a_session_begins(
    alarms: AlarmList, clock: Clock
) -> None:
    alarms.see({}, [(DIED, "run-1 was killed")])
    later = AlarmList(clock)
    later.restore(alarms.kept())
    later.see({})
    assert only(later).state is AlarmState.ACTIVE
    assert not only(later).cries
