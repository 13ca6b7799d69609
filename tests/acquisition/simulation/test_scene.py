"""Position of the simulated spot: axes, lever, imbalance, drift, jitter, faults; messages of the settings."""

import math
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from acquisition.simulation.inputs import FaultSettings, RigInputs
from acquisition.simulation.scene import PlannedFrames, Scene, SensorSettings
from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points

SIXTY = {"frame_rate_hz": 60.0}
ONE_ARCSEC_PX = 1.0 * 2 * ARCSEC_RAD / 4.8e-6


def scene(faults: dict[str, Any] | None = None, run: int = 0, **changes: Any) -> Scene:
    settings = SimulationSettings.model_validate(changes)
    readings = SensorSettings(
        0, 0, settings.sensor.width_px, settings.sensor.height_px, 8, 100.0, 0.0, settings.clock.frame_rate_hz
    )
    return Scene(settings, FaultSettings.model_validate(faults or {}), readings, run)


def plan(count: int, faults: dict[str, Any] | None = None, **changes: Any) -> PlannedFrames:
    """Frames of a pendulum without fast mode and leakage, unless they are asked for."""
    changes["fast"] = {"amplitude_arcsec": 0.0, **changes.get("fast", {})}
    changes["axes"] = {"leakage": 0.0, **changes.get("axes", {})}
    return scene(faults, **changes).plan(count)


def test_demonstration_is_what_it_is_said_to_be() -> None:
    settings = SimulationSettings()
    first = plan(1)
    # 124 arcsec is 250 px on the long axis, upward on a sensor whose y runs down
    assert first.y_px[0] == pytest.approx(319.5 - 250.5, abs=0.1)
    assert first.x_px[0] == pytest.approx(159.5)
    state = settings.sensor.at(8)
    assert settings.optics.peak_dn + state.black_level_dn == 180.0
    assert state.full_scale_dn * state.gain_e_per_dn == pytest.approx(10_000, rel=1e-3)
    end_s = true_turning_points(settings).time_s[-1]
    assert end_s * settings.clock.frame_rate_hz == pytest.approx(118_000, rel=0.01)


def test_every_setting_says_its_unit_or_what_it_is() -> None:
    def bare(model: type[BaseModel]) -> list[str]:
        ends = "s rad px m kg e dn pa arcsec us hz ppm min s2"
        units = tuple(f"_{end}" for end in ends.split())
        found = []
        for name, field in model.model_fields.items():
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
                found += bare(field.annotation)
            elif field.description is None and not name.endswith(units):
                found.append(f"{model.__name__}.{name}")
        return found

    without_unit = {
        "ContactTruth.ball_poisson_ratio",
        "ContactTruth.flat_poisson_ratio",
        "AxesTruth.mirrored",
        "SensorTruth.bit_depth",
    }
    assert set(bare(SimulationSettings)) | set(bare(FaultSettings)) == without_unit


def test_unknown_key_and_jitter_beyond_a_frame_are_refused() -> None:
    with pytest.raises(ValidationError, match="slow_angel"):
        SimulationSettings.model_validate({"axes": {"slow_angel": 1.0}})
    with pytest.raises(ValidationError, match="jitter_s"):
        SimulationSettings.model_validate({"clock": {"jitter_s": 0.01}})


