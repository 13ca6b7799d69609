"""What `rig doctor` says of frames, and of what the configuration holds."""

import pytest

from acquisition.camera import CameraStatus
from rig.control import SafetyState, TripCause
from rig.devices.doctor import check_frames, check_governor, check_settings, check_trip
from rig.instrument import complete
from rig.settings import validate_configuration

ALL = CameraStatus(delivered=60)


def arrivals(rate_hz: float, count: int = 60) -> list[tuple[int, int]]:
    """Numbers and times of frames that come at this rate."""
    return [(number, round(1e9 * number / rate_hz)) for number in range(count)]


@pytest.mark.parametrize(
    ("came", "status", "asked_hz", "on_demand", "ok", "said"),
    [
        (arrivals(99.0), ALL, 100.0, False, True, "60 at 99 frames/s, lost: none"),
        (arrivals(50.0), ALL, 100.0, False, False, "; 100 were requested; exposure too long"),
        (arrivals(6000.0), ALL, 100.0, False, False, "rig camera show"),
        (arrivals(50.0), ALL, None, False, True, "60 at 50 frames/s"),
        (arrivals(6000.0), ALL, 100.0, True, True, "60, made on demand: no rate to judge, lost: none"),
        ([], CameraStatus(), 100.0, False, False, "0 at 0 frames/s"),
        (arrivals(100.0), CameraStatus(delivered=60, dropped_by_bus=3), 100.0, False, False, "another port"),
    ],
)
def test_frames_are_judged_by_their_number_and_the_rate_that_was_asked_for(
    came: list[tuple[int, int]],
    status: CameraStatus,
    asked_hz: float | None,
    on_demand: bool,
    ok: bool,
    said: str,
) -> None:
    verdict = check_frames(came, status, asked_hz, on_demand=on_demand)
    assert verdict.ok is ok
    assert said in f"{verdict.reason}; {verdict.remedy}"


def settings_of(tree: dict[str, dict[str, object]]) -> dict[str, str]:
    stated = validate_configuration(tree, "a test")
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
    state.note_light(True)
    assert "that had lit the laser was killed" in check_trip(state, "mine.toml").reason
    state.latch(TripCause.INTERLOCK, "the interlock of the laser opened", lit=True)
    found = check_trip(state, "mine.toml")
    assert (found.ok, found.reason) == (False, "trip 1 (INTERLOCK): the interlock of the laser opened")
    assert "rig light acknowledge mine.toml 1" in found.remedy


@pytest.mark.parametrize(
    ("governor", "driver", "ok"),
    [
        ("powersave", "acpi-cpufreq", False),
        ("powersave", "intel_pstate", True),
        ("powersave", "amd-pstate-epp", True),
        ("conservative", "intel_cpufreq", False),
        ("schedutil", "acpi-cpufreq", True),
    ],
)
def test_a_governor_that_keeps_the_processor_slow_is_a_fault(governor: str, driver: str, ok: bool) -> None:
    """With drivers that have governors of their own, powersave is the dynamic one that laptops come with."""
    verdict = check_governor(governor, driver, 4)
    assert (verdict.ok, governor in verdict.line) == (ok, True)
