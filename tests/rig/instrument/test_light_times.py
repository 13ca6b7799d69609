"""The time of a frame is that of its light: the middle of the exposure, or of the laser's pulse."""

from typing import Any

import pytest

from acquisition.camera import CameraInfo, CameraSettings, TimestampMoment
from rig.instrument import pulse_faults, shift_to_light_ns, shutter_of
from rig.settings import Configuration, validate_configuration

APPLIED = CameraSettings(exposure_us=8000.0, width_px=640, height_px=401)


def camera(stamped: TimestampMoment = "start", has_clock: bool = True) -> CameraInfo:
    return CameraInfo("any", "", "", "", 640, 480, 255, has_clock=has_clock, stamped=stamped)


def configured(**laser: Any) -> Configuration:
    return validate_configuration(
        {
            "camera": {"driver": "usb3vision"},
            "laser": {"kind": "controller", "power_w": 1e-4, **laser},
            "controller": {"kind": "serial", "port": "x"},
            "shutter": {"row_time_s": 1e-5},
        },
        "test",
    )


@pytest.mark.parametrize(("stamped", "expected_us"), [("start", 4000), ("middle", 0), ("end", -8000)])
def test_without_pulses_it_is_the_middle_of_the_first_row(stamped: TimestampMoment, expected_us: int) -> None:
    config = configured()
    assert shift_to_light_ns(config, camera(stamped), APPLIED) == 1000 * expected_us
    assert shutter_of(config).row_time_s == 1e-5


@pytest.mark.parametrize(("stamped", "expected_us"), [("start", 5025), ("middle", 1025), ("end", -6975)])
def test_with_pulses_it_is_their_middle_for_all_rows(stamped: TimestampMoment, expected_us: int) -> None:
    config = configured(pulse_us=50.0, pulse_delay_us=5000.0)
    assert shift_to_light_ns(config, camera(stamped), APPLIED) == 1000 * expected_us
    assert shutter_of(config).row_time_s == 0.0
    assert pulse_faults(config, camera(stamped), APPLIED) == []


def test_where_nothing_is_known_nothing_is_added() -> None:
    unknown = APPLIED.model_copy(update={"exposure_us": None})
    pulsed = configured(pulse_us=50.0, pulse_delay_us=5000.0)
    assert shift_to_light_ns(configured(), camera(), unknown) == 0
    assert shift_to_light_ns(pulsed, camera("end"), unknown) == 0
    assert shift_to_light_ns(pulsed, camera("start"), unknown) == 5_025_000
    assert shift_to_light_ns(pulsed, camera(has_clock=False), APPLIED) == 0


def test_pulses_outside_the_exposure_of_any_row_are_said() -> None:
    early = configured(pulse_us=50.0, pulse_delay_us=3900.0)
    assert pulse_faults(early, camera(), APPLIED) == [
        "laser.pulse_delay_us = 3900: the last row is exposed from 4000 µs on"
    ]
    late = configured(pulse_us=50.0, pulse_delay_us=7990.0)
    assert pulse_faults(late, camera(), APPLIED) == [
        "laser.pulse_us: the pulse ends 8040 µs after the exposure begins, which takes 8000 µs"
    ]
    assert pulse_faults(configured(), camera(), APPLIED) == []
