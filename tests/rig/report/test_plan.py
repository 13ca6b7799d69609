"""`rig plan`: from a record to the table."""

import math
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from processing.fit import LEAST_UNEXPLAINED, Conditions, PlannedRun
from rig.analysis import AnalysedRun, read_results
from rig.commands.reporting import plan
from rig.instrument import complete, recorded_configuration
from rig.report import (
    make_plan,
    plan_table,
    planned_contact,
    planned_contact_of_file,
    planned_contact_of_run,
)
from rig.report.plan import Plan
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS

PENDULUM = "pendulum={mass_kg=0.4, ball_radius_m=6e-3, contact_radius_m=6e-5}"
LEVER = "lever={arm_m=1.0, pixel_pitch_m=4.8e-6}"


def test_a_run_is_planned_from_a_record(
    measured_series: Path, analysed_run: AnalysedRun, capsys: pytest.CaptureFixture[str]
) -> None:
    plan(measured_series / "run-1.mcap", [124.0], [60.0, 15.0])
    said = " ".join(capsys.readouterr().out.split())
    assert "124 to 15" in said
    assert "u(γ)" in said
    assert "NOT RELIABLE: what this plan starts from does not determine" in said
    expected = planned_contact_of_run(analysed_run)
    shorter, longer = make_plan(expected, [124.0], [60.0, 15.0]).rows
    assert (longer["first_arcsec"], longer["last_arcsec"]) == pytest.approx((124.0, 15.0))
    assert longer["duration_s"] > shorter["duration_s"]
    assert longer["half_cycles"] > shorter["half_cycles"]
    assert longer["u_b"] < shorter["u_b"]
    with pytest.raises(ConfigurationError, match="should be below the first amplitude, 10 arcsec"):
        plan(measured_series / "run-1.mcap", [10.0], [60.0])


def test_a_drag_that_no_run_would_see_is_no_scale_of_its_uncertainty() -> None:
    """Of a rig in vacuum the fitted drag is nearly 0: thousands of per cent of it say nothing."""
    assumed = planned_contact(complete(load_configuration(CONFIGS / "demo.toml")))
    run = PlannedRun(6e-4, 1e-5, 600.0, 290, {"b": 1e-5, "drag_s": 2e-6})
    vacuum = Plan(assumed._replace(values={"b": 4e-3, "drag_s": -3e-8}), (run,))
    ((*_, b, drag),) = plan_table(vacuum).shown
    assert b == "0.25 %"
    assert drag == "2.0 × 10⁻⁶ s"
    air = Plan(assumed._replace(values={"b": 4e-3, "drag_s": 2e-3}), (run,))
    assert plan_table(air).shown[0][-1] == "0.1 %"
    assert "NOT RELIABLE" not in plan_table(air).note


def test_a_configuration_says_what_its_rig_will_measure(measured_series: Path) -> None:
    """Frames of the simulated rig, followed and detected, scatter as a plan of its configuration expects."""
    with RecordReader(measured_series / "run-1.mcap") as reader:
        conditions = planned_contact(recorded_configuration(reader)).conditions
    points = read_results(measured_series).runs[0].points
    u_rad, u_s_rad = np.median(points.u_amplitude), np.median(points.u_time_s * points.amplitude)
    assert conditions.u_amplitude_rad == pytest.approx(u_rad, rel=0.1)
    assert conditions.u_time_amplitude_s_rad == pytest.approx(u_s_rad, rel=0.1)
    assert conditions.ground_rad_per_s2_rthz == 0.0


def test_the_ground_of_a_configuration_drives_the_planned_pendulum() -> None:
    """A white level a drives it with w0^2 d a/(g R), a tilt of the base with w0^2 times its level."""

    def drive(*overrides: str) -> float:
        wanted = [f"simulation.ground.{override}" for override in overrides]
        return of_file("demo", *wanted).ground_rad_per_s2_rthz

    w0_squared = (2 * math.pi / 4.071) ** 2
    shaken = w0_squared * 1e-3 * 2e-6 / (9.80665 * 6.05e-3)
    white = ("model=white", "white_m_per_s2_per_sqrt_hz=2e-6", "mass_centre_height_m=1e-3")
    assert drive(*white) == pytest.approx(shaken, rel=1e-6)
    tilted = w0_squared * 1e-7
    assert drive("tilt_rad_per_sqrt_hz=1e-7") == pytest.approx(tilted, rel=1e-6)
    assert drive(*white, "tilt_rad_per_sqrt_hz=1e-7") == pytest.approx(math.hypot(shaken, tilted), rel=1e-6)
    higher = drive("model=peterson", "above_low_noise_db=40") / drive(
        "model=peterson", "above_low_noise_db=20"
    )
    assert higher == pytest.approx(10.0)
    with pytest.raises(ConfigurationError, match="state its drive with --ground"):
        drive("model=file", "file=ground.csv")


