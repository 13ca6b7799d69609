"""A laser may be lit only while frames are read, processed and recorded."""

import pytest

from processing.errors import DeviceError
from rig.control.light_permit import LONGEST_PAUSE_S, Interlock, LightPermit, Stage
from rig.control.safety_state import LatchedTrip, SafetyState, TripCause


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def permit(clock: Clock) -> LightPermit:
    return LightPermit(clock)


def test_nothing_needs_to_move_before_anything_is_lit(permit: LightPermit, clock: Clock) -> None:
    clock.now_s += 1000.0
    assert permit.refusal == ""


@pytest.mark.parametrize("stage", [Stage.CAMERA, Stage.PROCESSING])
def test_a_stage_that_stalls_is_named(permit: LightPermit, clock: Clock, stage: Stage) -> None:
    permit.begin()
    for _ in range(20):
        clock.now_s += 1.0
        for moving in {Stage.CAMERA, Stage.PROCESSING} - {stage}:
            permit.moved(moving)
        lit = clock.now_s <= 100.0 + LONGEST_PAUSE_S[stage]
        assert permit.refusal == ("" if lit else f"{stage} has stalled")
    permit.moved(stage)
    assert permit.refusal == ""


def test_a_recorder_is_watched_only_while_there_is_one(permit: LightPermit, clock: Clock) -> None:
    def others_move_for(time_s: float) -> None:
        clock.now_s += time_s
        permit.moved(Stage.CAMERA)
        permit.moved(Stage.PROCESSING)

    permit.begin()
    others_move_for(100.0)
    assert permit.refusal == ""
    permit.moved(Stage.RECORDER)
    others_move_for(LONGEST_PAUSE_S[Stage.RECORDER] - 1.0)
    assert permit.refusal == ""
    others_move_for(2.0)
    assert "the writing of the record" in permit.refusal
    permit.ended(Stage.RECORDER)
    assert permit.refusal == ""


def test_what_was_withdrawn_never_comes_back(permit: LightPermit) -> None:
    permit.withdraw("stopped by the user")
    permit.withdraw("later")
    permit.begin()
    assert permit.refusal == "stopped by the user"


@pytest.mark.parametrize("lit", [True, False])
def test_a_trip_latches_lit_or_dark_and_its_number_grows(clock: Clock, lit: bool) -> None:
    told: list[tuple[LatchedTrip, bool]] = []
    state = SafetyState()
    permit = LightPermit(clock, state, lambda *said: told.append(said))
    if lit:
        permit.begin()
    permit.trip(TripCause.INTERLOCK, Interlock.CONTROLLER.opened_text)
    permit.begin()
    assert permit.refusal == "trip 1 (INTERLOCK): the interlock of the controller opened"
    permit.trip(TripCause.OUTPUT, "it stays lit")
    assert told == [
        (LatchedTrip(1, TripCause.INTERLOCK, "the interlock of the controller opened", lit), True),
        (LatchedTrip(2, TripCause.OUTPUT, "it stays lit", True), True),
    ]
    with pytest.raises(DeviceError, match="trip 1 cannot be acknowledged: latched is trip 2"):
        state.acknowledge(1)
    state.acknowledge(2)
    assert permit.refusal == ""
    with pytest.raises(DeviceError, match="nothing is latched"):
        state.acknowledge(2)


def test_what_is_found_on_opening_is_latched_once(clock: Clock) -> None:
    """Who acknowledges opens the devices: the trip must keep the number that was shown."""
    permit = LightPermit(clock)
    for _ in range(2):
        permit.found(TripCause.INTERLOCK, Interlock.CONTROLLER.opened_text)
    assert permit.latched is not None
    assert permit.latched.number == 1
    permit.found(TripCause.OUTPUT, "it stays lit")
    assert permit.latched.number == 2
