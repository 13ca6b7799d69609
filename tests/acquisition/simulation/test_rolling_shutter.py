"""The simulated rolling shutter: each row sees the spot at its own time, also in a region of interest."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from acquisition.camera import CameraSettings
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.motion import motions
from acquisition.simulation.optics import sheared_beams, spot_position_px
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import OpticsTruth, SensorTruth, SimulationSettings
from acquisition.simulation.true_path import axes_motion
from processing.errors import ConfigurationError
from rig.instrument import complete
from rig.settings import Configuration

ROWS, TOP = 300, 120


def settings_of(row_time_s: float, first_row: str = "top") -> SimulationSettings:
    # noise-free: many electrons, no read noise, 16 bit
    sensor = SensorTruth.model_validate(
        {"width_px": 120, "height_px": 640, "row_time_s": row_time_s, "first_row": first_row, "bit_depth": 16}
        | {"read_noise_e": 0.0, "gain_e_per_dn": 1e5, "full_well_e": 1e12, "black_level_dn": 0.0}
    )
    return SimulationSettings(sensor=sensor, optics=OpticsTruth(peak_dn=40000.0))


def view(
    settings: SimulationSettings, x: int, y: int, nx: int, ny: int, rate_hz: float = 100.0, binning: int = 1
) -> Scene:
    readings = SensorSettings(x, y, nx, ny, 16, 100.0, 0.0, rate_hz, binning)
    return Scene(settings, FaultSettings(), readings, 0)


def integrated(pixel: np.ndarray, centre_px: np.ndarray, sigma_px: float) -> np.ndarray:
    """A Gaussian of unit height over each pixel."""
    upper, lower = (ndtr((np.asarray(pixel) + edge - centre_px) / sigma_px) for edge in (0.5, -0.5))
    return sigma_px * math.sqrt(2 * math.pi) * (upper - lower)


@pytest.mark.parametrize("first_row", ["top", "bottom"])
def test_every_row_sees_the_spot_at_its_own_time(first_row: str) -> None:
    settings = settings_of(30e-6, first_row)
    scene = view(settings, 0, TOP, 120, ROWS)
    plan = scene.plan(121)
    fast, slow = motions(settings, 0)
    rows = np.arange(ROWS)
    order = rows if first_row == "top" else ROWS - 1 - rows
    for frame in (60, 100, 120):
        row_times_s = frame / 100.0 + 30e-6 * rows
        tilts = axes_motion(settings, fast, slow, row_times_s)
        x_px, y_px = spot_position_px(*tilts, row_times_s, settings.axes, settings.optics, settings.sensor)
        x_px, y_px = x_px[order], y_px[order] - TOP
        (image,) = scene.draw(plan, slice(frame, frame + 1)).astype(float)
        sigma = settings.optics.sigma_x_px
        down = integrated(rows, y_px, sigma)
        across = integrated(np.arange(120)[None, :], x_px[:, None], sigma)
        expected = 40000.0 * down[:, None] * across
        assert np.abs(image - expected).max() < 2e-4 * 40000.0
        weight = image / image.sum()
        assert plan.y_px[frame] - TOP == pytest.approx((weight.sum(1) * rows).sum(), abs=2e-3)


@pytest.mark.parametrize("first_row", ["top", "bottom"])
def test_a_region_of_one_row_is_exposed_at_one_time(first_row: str) -> None:
    rolling, still = (
        view(settings_of(row_time_s, first_row), 0, 330, 120, 1).plan(50) for row_time_s in (30e-6, 0.0)
    )
    assert rolling.y_px == pytest.approx(still.y_px, abs=1e-9)
    assert rolling.slope == pytest.approx(still.slope, abs=1e-9)
    assert not still.slope.any()


def test_a_ghost_lies_where_it_is_when_its_own_rows_are_exposed() -> None:
    slope = np.array([[0.2, 0.1], [0.0, 0.0]])
    _, ghost_px = sheared_beams(OpticsTruth(ghost_dx_px=40.0, ghost_dy_px=30.0), slope)
    assert ghost_px == pytest.approx([40.0, 30.0] + slope * ghost_px[:, 1:])


@pytest.mark.parametrize("row_time_s", [0.0, 30e-6])
def test_a_binned_image_is_the_mean_of_the_sensors_pixels(row_time_s: float) -> None:
    """In a region, too, and with each row of the sensor at its own time."""
    settings = settings_of(row_time_s)
    whole = view(settings, 0, 0, 120, 402, 50.0)
    part = view(settings, 10, 30, 20, 100, 50.0, binning=3)
    plan = whole.plan(200)
    frame = int(np.argmin(np.abs(plan.y_px - 240.0)))
    (image,) = whole.draw(plan, slice(frame, frame + 1)).astype(float)
    (seen,) = part.draw(plan, slice(frame, frame + 1)).astype(float)
    expected = image[90:390, 30:90].reshape(100, 3, 20, 3).mean(axis=(1, 3))
    assert expected.max() > 20000.0
    assert np.abs(seen - expected).max() < 1e-3 * 40000.0


@pytest.mark.parametrize("binning", [2, 3])
def test_rows_of_a_binned_image_are_later_by_as_many_row_times(binning: int) -> None:
    """The time that is right for the rows of the image is that at which the spot was there."""
    settings = settings_of(20e-6)
    rows = 640 // binning
    scene = view(settings, 0, 0, 40, rows, 50.0, binning)
    plan = scene.plan(200)
    frames = range(40, 200, 40)
    images = [scene.draw(plan, slice(n, n + 1))[0].astype(float) for n in frames]
    seen_px = np.array([(image.sum(1) @ np.arange(rows)) / image.sum() for image in images])
    config = complete(
        Configuration.model_validate(
            {
                "simulation": settings.model_dump(),
                "camera": {"driver": "simulated", "binning": binning, "frame_rate_hz": 50.0},
            }
        )
    )
    assert config.shutter is not None
    assert config.lever is not None
    # the first row of the image is the mean of so many rows of the sensor
    first_s = 0.5 * (binning - 1) * 20e-6
    times_s = np.array(frames) / 50.0 + first_s + seen_px * config.shutter.row_time_s
    fast, slow = motions(settings, 0)
    tilts = axes_motion(settings, fast, slow, times_s)
    _, y_px = spot_position_px(*tilts, times_s, settings.axes, settings.optics, settings.sensor)
    assert seen_px == pytest.approx((y_px + 0.5) / binning - 0.5, abs=3e-3)
    tilt_rad = config.lever.tilt_rad(0.5 * (640 / binning - 1) - seen_px)
    assert tilt_rad == pytest.approx(tilts[1], abs=3e-3 * binning * 4.8e-6)


def test_a_readout_longer_than_a_frame_is_refused() -> None:
    camera = SimulatedCamera(settings_of(30e-6))
    camera.open()
    with pytest.raises(ConfigurationError, match=r"640 rows take 0\.01917 s, more than a frame at 100 Hz"):
        camera.start()
    camera.configure(CameraSettings(height_px=300, frame_rate_hz=100.0))
    camera.start()
    assert camera.read(1.0) is not None
    camera.close()
