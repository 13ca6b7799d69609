"""A rolling shutter is measured from a run, and leaves nothing in the results."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import (
    FastModeTruth,
    OpticsTruth,
    ReleaseTruth,
    SensorTruth,
    SimulationSettings,
)
from calibration import read_calibration
from calibration.axes_fit import Axes
from calibration.light_lever import Lever
from calibration.shutter import GLOBAL, Shutter, ShutterFit, fit_row_time
from processing.deflections import slow_deflections
from processing.errors import DataError
from processing.fit import FitResult, fit_exact, points_in_true_time
from processing.spot import Spot
from processing.swing import half_cycles_of_blocks
from processing.units import ARCSEC_RAD
from rig.analysis import refined_half_cycles
from rig.instrument import (
    DeflectionConverter,
    complete,
    pendulum_on_ball,
    recorded_configuration,
)
from rig.measure import record_plainly
from rig.prepare import Filing, calibrate_shutter
from rig.settings import Configuration, FitSettings, load_configuration
from rig.view.replay import Replay
from tests.rig.command_line import rig

DEMO = Path(__file__).resolve().parents[3] / "configs" / "demo.toml"
ROW_TIME_S = 15e-6


RATE_HZ, DURATION_S, U_PX, FINAL_ARCSEC = 50.0, 200.0, 0.02, 4.0


def settings_of(row_time_s: float) -> SimulationSettings:
    """The demonstration's rig, with a shutter that opens its rows one after the other."""
    return SimulationSettings(
        seed=1,
        release=ReleaseTruth(amplitude_arcsec=124.0),
        fast=FastModeTruth(amplitude_arcsec=0.3),
        optics=OpticsTruth(arm_m=1.0),
        sensor=SensorTruth(width_px=320, height_px=640, row_time_s=row_time_s),
    )


def spots_of(settings: SimulationSettings) -> tuple[np.ndarray, list[Spot]]:
    """Times of the frames in ns and the spots in them, with the same noise whatever the shutter."""
    readings = SensorSettings(0, 0, 320, 640, 8, 100.0, 0.0, RATE_HZ)
    plan = Scene(settings, FaultSettings(), readings, 0).plan(round(DURATION_S * RATE_HZ))
    x_px, y_px = [plan.x_px, plan.y_px] + U_PX * np.random.default_rng(1).standard_normal((2, len(plan.x_px)))
    empty = Spot(*[0.0] * (len(Spot._fields) - 1), 0)  # type: ignore[arg-type]
    spots = [
        empty._replace(x_px=x, y_px=y, u_x_px=U_PX, u_y_px=U_PX)
        for x, y in zip(x_px.tolist(), y_px.tolist(), strict=True)
    ]
    return plan.device_time_ns, spots


def fitted(
    settings: SimulationSettings, frame_ns: np.ndarray, spots: list[Spot], shutter: Shutter
) -> FitResult:
    """The exact fit of the half-cycles, with this shutter taken for the camera's."""
    tree = {"camera": {"driver": "simulated"}, "simulation": settings.model_dump()}
    pendulum = pendulum_on_ball(complete(Configuration.model_validate(tree)))
    assert pendulum is not None
    lever = Lever(arm_m=settings.optics.arm_m, pixel_pitch_m=settings.sensor.pixel_pitch_m)
    at = DeflectionConverter(lever, Axes(), (640, 320), shutter)(frame_ns, spots)
    swings = [one for one in half_cycles_of_blocks([at]) if one.amplitude > FINAL_ARCSEC * ARCSEC_RAD]
    slow = slow_deflections(at.times_ns, at.y, at.u_y)
    refined = refined_half_cycles(swings, [slow], slow.unit, pendulum, FitSettings())
    return fit_exact(points_in_true_time(refined.swings, 1.0), pendulum)


