"""A laser may be lit only while frames are read, processed and recorded."""

import pytest

from rig.control.light_permit import LONGEST_PAUSE_S, Interlock, LightPermit, Stage


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
    permit.acknowledge()
    assert permit.refusal == "stopped by the user"


def test_an_interlock_needs_an_acknowledgement_once_light_was_allowed(permit: LightPermit) -> None:
    permit.interlock_opened(Interlock.CONTROLLER)
    assert permit.refusal == ""
    permit.begin()
    permit.interlock_opened(Interlock.CONTROLLER)
    permit.begin()
    assert permit.refusal == "the interlock of the controller opened"
    permit.acknowledge()
    assert permit.refusal == ""