def test_air_and_a_wandering_beam_add_to_the_scatter_of_turning_points() -> None:
    still = of_file("demo", "simulation.disturbances.air_arcsec=0")
    for override in ("air_arcsec=0.02", "pointing_walk_px_per_sqrt_s=0.1", "pointing_jitter_px=0.2"):
        moved = of_file("demo", f"simulation.disturbances.{override}")
        assert moved.u_amplitude_rad > 1.5 * still.u_amplitude_rad
        assert moved.u_time_amplitude_s_rad > 1.5 * still.u_time_amplitude_s_rad


def test_a_plan_of_a_configuration_has_series_of_runs(
    measured_series: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, limit = CONFIGS / "basement.toml", ["session.max_duration_s=60"]
    contact = measured_series / "results.json"
    plan(source, [124.0], [15.0], None, limit, [3, 1], 0.02, contact)
    said = capsys.readouterr().out
    assert "124 to 15 *" in said
    assert "session.max_duration_s = 60 would end it earlier" in " ".join(said.split())
    expected = planned_contact_of_file(source, limit, 0.02, contact)
    one, three = make_plan(expected, [124.0], [15.0], counts=[3, 1]).rows
    assert (one["runs"], three["runs"]) == (1, 3)
    assert three["duration_s"] == one["duration_s"]
    assert three["u_c"] == pytest.approx(one["u_c"] / math.sqrt(3))
    with pytest.raises(ConfigurationError, match="a record has its own noise and contact"):
        plan(measured_series / "run-1.mcap", None, None, None, None, None, 0.02)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["camera.driver=usb3vision"], r"needs \[pendulum\]: state mass_kg and ball_radius_m"),
        (["camera.driver=usb3vision", PENDULUM, LEVER], "needs camera.frame_rate_hz"),
        (["camera.driver=usb3vision", PENDULUM, "camera.frame_rate_hz=50"], r"needs \[lever\]"),
        (["camera.frame_rate_hz=0.4"], "show a swing of 4.071 s too seldom: raise camera.frame_rate_hz"),
    ],
)
def test_what_a_plan_needs_of_a_configuration_is_named(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        of_file("demo", *overrides)


def of_file(name: str, *overrides: str) -> Conditions:
    return planned_contact_of_file(CONFIGS / f"{name}.toml", overrides, None, None).conditions


def test_a_plan_of_a_configuration_has_its_own_seismometer_and_reference() -> None:
    both, bare = of_file("vault"), of_file("vault", "seismometer.kind='none'")
    assert bare.seismometer_noise is None
    assert both.seismometer_noise == pytest.approx(LEAST_UNEXPLAINED, rel=0.2)
    assert both.unknown_rad_per_s2_rthz < 0.03 * bare.unknown_rad_per_s2_rthz
    # the air that the reference takes off does not bend the swing
    air = "simulation.disturbances.air_arcsec=0.1"
    airy, less = of_file("basement", air, "simulation.reference.relative=0"), of_file("vault", air)
    assert less.u_amplitude_rad < 0.6 * airy.u_amplitude_rad
    # a seismometer may hear itself more than the ground
    noisy = of_file("vault", "simulation.seismometer.noise_m_per_s2_per_sqrt_hz=2.5e-4")
    assert noisy.seismometer_noise is not None
    assert noisy.seismometer_noise > 10
    louder = noisy.on_ground(100 * noisy.ground_rad_per_s2_rthz)
    assert louder.seismometer_noise == pytest.approx(0.01 * noisy.seismometer_noise)
    assert louder.on_ground(1e9).seismometer_noise == LEAST_UNEXPLAINED
    unknown = of_file("vault", "seismometer.kind='serial'", "seismometer.port='/dev/any'")
    assert unknown.seismometer_noise == LEAST_UNEXPLAINED
