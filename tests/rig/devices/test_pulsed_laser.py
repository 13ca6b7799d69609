"""A laser that is pulsed with the exposures, from the configuration to the simulated image."""

import pytest

from rig.devices.session_devices import Devices
from rig.settings import validate_configuration

PEAK_DN, BLACK_DN = 160.0, 6.0


def test_the_light_of_the_pulse_is_in_the_image_and_its_time_in_the_timestamp() -> None:
    config = validate_configuration(
        {
            "camera": {"driver": "simulated", "exposure_us": 100.0, "frame_rate_hz": 100.0},
            "controller": {"kind": "simulated"},
            "laser": {
                "kind": "controller",
                "power_w": 1e-3,
                "max_power_w": 1e-3,
                "pulse_us": 25.0,
                "pulse_delay_us": 50.0,
            },
            "simulation": {
                "real_time": True,
                "sensor": {"width_px": 64, "height_px": 64, "black_level_dn": BLACK_DN},
                "optics": {"peak_dn": PEAK_DN, "laser_w": 1e-3},
                "release": {"way": "by command"},
            },
        },
        "test",
    )
    with Devices(config) as devices, devices.camera(config) as opened:
        assert opened.time_shift_ns == 12_500
        assert opened.notes == ()
        opened.camera.start()
        assert opened.camera.read(5.0) is not None
        assert devices.light() == "laser on, 1 mW, 25 µs in each exposure"
        peaks = []
        while not peaks or peaks[-1] < BLACK_DN + 20.0:
            frame = opened.camera.read(5.0)
            assert frame is not None
            peaks.append(float(frame.image.max()))
        assert peaks[-1] == pytest.approx(BLACK_DN + 0.25 * PEAK_DN, abs=8.0)
