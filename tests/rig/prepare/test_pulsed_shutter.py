"""The row time from a record that was made with a pulsed laser."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import CameraInfo, Frame
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.spot import Spot
from rig.instrument import configuration_attachments, session_metadata
from rig.prepare import Filing, calibrate_shutter, filed
from rig.settings import validate_configuration

ROWS, EXPOSURE_US, ROW_TIME_US = 400, 8000.0, 12.0


def pulsed_record(path: Path, exposure: dict[str, str]) -> Path:
    """A swing over 300 rows; each row misses the light that passes before it opens."""
    controller = {"kind": "serial", "port": "/dev/ttyACM0"}
    laser = {"kind": "controller", "power_w": 1e-4, "pulse_us": EXPOSURE_US}
    config = validate_configuration(
        {"camera": {"driver": "usb3vision"}, "controller": controller, "laser": laser}, "test"
    )
    info = CameraInfo("any", "", "", "", 64, ROWS, 255, has_clock=True, shutter="Rolling")
    count = 600
    times_ns = np.arange(count) * 20_000_000
    y_px = 200.0 + 150.0 * np.cos(np.arange(count) / 15.0)
    light = (1.0 - ROW_TIME_US * y_px / EXPOSURE_US) * (
        1.0 + 0.004 * np.random.default_rng(3).normal(size=count)
    )
    spots = [
        Spot(32.0, y, 0.02, 0.02, 5.0, 5.0, 0.0, 150.0 * part, 6.0, 1.0, 0)
        for y, part in zip(y_px.tolist(), light.tolist(), strict=True)
    ]
    zeros = np.zeros(count)
    deflections = Deflections(times_ns, zeros, zeros, zeros, zeros, DeflectionUnit.PX)
    first = Frame(np.zeros((ROWS, 64), np.uint8), 0, device_time_ns=0, host_time_ns=0)
    metadata = session_metadata(config, info, first) | {"camera_settings": exposure}
    attachments = configuration_attachments(config, path.with_suffix(".toml"))
    unit = DeflectionUnit.PX
    with RecordWriter(path, 0, metadata=metadata, attachments=attachments, deflection_unit=unit) as writer:
        numbers = list(range(count))
        writer.write_spots(numbers, times_ns.tolist(), times_ns.tolist(), spots, deflections)
    return path


def test_the_brightness_along_the_rows_gives_the_row_time(tmp_path: Path) -> None:
    record = pulsed_record(tmp_path / "run.mcap", {"exposure_us": str(EXPOSURE_US)})
    shown = filed(calibrate_shutter(record, Filing(tmp_path / "calibrations")))
    found = shown.calibration
    assert found.method == "brightness of a pulsed spot"
    assert found.values["row_time_s"] == pytest.approx(1e-6 * ROW_TIME_US, rel=0.01)
    assert found.values["first_row"] == "top"
    assert found.values["u_row_time_s"] < 0.04e-6 * ROW_TIME_US


def test_without_the_exposure_it_is_refused(tmp_path: Path) -> None:
    record = pulsed_record(tmp_path / "run.mcap", {})
    with pytest.raises(DataError, match="does not say how long its frames were exposed"):
        calibrate_shutter(record, Filing(tmp_path / "calibrations"))
