"""A rolling shutter is measured from a run, and leaves nothing in the results."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from calibration import read_calibration
from calibration.shutter import ShutterFit
from processing.errors import DataError
from rig.instrument import (
    recorded_configuration,
)
from rig.measure import record_plainly
from rig.prepare import Filing, calibrate_shutter
from rig.view.replay import Replay
from tests.rig.command_line import CONFIGS, configured, rig

ROW_TIME_S = 15e-6


@pytest.mark.slow
def test_a_record_gives_the_row_time_and_is_corrected_with_it(tmp_path: Path) -> None:
    """The simulated rig knows itself; here the record is made as if nobody knew of the shutter."""
    words = {
        "simulation.sensor.row_time_s": str(ROW_TIME_S),
        "simulation.sensor.first_row": "bottom",
        "simulation.sensor.width_px": "64",
        "simulation.sensor.height_px": "320",
        "simulation.optics.arm_m": "0.5",
        "simulation.max_duration_s": "76",
        "camera.frame_rate_hz": "50",
        "session.max_duration_s": "80",
        "shutter.row_time_s": "0",
        "record.windows": "false",
    }
    record = tmp_path / "run.mcap"
    assert record_plainly(configured(words), CONFIGS / "demo.toml", record) == 0
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
    pulsed = configured({"laser.kind": "controller", "laser.pulse_us": "50"})
    monkeypatch.setattr("rig.prepare.record_calibrations.recorded_configuration", lambda _: pulsed)
    with pytest.raises(DataError, match=r"run-1\.mcap: its laser was pulsed"):
        calibrate_shutter(measured_series / "run-1.mcap", Filing(tmp_path))
