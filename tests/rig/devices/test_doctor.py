"""What `rig doctor` says of frames, and of what the configuration holds."""

import pytest

from acquisition.camera import CameraStatus
from rig.control import SafetyState, TripCause
from rig.devices.doctor import check_frames, check_settings, check_trip
from rig.instrument import complete
from rig.settings import Configuration, validate_configuration

ALL = CameraStatus(delivered=60)


def arrivals(rate_hz: float, count: int = 60) -> list[tuple[int, int]]:
    """Numbers and times of frames that come at this rate."""
    return [(number, round(1e9 * number / rate_hz)) for number in range(count)]


def test_frames_at_the_rate_that_was_asked_for() -> None:
    verdict = check_frames(arrivals(99.0), ALL, 100.0, on_demand=False)
    assert (verdict.ok, verdict.reason) == (True, "60 at 99 frames/s, lost: none")


@pytest.mark.parametrize(
    ("rate_hz", "remedy"), [(50.0, "a shorter exposure"), (6000.0, "rig camera show")], ids=["slow", "fast"]
)
def test_a_rate_that_was_not_asked_for_is_no_go(rate_hz: float, remedy: str) -> None:
    verdict = check_frames(arrivals(rate_hz), ALL, 100.0, on_demand=False)
    assert not verdict.ok
    assert "100 were asked for" in verdict.reason
    assert remedy in verdict.remedy
    assert check_frames(arrivals(rate_hz), ALL, None, on_demand=False).ok


def test_frames_made_on_demand_have_no_rate() -> None:
    verdict = check_frames(arrivals(6000.0), ALL, 100.0, on_demand=True)
    assert (verdict.ok, verdict.reason) == (True, "60, made on demand: no rate to judge, lost: none")


def test_frames_that_do_not_come_are_no_go() -> None:
    assert not check_frames([], CameraStatus(), 100.0, on_demand=False).ok
    lost = CameraStatus(delivered=60, dropped_by_bus=3)
    assert "another port" in check_frames(arrivals(100.0), lost, 100.0, on_demand=False).remedy


def settings_of(tree: dict[str, dict[str, object]]) -> dict[str, str]:
    stated: Configuration = validate_configuration(tree, "a test")
    return {verdict.name: verdict.reason for verdict in check_settings(complete(stated), stated)}


def test_what_is_not_stated_is_not_called_stated() -> None:
    simulated = settings_of(
        {"camera": {"driver": "simulated"}, "lever": {"arm_m": 1.0, "pixel_pitch_m": 4e-6}}
    )
    assert simulated == {
        "pendulum": "the simulated rig's own",
        "light lever": "stated",
        "sensor's noise": "the simulated rig's own",
    }
    assert settings_of({"camera": {"driver": "usb3vision"}})["sensor's noise"].startswith("not stated")


def test_a_trip_and_a_laser_that_was_left_lit_are_named() -> None:
    state = SafetyState()
    assert check_trip(state, "mine.toml").ok
    state.lit(True)
    assert "that had lit the laser was killed" in check_trip(state, "mine.toml").reason
    state.latch(TripCause.INTERLOCK, "the interlock of the laser opened", lit=True)
    found = check_trip(state, "mine.toml")
    assert (found.ok, found.reason) == (False, "trip 1 (INTERLOCK): the interlock of the laser opened")
    assert "rig light acknowledge mine.toml 1" in found.remedy
