"""The simulated camera: conformance suite, reproducibility, real time, faults."""

import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, FrameTimeout, PixelFormat
from acquisition.cameras.drivers import make_camera
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from processing.errors import ConfigurationError, DeviceError
from tests.acquisition.cameras.conformance import CameraConformance, Unplug

SMALL: dict[str, Any] = {"sensor": {"width_px": 96, "height_px": 64}, "release": {"amplitude_arcsec": 5.0}}


def simulated(faults: FaultSettings | None = None, **settings: Any) -> SimulatedCamera:
    return SimulatedCamera(SimulationSettings.model_validate({**SMALL, **settings}), faults)


class TestSimulatedConformance(CameraConformance):
    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8", "mono10", "mono12", "mono16")
    APPLIES: ClassVar[dict[str, float]] = {"exposure_us": 50.0, "gain_db": 6.0, "frame_rate_hz": 200.0}

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = simulated()
        yield camera
        camera.close()

    @pytest.fixture
    def blocked_camera(self) -> Iterator[Camera]:
        camera = simulated(clock={"frame_rate_hz": 0.1}, real_time=True)
        yield camera
        camera.close()

    @pytest.fixture
    def unplugged(self) -> Iterator[tuple[Camera, Unplug]]:
        camera = simulated(FaultSettings(camera_unplugged_at_s=0.05))
        yield camera, lambda: None
        camera.close()


class TestSimulatedInRealTime(TestSimulatedConformance):
    SKIPS_WHEN_SLOW: ClassVar[bool] = True

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = simulated(real_time=True, clock={"frame_rate_hz": 400.0}, buffer_frames=8)
        yield camera
        camera.close()


def running(camera: SimulatedCamera, settings: CameraSettings | None = None) -> SimulatedCamera:
    camera.open()
    camera.configure(settings or CameraSettings())
    camera.start()
    return camera


def take(camera: SimulatedCamera, count: int) -> list[Frame]:
    frames = [camera.read(1.0) for _ in range(count)]
    assert all(frame is not None for frame in frames)
    return [frame for frame in frames if frame is not None]


NOISY: dict[str, Any] = {
    "optics": {"power_noise": 0.01, "ghost_relative": 0.02, "sigma_x_px": 5.0, "rotation_rad": 0.4},
    "sensor": {"width_px": 96, "height_px": 64, "prnu": 0.01, "hot_pixels": 20},
    "clock": {"jitter_s": 1e-4},
    "disturbances": {
        "pointing_jitter_px": 0.05,
        "pointing_walk_px_per_sqrt_s": 0.1,
        "dropped_fraction": 0.1,
    },
}


def test_same_seed_same_bytes_however_it_is_read() -> None:
    first = take(running(simulated(seed=5, **NOISY)), 100)
    slow = running(simulated(seed=5, **NOISY))
    second = []
    for i in range(100):
        second += take(slow, 1)
        if i % 40 == 0:
            time.sleep(0.01)
    identity = [
        [(frame.image.tobytes(), frame.sequence, frame.device_time_ns) for frame in frames]
        for frames in (first, second)
    ]
    assert identity[0] == identity[1]


def test_frames_do_not_depend_on_the_pace() -> None:
    on_demand = take(running(simulated(seed=5, clock={"frame_rate_hz": 1000.0})), 50)
    paced = take(running(simulated(seed=5, clock={"frame_rate_hz": 1000.0}, real_time=True)), 50)
    by_number = {frame.sequence: frame.image.tobytes() for frame in on_demand}
    seen = [frame for frame in paced if frame.sequence in by_number]
    assert seen
    assert all(frame.image.tobytes() == by_number[frame.sequence] for frame in seen)


def test_other_seeds_and_further_runs_have_other_noise_and_first_run_begins_with_a_further_one() -> None:
    camera = running(simulated(seed=5))
    first = take(camera, 3)[-1]
    camera.stop()
    camera.start()
    second = take(camera, 3)[-1]
    begun_there = take(running(simulated(seed=5, first_run=1)), 3)[-1]
    assert not np.array_equal(first.image, second.image)
    assert not np.array_equal(first.image, take(running(simulated(seed=6)), 3)[-1].image)
    assert np.array_equal(second.image, begun_there.image)
    assert second.device_time_ns == begun_there.device_time_ns


def test_run_ends_at_its_duration_and_never_drops_on_demand() -> None:
    camera = running(simulated(max_duration_s=1.0, clock={"frame_rate_hz": 100.0}))
    take(camera, 100)
    assert camera.read(1.0) is None
    assert camera.status.delivered == 100
    assert camera.status.dropped == 0


def test_dropped_frames_are_gaps_and_counted() -> None:
    camera = running(simulated(disturbances={"dropped_fraction": 0.2}, max_duration_s=20.0))
    delivered = len(list(iter(lambda: camera.read(1.0), None)))
    dropped = camera.status.dropped_by_camera
    assert dropped == 2000 - delivered
    # binomial: 400 of 2000, four standard deviations
    assert abs(dropped - 400) < 4 * np.sqrt(2000 * 0.2 * 0.8)