def test_spot_moves_by_the_tangent_of_twice_the_tilt() -> None:
    wide = {
        "release": {"amplitude_arcsec": 10_000.0},
        "sensor": {"height_px": 8192},
        "contact": {"gamma_pa": 0.0},
    }
    first = plan(1, **wide)
    tilt_rad = 10_000.0 * ARCSEC_RAD
    assert 4095.5 - first.y_px[0] == pytest.approx(math.tan(2 * tilt_rad) / 4.8e-6, rel=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 0.2, -1.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_axes_lie_on_the_sensor_as_stated(angle_rad: float, mirrored: bool) -> None:
    axes = {"slow_angle_rad": angle_rad, "non_orthogonality_rad": 0.1, "mirrored": mirrored}
    slow = plan(1, axes=axes)
    dx, dy = slow.x_px[0] - 159.5, slow.y_px[0] - 319.5
    # from the upward vertical (negative y) towards +x
    assert math.atan2(dx, -dy) == pytest.approx(angle_rad, abs=1e-12)
    assert math.hypot(dx, dy) == pytest.approx(124 * ONE_ARCSEC_PX, rel=1e-6)
    fast = plan(1, axes=axes, fast={"amplitude_arcsec": 20.0})
    dx, dy = fast.x_px[0] - slow.x_px[0], fast.y_px[0] - slow.y_px[0]
    if mirrored:
        dx, dy = -dx, -dy
    assert math.atan2(dx, -dy) == pytest.approx(angle_rad + math.pi / 2 + 0.1, abs=1e-12)
    assert math.hypot(dx, dy) == pytest.approx(20 * ONE_ARCSEC_PX, rel=1e-6)


def test_imbalance_leaks_the_slow_mode_into_x() -> None:
    plain = plan(2000)
    line = plan(2000, axes={"leakage": 0.05})
    ellipse = plan(2000, axes={"leakage_quadrature": 0.05})
    slow_px = 319.5 - plain.y_px
    assert line.x_px - 159.5 == pytest.approx(0.05 * slow_px, abs=1e-4)
    assert np.array_equal(line.y_px, plain.y_px)
    # a quarter period apart: no correlation, the same size
    side_px = ellipse.x_px[:1221] - 159.5
    assert abs(np.corrcoef(side_px, slow_px[:1221])[0, 1]) < 0.02
    assert side_px.std() == pytest.approx(0.05 * slow_px[:1221].std(), rel=0.05)


def test_rest_position_its_drift_spin_and_pointing_drift() -> None:
    plain = plan(6001)
    moved = plan(
        6001,
        axes={"rest_slow_arcsec": 3.0, "rest_drift_fast_arcsec_per_min": 2.0},
        disturbances={"pointing_drift_y_px_per_min": 5.0},
    )
    assert plain.y_px[0] - moved.y_px[0] == pytest.approx(3 * ONE_ARCSEC_PX, rel=1e-5)
    assert moved.x_px[-1] - plain.x_px[-1] == pytest.approx(2 * ONE_ARCSEC_PX, rel=1e-5)
    assert (moved.y_px - plain.y_px)[-1] == pytest.approx(5.0 - 3 * ONE_ARCSEC_PX, rel=1e-4)
    spun = plan(6001, axes={"spin_rad_per_s": 1e-3})
    angle = np.arctan2(spun.x_px - 159.5, 319.5 - spun.y_px)[-1]
    assert math.remainder(angle - 1e-3 * 60.0, math.pi) == pytest.approx(0.0, abs=1e-9)


def test_pointing_jitter_and_walk_have_their_sizes() -> None:
    plain = plan(20_000)
    jitter = plan(20_000, disturbances={"pointing_jitter_px": 0.3})
    for noise in (jitter.x_px - plain.x_px, jitter.y_px - plain.y_px):
        assert noise.std() == pytest.approx(0.3, rel=4 / math.sqrt(2 * 20_000))
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / math.sqrt(20_000)
    walk = plan(20_000, disturbances={"pointing_walk_px_per_sqrt_s": 0.5})
    for path in (walk.x_px - plain.x_px, walk.y_px - plain.y_px):
        assert np.diff(path).std() == pytest.approx(0.05, rel=4 / math.sqrt(2 * 20_000))


def test_air_has_its_level_and_a_spectrum_of_one_over_f() -> None:
    """0.1 arcsec between 0.01 and 10 Hz, a factor of 1000: an equal part of the variance in each decade."""
    count = 400_000
    air = {"air_arcsec": 0.1}
    plain, blown = plan(count, clock=SIXTY), plan(count, clock=SIXTY, disturbances=air)
    for noise in (blown.x_px - plain.x_px, blown.y_px - plain.y_px):
        noise_arcsec = noise / ONE_ARCSEC_PX
        frequencies_hz, density = scipy.signal.welch(noise_arcsec, 60.0, nperseg=2**15)
        step_hz = frequencies_hz[1]
        # 12, 120 and 1200 s^-1 hold as many independent numbers per two of a bin's segments
        for low_hz, high_hz, bound in ((0.01, 0.1, 0.25), (0.1, 1.0, 0.1), (1.0, 10.0, 0.05)):
            decade = (frequencies_hz >= low_hz) & (frequencies_hz < high_hz)
            assert density[decade].sum() * step_hz == pytest.approx(0.1**2 / 3, rel=bound)
        assert density[frequencies_hz > 12.6].sum() * step_hz < 1e-5 * 0.1**2
    other = scene(run=1, clock=SIXTY, disturbances=air).plan(100)
    assert not np.allclose(other.x_px, scene(clock=SIXTY, disturbances=air).plan(100).x_px, atol=1e-6)
    # the same air at another frame rate
    slower = plan(100, clock={"frame_rate_hz": 30.0}, disturbances=air).y_px
    assert slower == pytest.approx(blown.y_px[:200:2], abs=1e-9)


def test_microphonics_are_lines_of_their_frequencies() -> None:
    plain = plan(6000, clock=SIXTY)
    lines = [{"frequency_hz": 11.0, "amplitude_px": 0.03}, {"frequency_hz": 23.5, "amplitude_px": 0.01}]
    shaken = plan(6000, clock=SIXTY, disturbances={"microphonics": lines})
    for noise in (shaken.x_px - plain.x_px, shaken.y_px - plain.y_px):
        amplitudes = 2 * np.abs(np.fft.rfft(noise)) / 6000
        assert np.flatnonzero(amplitudes > 1e-6).tolist() == [1100, 2350]
        assert amplitudes[[1100, 2350]] == pytest.approx([0.03, 0.01])
    first = plan(6000, clock=SIXTY, disturbances={"microphonics": lines[:1]})
    second = shaken.x_px - first.x_px
    assert second.std() == pytest.approx(0.01 / math.sqrt(2), rel=1e-3)


def test_air_without_a_band_is_refused() -> None:
    for change in ({"air_from_hz": 20.0}, {"air_from_hz": 1e-3}):
        with pytest.raises(ValidationError, match="air_from_hz"):
            SimulationSettings.model_validate({"disturbances": change})


def test_plans_do_not_depend_on_their_length() -> None:
    changes: dict[str, Any] = {
        "ground": {"model": "peterson"},
        "disturbances": {
            "air_arcsec": 0.1,
            "microphonics": [{"frequency_hz": 7.0, "amplitude_px": 0.1}],
            "pointing_jitter_px": 0.1,
            "pointing_walk_px_per_sqrt_s": 0.1,
            "dropped_fraction": 0.3,
        },
        "clock": {"jitter_s": 1e-4},
        "optics": {"power_noise": 0.01},
    }
    whole = scene(**changes).plan(300)
    parts = scene(**changes)
    pieces = [parts.plan(count) for count in (1, 7, 200, 92)]
    for name in PlannedFrames._fields[1:]:
        assert np.array_equal(np.concatenate([getattr(p, name) for p in pieces]), getattr(whole, name)), name


def test_ghost_lies_where_it_is_said_to() -> None:
    sharp = {"optics": {"sigma_x_px": 3.0, "sigma_y_px": 3.0, "ghost_relative": 0.5, "ghost_dx_px": 40.0}}
    view = scene(**sharp)
    place = view.plan(1)._replace(x_px=np.array([100.0]), y_px=np.array([300.0]))
    (image,) = view.draw(place, slice(0, 1)).astype(float)
    assert image[300, 100] == pytest.approx(180, abs=8)
    assert image[300, 140] == pytest.approx(93, abs=6)
    assert image[300, 120] < 10


def test_vibration_is_a_burst_of_both_axes() -> None:
    plain = plan(1000)
    shaken = plan(1000, {"vibration_burst_at_s": 2.0, "vibration_burst_duration_s": 3.0})
    for shake in (shaken.x_px - plain.x_px, plain.y_px - shaken.y_px):
        assert np.abs(shake[:200]).max() < 1e-9
        assert np.abs(shake[501:]).max() < 1e-9
        assert np.abs(shake).max() == pytest.approx(2 * ONE_ARCSEC_PX, rel=0.05)


def test_draught_pushes_the_pendulum_which_swings_on() -> None:
    quiet: dict[str, Any] = {"release": {"amplitude_arcsec": 1e-6}}
    pushed = plan(3000, {"draught_at_s": 1.0, "draught_arcsec": 3.0}, **quiet)
    tilt_px = 319.5 - pushed.y_px
    assert np.abs(tilt_px[:100]).max() < 1e-3
    assert tilt_px[100:500].max() == pytest.approx(3 * ONE_ARCSEC_PX, rel=0.05)
    assert np.abs(tilt_px[2000:]).max() > ONE_ARCSEC_PX
    assert np.abs(pushed.x_px[:100] - 159.5).max() < 1e-3
    assert np.abs(pushed.x_px[100:] - 159.5).max() == pytest.approx(3 * ONE_ARCSEC_PX, rel=0.05)


def centre_of_light(image: NDArray[Any], black_level_dn: float) -> tuple[float, float]:
    light = image.astype(float) - black_level_dn
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return float((light * x).sum() / light.sum()), float((light * y).sum() / light.sum())


def test_images_agree_with_the_plan_and_the_trajectory() -> None:
    small = {
        "sensor": {"width_px": 64, "height_px": 128, "bit_depth": 12},
        "release": {"amplitude_arcsec": 20.0},
    }
    changes: dict[str, Any] = {**small, "optics": {"peak_dn": 2500.0}}
    settings = SimulationSettings.model_validate(changes)
    readings = SensorSettings(0, 0, 64, 128, 12, 100.0, 0.0, 100.0)
    view = Scene(settings, FaultSettings(), readings, 0)
    frames = view.plan(150)
    truth = true_path(settings, 1.49)
    assert 63.5 - frames.y_px == pytest.approx(np.tan(2 * truth.y_rad) / 4.8e-6, abs=1e-9)
    for row in range(0, 150, 15):
        (image,) = view.draw(frames, slice(row, row + 1))
        x_px, y_px = centre_of_light(image, 6.0)
        # centroid of all light over 8,192 pixels: black level noise over the whole frame sets 0.15 px
        assert x_px == pytest.approx(frames.x_px[row], abs=0.2)
        assert y_px == pytest.approx(frames.y_px[row], abs=0.4)


def commanded(inputs: RigInputs) -> Scene:
    settings = SimulationSettings.model_validate(
        {"release": {"way": "by command"}, "fast": {"amplitude_arcsec": 0.0}, "axes": {"leakage": 0.0}}
    )
    return Scene(settings, FaultSettings(), SensorSettings(0, 0, 320, 640, 8, 100.0, 0.0, 100.0), 0, inputs)


def slow_arcsec(view: Scene, seconds: float) -> NDArray[np.float64]:
    return (319.5 - view.plan(round(seconds * 100)).y_px) / ONE_ARCSEC_PX


def test_magnet_holds_and_lets_go_and_the_laser_obeys() -> None:
    inputs = RigInputs()
    view = commanded(inputs)
    dark = view.plan(10)
    assert not dark.power.any()
    assert dark.y_px == pytest.approx([319.5] * 10)
    inputs.laser(0.5e-3)
    inputs.magnet(True)
    assert slow_arcsec(view, 1.0)[1:] == pytest.approx([124.0] * 99, rel=1e-5)
    assert view.plan(1).power[0] == pytest.approx(0.5)
    inputs.magnet(False)
    swing = slow_arcsec(view, 8.5)
    assert swing.max() == pytest.approx(124.0, rel=1e-5)
    assert swing.min() == pytest.approx(-123.2, abs=0.3)


def test_a_pulse_of_the_laser_shows_the_spot_where_it_is_then() -> None:
    """100 us of exposure about each frame's time; the pulse is its last quarter, so 37.5 us later."""
    lit, pulsed = RigInputs(), RigInputs()
    for inputs in (lit, pulsed):
        inputs.laser(1e-3)
        inputs.magnet(True)
    pulsed.pulse(75.0, 25.0)
    views = [commanded(inputs) for inputs in (lit, pulsed)]
    for inputs, view in zip((lit, pulsed), views, strict=True):
        view.plan(10)
        inputs.magnet(False)
    plain, short = (view.plan(200) for view in views)
    speed_px_per_s = np.gradient(plain.y_px, plain.true_time_s)
    assert np.abs(speed_px_per_s).max() > 100.0
    assert (short.y_px - plain.y_px)[1:-1] == pytest.approx(37.5e-6 * speed_px_per_s[1:-1], abs=2e-5)
    assert short.power == pytest.approx(0.25 * plain.power)
    assert np.array_equal(short.device_time_ns, plain.device_time_ns)


def test_starter_pulse_sets_it_swinging_and_the_brake_and_the_clamp_stop_it() -> None:
    inputs = RigInputs()
    view = commanded(inputs)
    slow_arcsec(view, 1.0)
    inputs.starter(True)
    slow_arcsec(view, 0.5)
    inputs.starter(False)
    swing = slow_arcsec(view, 6.0)
    # a shift of the rest position by s for a time t leaves an amplitude of 2 s sin(w0 t/2)
    wanted = 2 * 150.0 * math.sin(math.pi / 4.071 * 0.5)
    assert np.abs(swing).max() == pytest.approx(wanted, rel=0.03)
    inputs.brake(True)
    braked = slow_arcsec(view, 20.0)
    assert np.abs(braked[-400:]).max() < 0.01
    inputs.brake(False)
    inputs.starter(True)
    slow_arcsec(view, 1.0)
    inputs.starter(False)
    inputs.clamp(True)
    assert slow_arcsec(view, 1.0)[1:] == pytest.approx([0.0] * 99, abs=1e-9)


def test_a_camera_that_creeps_and_slips_moves_every_spot_alike_whatever_the_arms() -> None:
    creep = {
        "camera_creep_y_px_per_min": 6.0,
        "camera_slips_at_s": 0.5,
        "camera_slip_x_px": -0.3,
        "pointing_walk_px_per_sqrt_s": 0.1,
    }
    reference = {"relative": 0.5, "gain": 2.0}
    still = plan(100, disturbances=creep | {"camera_creep_y_px_per_min": 0.0, "camera_slip_x_px": 0.0})
    moved = plan(100, disturbances=creep, reference=reference)
    times_s = np.arange(100) / 100.0
    slip = np.where(times_s >= 0.5, -0.3, 0.0)
    assert moved.x_px - still.x_px == pytest.approx(slip, abs=1e-12)
    assert moved.y_px - still.y_px == pytest.approx(0.1 * times_s, abs=1e-9)
    # the beam moves the reference half as far
    of_reference = moved.beam_px / 2.0 - still.beam_px / 2.0
    assert of_reference[:, 0] == pytest.approx(slip, abs=1e-12)
    assert of_reference[:, 1] == pytest.approx(0.1 * times_s, abs=1e-9)


def test_a_base_that_tilts_takes_the_resting_pendulum_and_the_reference_with_it() -> None:
    ground = {"tilt_step_at_s": 2.0, "tilt_step_slow_arcsec": 3.0, "tilt_fast_arcsec_per_min": 60.0}
    quiet = {"b": 0.0, "c": 0.0, "gamma_pa": 0.0, "drag_s": 0.5}
    found = plan(
        6000,
        contact=quiet,
        ground=ground,
        release={"amplitude_arcsec": 0.001},
        fast={"drag_s": 0.5},
        reference={"relative": 0.5},
    )
    reference_px = found.beam_px - found.beam_px[0]
    # up is positive, and so is down in rows
    assert reference_px[190, 1] == pytest.approx(0.0, abs=1e-3)
    assert reference_px[310:, 1] == pytest.approx(-3.0 * ONE_ARCSEC_PX, rel=1e-3)
    assert reference_px[:, 0] == pytest.approx(np.arange(6000) / 100.0 * ONE_ARCSEC_PX, abs=2e-3)
    # the pendulum swings to its new rest, and comes to rest there
    assert abs(found.y_px[250] - found.y_px[0]) < 0.9 * 3.0 * ONE_ARCSEC_PX
    assert found.y_px[-1] - found.y_px[0] == pytest.approx(-3.0 * ONE_ARCSEC_PX, rel=0.02)
    assert found.x_px[-1] - found.x_px[0] == pytest.approx(60.0 * ONE_ARCSEC_PX, rel=0.02)


def test_air_moves_the_spot_as_stated_and_the_reference_by_its_share_of_it() -> None:
    air = {"air_arcsec": 0.5, "air_from_hz": 0.1, "air_to_hz": 10.0}
    far, reference = {"arm_m": 2.0}, {"relative": 0.5, "air_common": 0.6}
    still, found = plan(6000, optics=far), plan(6000, disturbances=air, reference=reference, optics=far)
    spot_px = np.column_stack([found.x_px - still.x_px, found.y_px - still.y_px])
    assert np.std(spot_px, axis=0) == pytest.approx(2 * 0.5 * ONE_ARCSEC_PX, rel=0.2)
    assert np.std(found.beam_px, axis=0) == pytest.approx(2 * 0.5 * ONE_ARCSEC_PX, rel=0.2)
    assert np.mean(spot_px * found.beam_px, axis=0) == pytest.approx(0.6 * np.var(spot_px, axis=0), rel=0.25)
    # in other air, which changes as fast
    speeds = (np.std(np.diff(one, axis=0), axis=0) for one in (found.beam_px, spot_px))
    np.testing.assert_allclose(*speeds, rtol=0.1)
