"""The record says how the camera was set, and how warm it was, at the start and at the end."""

import json
import struct
from pathlib import Path

import pytest

from acquisition.camera import CameraSettings
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.record.reader import RecordReader
from rig.devices.frame_stream import FrameStream
from rig.devices.session_devices import Devices, OpenCamera
from rig.instrument import optics_of
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunOutcome, RunPlan
from rig.settings import Configuration
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice

ONE_SECOND = Configuration(
    camera={"driver": "simulated"}, session={"max_duration_s": 1.0, "final_amplitude_arcsec": 1e-9}
)


class CannotStop(Usb3VisionCamera):
    """A driver that measures well and cannot end."""

    def stop(self) -> None:
        super().stop()
        raise OSError("it does not answer")


def recorded(camera: Usb3VisionCamera, record: Path) -> RunOutcome:
    """A run of a second."""
    asked = CameraSettings(exposure_us=200.0, width_px=64, height_px=64, frame_rate_hz=100.0, gain_db=-6.0)
    opened = OpenCamera(camera, camera.open(), (), camera.configure(asked), 100_000)
    outcome = MeasurementRun(
        plan=RunPlan(ONE_SECOND, Path(), record, "run 1"),
        camera=opened,
        optics=optics_of(ONE_SECOND, 255),
        stream=FrameStream(camera, asked, time_shift_ns=opened.time_shift_ns),
        devices=Devices(ONE_SECOND),
    ).execute()
    assert outcome.failure is None
    return outcome


def test_a_camera_that_cannot_stop_is_an_event_of_a_regular_run(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    outcome = recorded(CannotStop(backend=InProcessBackend(VisionDevice(frames_inside=100_000))), path)
    assert outcome.last.reason == "time limit of 1 s reached"
    with RecordReader(path) as reader:
        said = [(event.kind, event.text) for event in reader.events()]
    assert said[-2] == ("camera stop", "camera: stop() failed: OSError: it does not answer")
    assert said[-1] == ("stop", "time limit of 1 s reached")


@pytest.mark.slow
def test_features_with_the_temperature_are_in_the_record(tmp_path: Path) -> None:
    device = VisionDevice(frames_inside=100_000)
    device.poke(layout.TEMPERATURE, struct.pack("<f", 41.5))
    camera, record = Usb3VisionCamera(backend=InProcessBackend(device)), tmp_path / "run.mcap"
    recorded(camera, record)
    camera.close()
    with RecordReader(record) as reader:
        at = {
            when: json.loads(reader.attachments[f"camera-features-{when}.json"]) for when in ("start", "end")
        }
        applied = reader.metadata["camera_settings"]
    assert at["start"]["Gain"] == at["end"]["Gain"] == -6.0
    assert at["start"]["ExposureAuto"] == "Off"
    assert len(at["end"]) > 15
    assert {features["DeviceTemperature"] for features in at.values()} == {41.5}
    assert (applied["gain_db"], applied["exposure_us"]) == ("-6.0", "200.0")
    assert (applied["stamped"], applied["time_shift_ns"]) == ("start", "100000")