def test_clock_has_its_rate_start_and_jitter() -> None:
    clock = {"frame_rate_hz": 100.0, "start_s": 7.0, "drift_ppm": 100.0, "jitter_s": 2e-4}
    frames = take(running(simulated(clock=clock)), 2000)
    error_s = np.array([f.device_time_ns for f in frames]) * 1e-9 - 7.0 - np.arange(2000) * 0.01 * 1.0001
    assert abs(error_s.mean()) < 4 * 2e-4 / np.sqrt(2000)
    assert error_s.std() == pytest.approx(2e-4, rel=4 / np.sqrt(2 * 2000))


def test_brightness_follows_exposure_and_gain() -> None:
    # 12 bit: at 8 bit the read noise is too small to smooth the rounding of the spot's faint rim
    def light_e(**settings: float) -> float:
        frames = take(running(simulated(), CameraSettings(pixel_format="mono12", **settings)), 30)
        dark_dn = 6.0 * 4095 / 255
        sums_dn = [frame.image.sum(dtype=np.int64) - dark_dn * frame.image.size for frame in frames]
        return float(np.mean(sums_dn)) * 39.2 * 255 / 4095

    stated_e = 174.0 * 39.2 * 2 * np.pi * 6.0**2
    # shot noise and 6,144 pixels of 7 e-; the rim cut off by the small sensor is 1.2e-4
    tolerance_e = 4 * np.sqrt((stated_e + 6144 * 7.1**2) / 30) + 2e-4 * stated_e
    assert light_e() == pytest.approx(stated_e, abs=tolerance_e)
    assert light_e(exposure_us=50.0) == pytest.approx(stated_e / 2, abs=tolerance_e)
    assert light_e(exposure_us=25.0, gain_db=20 * np.log10(4)) == pytest.approx(stated_e, abs=4 * tolerance_e)


def test_slow_reader_in_real_time_loses_the_oldest_and_knows_it() -> None:
    camera = running(simulated(real_time=True, clock={"frame_rate_hz": 1000.0}, buffer_frames=10))
    take(camera, 1)
    time.sleep(0.2)
    frame = take(camera, 1)[0]
    assert frame.sequence >= 150
    assert camera.status.dropped_by_host == frame.sequence - 1


def test_unplugged_camera_is_lost_and_goes_on_with_the_run_when_it_is_back() -> None:
    faults = FaultSettings(camera_unplugged_at_s=0.5, camera_replugged_at_s=2.0)
    camera = running(simulated(faults))
    last = take(camera, 50)[-1]
    for _ in range(2):
        with pytest.raises(CameraLost, match="unplugged"):
            camera.read(1.0)
    camera.close()
    running(camera)
    first = take(camera, 1)[0]
    assert first.sequence == 0
    assert first.device_time_ns - last.device_time_ns == pytest.approx(1.51e9, abs=1)
    assert camera.status.reconnects == 1


def test_camera_that_stays_unplugged_cannot_be_opened() -> None:
    camera = running(simulated(FaultSettings(camera_unplugged_at_s=0.0)))
    with pytest.raises(CameraLost):
        camera.read(1.0)
    with pytest.raises(DeviceError, match="unplugged"):
        camera.open()


def test_stall_times_out_then_leaves_a_counted_gap() -> None:
    faults = FaultSettings(frames_stalled_at_s=0.1, frames_stalled_duration_s=2.0)
    camera = running(simulated(faults))
    assert take(camera, 10)[-1].sequence == 9
    with pytest.raises(FrameTimeout):
        camera.read(1.5)
    assert take(camera, 1)[0].sequence == 210
    assert camera.status.dropped_by_camera == 200


def test_laser_fades_and_comes_back() -> None:
    faults = FaultSettings(laser_fades_at_s=1.0, laser_fade_duration_s=2.0)
    frames = take(running(simulated(faults)), 400)
    brightest = np.array([frame.image.max() for frame in frames])
    assert brightest[:100].min() > 150
    assert brightest[151:249].max() < 10
    assert brightest[301:].min() > 150


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (CameraSettings(width_px=97), "96"),
        (CameraSettings(height_px=64, offset_y_px=1), "64"),
        (CameraSettings(gain_db=60.0), "48"),
        (CameraSettings(frame_rate_hz=1e6), "100000"),
        (CameraSettings(exposure_us=20_000.0, frame_rate_hz=100.0), "at most 10000 fit"),
    ],
)
def test_settings_out_of_range_name_the_range(settings: CameraSettings, named: str) -> None:
    camera = simulated()
    camera.open()
    with pytest.raises(DeviceError, match=named):
        camera.configure(settings)


def test_drivers_are_found_by_name_and_their_settings_checked() -> None:
    camera = make_camera("simulated", SimulationSettings(), FaultSettings())
    assert camera.open().driver == "simulated"
    with pytest.raises(ConfigurationError, match=r"there are .*files, .*simulated"):
        make_camera("simulted", SimulationSettings())
    with pytest.raises(ConfigurationError, match="SimulationSettings"):
        make_camera("simulated", FaultSettings())


KERNELS_OF_AN_OPENED = """
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation import sensor
from acquisition.simulation.settings import SimulationSettings

SimulatedCamera(SimulationSettings.model_validate({"real_time": True})).open()
print(len(sensor.expose_frames.signatures))
"""


@pytest.mark.slow
def test_a_live_camera_is_opened_with_its_kernels_compiled_because_then_it_is_dark() -> None:
    told = subprocess.run(
        [sys.executable, "-c", KERNELS_OF_AN_OPENED], capture_output=True, text=True, check=True
    )
    assert told.stdout == "1\n"
