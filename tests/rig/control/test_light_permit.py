"""A laser may be lit only while frames are read, processed and recorded, and they show whether it is."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.errors import DeviceError
from rig.control.light_permit import LONGEST_PAUSE_S, Interlock, LightPermit, SpotWatch, Stage
from rig.control.safety_state import LatchedTrip, SafetyState, TripCause
from tests.rig.control.stepped import Clock


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def permit(clock: Clock) -> LightPermit:
    return LightPermit(clock.monotonic)


@pytest.mark.parametrize("stage", [Stage.CAMERA, Stage.PROCESSING])
def test_a_stage_that_stalls_is_named(permit: LightPermit, clock: Clock, stage: Stage) -> None:
    # nothing needs to move before anything is lit
    clock.sleep(1000.0)
    assert permit.refusal == ""
    permit.begin()
    began_s = clock.monotonic()
    for _ in range(20):
        clock.sleep(1.0)
        for moving in {Stage.CAMERA, Stage.PROCESSING} - {stage}:
            permit.note_progress(moving)
        lit = clock.monotonic() - began_s <= LONGEST_PAUSE_S[stage]
        assert permit.refusal == ("" if lit else f"{stage} has stalled")
    permit.note_progress(stage)
    assert permit.refusal == ""


def test_a_recorder_is_watched_only_while_there_is_one(permit: LightPermit, clock: Clock) -> None:
    def others_move_for(time_s: float) -> None:
        clock.sleep(time_s)
        permit.note_progress(Stage.CAMERA)
        permit.note_progress(Stage.PROCESSING)

    permit.begin()
    others_move_for(100.0)
    assert permit.refusal == ""
    permit.note_progress(Stage.RECORDER)
    others_move_for(LONGEST_PAUSE_S[Stage.RECORDER] - 1.0)
    assert permit.refusal == ""
    others_move_for(2.0)
    assert "the writing of the record" in permit.refusal
    permit.note_end(Stage.RECORDER)
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
    permit = LightPermit(clock.monotonic, state, lambda *said: told.append(said))
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
    permit = LightPermit(clock.monotonic)
    for _ in range(2):
        permit.latch_found(TripCause.INTERLOCK, Interlock.CONTROLLER.opened_text)
    assert permit.latched is not None
    assert permit.latched.number == 1
    permit.latch_found(TripCause.OUTPUT, "it stays lit")
    assert permit.latched.number == 2


@pytest.fixture
def spot(clock: Clock) -> SpotWatch:
    """Judges frames by those that were seen while the laser was lit."""
    return SpotWatch(clock.monotonic)


@cache
def ground(number: int) -> NDArray[np.float64]:
    """Noise, one of a few, and two hot pixels."""
    image = np.random.default_rng(number).normal(8.0, 1.5, (200, 300))
    image[5, 5] = image[9, 90] = 255
    return image


@cache
def light_dn(peak_dn: float, lamp_dn: float) -> NDArray[np.float64]:
    """A spot, and a lamp beside it."""
    y, x = np.mgrid[:200, :300]
    spot = peak_dn * np.exp(-((x - 150) ** 2 + (y - 100) ** 2) / 72)
    return np.asarray(spot + lamp_dn * np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 200))


def frame(peak_dn: float, lamp_dn: float = 0.0, number: int = 0) -> NDArray[np.uint8]:
    return np.asarray(np.clip(ground(number) + light_dn(peak_dn, lamp_dn), 0, 255), np.uint8)


def watched(clock: Clock, spot: SpotWatch, told: bool, peak_dn: float, lamp_dn: float = 0.0) -> None:
    """Three seconds of frames while the laser says of itself that it is lit, or not."""
    for number in range(60):
        clock.sleep(0.05)
        spot.examine(frame(peak_dn, lamp_dn, number % 7))
        spot.note_laser(told)


@pytest.mark.slow
@pytest.mark.parametrize("lit_dn", [40.0, 200.0, 400.0])
@pytest.mark.parametrize("left", [0.0, 0.5, 1.0])
def test_a_spot_that_stays_disagrees_and_one_that_goes_agrees(
    clock: Clock, spot: SpotWatch, lit_dn: float, left: float
) -> None:
    assert (spot.visible, spot.contradicts, spot.confirms) == (None, False, False)
    watched(clock, spot, True, lit_dn, lamp_dn=4.0)
    assert (spot.visible, spot.contradicts, spot.confirms) == (True, False, False)
    watched(clock, spot, False, left * lit_dn, lamp_dn=4.0)
    stays = left > 0
    assert (spot.visible, spot.contradicts, spot.confirms) == (stays, stays, not stays)


def test_a_spot_that_left_the_sensor_while_it_was_lit_confirms_no_darkness(
    clock: Clock, spot: SpotWatch
) -> None:
    """A pendulum that was knocked: what the camera did not see before, it does not see go out."""
    watched(clock, spot, True, 200.0)
    watched(clock, spot, True, 0.0)
    # a record takes its time to be closed
    clock.sleep(20.0)
    watched(clock, spot, False, 0.0)
    assert (spot.visible, spot.contradicts, spot.confirms) == (False, False, False)
    # one that comes back is still light that should be off
    watched(clock, spot, False, 200.0)
    assert spot.contradicts
    # and one that swings out of it and back again was seen
    for _ in range(3):
        watched(clock, spot, True, 200.0)
        clock.sleep(0.5)
        spot.examine(frame(0.0))
        spot.note_laser(True)
    clock.sleep(20.0)
    watched(clock, spot, False, 0.0)
    assert spot.confirms


def test_frames_on_their_way_do_not_disagree(clock: Clock, spot: SpotWatch) -> None:
    spot.exposure_s = 1.0
    watched(clock, spot, True, 200.0)
    watched(clock, spot, True, 200.0)
    watched(clock, spot, False, 200.0)
    assert spot.visible
    assert not spot.contradicts
    watched(clock, spot, False, 200.0)
    assert spot.contradicts


def test_where_no_spot_was_ever_seen_nothing_is_judged(clock: Clock, spot: SpotWatch) -> None:
    for told in (True, False):
        watched(clock, spot, told, 0.0)
    assert (spot.visible, spot.contradicts, spot.confirms) == (None, False, False)


def test_an_old_frame_has_its_age(clock: Clock, spot: SpotWatch) -> None:
    assert spot.age_s == np.inf
    spot.examine(frame(0.0))
    clock.sleep(5.0)
    assert spot.age_s == 5.0
    spot.examine(np.zeros((1, 2), np.uint8))
    assert spot.age_s == 5.0
