"""The record says how the camera was set, and how warm it was, at the start and at the end."""

import json
import struct
from pathlib import Path

from acquisition.camera import CameraSettings
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.record.reader import RecordReader
from rig.devices.frame_stream import FrameStream
from rig.devices.session_devices import Devices, OpenCamera
from rig.instrument import optics_of
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunPlan
from rig.settings import Configuration
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.rig.command_line import events_of

ONE_SECOND = Configuration(
    camera={"driver": "simulated"}, session={"max_duration_s": 1.0, "final_amplitude_arcsec": 1e-9}
)


class CannotStop(Usb3VisionCamera):
    """A driver that measures well and cannot end."""

    def stop(self) -> None:
        super().stop()
        raise OSError("it does not answer")


def test_features_are_in_the_record_and_a_camera_that_cannot_stop_is_an_event_of_a_regular_run(
    tmp_path: Path,
) -> None:
    device, record = VisionDevice(frames_inside=100_000), tmp_path / "run.mcap"
    device.poke(layout.TEMPERATURE, struct.pack("<f", 41.5))
    camera = CannotStop(backend=InProcessBackend(device))
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
    assert outcome.last.reason == "time limit of 1 s reached"
    assert events_of(record)[-2:] == [
        ("camera stop", "camera: stop() failed: OSError: it does not answer"),
        ("stop", "time limit of 1 s reached"),
    ]
    with RecordReader(record) as reader:
        start, end = (
            json.loads(reader.attachments[f"camera-features-{when}.json"]) for when in ("start", "end")
        )
        applied = reader.metadata["camera_settings"]
    assert start["Gain"] == end["Gain"] == -6.0
    assert start["ExposureAuto"] == "Off"
    assert len(end) > 15
    assert start["DeviceTemperature"] == end["DeviceTemperature"] == 41.5
    assert (applied["gain_db"], applied["exposure_us"]) == ("-6.0", "200.0")
    assert (applied["stamped"], applied["time_shift_ns"]) == ("start", "100000")