@pytest.mark.slow
def test_corrected_parameters_are_those_of_a_global_shutter() -> None:
    plain, rolling = settings_of(0.0), settings_of(30e-6)
    reference = fitted(plain, *spots_of(plain), GLOBAL)
    frame_ns, spots = spots_of(rolling)
    found = fit_row_time(1e-9 * (frame_ns - frame_ns[0]), np.array([spot.y_px for spot in spots]))
    assert abs(found.row_time_s / 30e-6 - 1.0) < 0.03
    # another row is the one whose time is the frame's
    kept = [place for place, name in enumerate(reference.names) if name != "start_time_s"]
    corrected, uncorrected = (
        np.abs(fitted(rolling, frame_ns, spots, shutter).values - reference.values)[kept]
        / reference.standard_uncertainty[kept]
        for shutter in (Shutter(found.row_time_s), GLOBAL)
    )
    assert corrected.max() < 0.3
    assert uncorrected.max() > 10.0


@pytest.mark.slow
def test_a_record_gives_the_row_time_and_is_corrected_with_it(tmp_path: Path) -> None:
    """The simulated rig knows itself; here the record is made as if nobody knew of the shutter."""
    words = {
        "simulation.sensor.row_time_s": ROW_TIME_S,
        "simulation.sensor.first_row": "bottom",
        "simulation.sensor.width_px": 64,
        "simulation.sensor.height_px": 320,
        "simulation.optics.arm_m": 0.5,
        "simulation.max_duration_s": 76.0,
        "camera.frame_rate_hz": 50.0,
        "session.max_duration_s": 80.0,
        "shutter.row_time_s": 0.0,
        "record.windows": "false",
    }
    config = load_configuration(DEMO, [f"{key}={value}" for key, value in words.items()])
    record = tmp_path / "run.mcap"
    assert record_plainly(config, DEMO, record) == 0
    values = read_calibration(calibrate_shutter(record, Filing(tmp_path / "calibrations"))).values
    asked = rig("calibrate", "shutter", str(record), cwd=tmp_path)
    assert asked.returncode == 0, asked.stderr
    assert read_calibration(tmp_path / "calibrations" / "shutter-002.toml").values == values
    assert abs(values["row_time_s"] / ROW_TIME_S - 1.0) < 0.03
    assert values["first_row"] == "bottom"
    with RecordReader(record) as reader:
        spots = reader.spots()
        assert np.array_equal(spots["device_time_ns"], spots["time_ns"])
        corrected = recorded_configuration(
            reader, [f"shutter.{key}={value}" for key, value in values.items()]
        )
        replay = Replay(reader, corrected, retrack=False)
        assert sum(len(numbers) for numbers, _ in replay.blocks())
        times_ns = np.concatenate([block.times_ns for block in replay.finish().deflections])
    assert corrected.shutter is not None
    late_ns = np.rint(1e9 * values["row_time_s"] * (319 - spots["y_px"]))
    assert np.array_equal(times_ns - spots["time_ns"], late_ns)


@pytest.mark.parametrize(
    ("row_time_s", "filed_s", "said"), [(15e-9, 0.0, "not a row time"), (-10e-6, 10e-6, "from the second")]
)
def test_a_global_shutter_is_believed_only_where_the_swing_agrees(
    measured_series: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    row_time_s: float,
    filed_s: float,
    said: str,
) -> None:
    """The record's camera says "Global"; in the second case it is wrong."""

    fitted = ShutterFit(
        row_time_s=row_time_s,
        u_row_time_s=abs(row_time_s) / 10,
        amplitude_px=100.0,
        harmonic_px=0.01,
        even_per_px=0.0,
        chi2_per_dof=1.0,
        stretches=6,
    )
    monkeypatch.setattr("rig.prepare.record_calibrations.fit_row_time", lambda *_: fitted)
    found = read_calibration(calibrate_shutter(measured_series / "run-1.mcap", Filing(tmp_path)))
    assert found.values["row_time_s"] == filed_s
    assert any(said in note for note in found.notes) == (filed_s == 0.0)


def test_a_pulsed_laser_shows_no_row_time(measured_series: Path, tmp_path: Path, monkeypatch) -> None:
    """All rows see the pulse at the same time: the swing's second harmonic is another's."""
    pulsed = load_configuration(DEMO, ["laser.kind=controller", "laser.pulse_us=50"])
    monkeypatch.setattr("rig.prepare.record_calibrations.recorded_configuration", lambda _: pulsed)
    with pytest.raises(DataError, match=r"run-1\.mcap: its laser was pulsed"):
        calibrate_shutter(measured_series / "run-1.mcap", Filing(tmp_path))
