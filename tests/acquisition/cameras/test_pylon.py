"""The pylon driver with Basler's camera emulation; skipped if pypylon is not installed."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from acquisition.camera import Camera, CameraSettings, FrameTimeout, PixelFormat
from acquisition.cameras.drivers import PylonSettings
from acquisition.cameras.pixel_formats import format_of
from acquisition.cameras.pylon import PylonCamera
from processing.errors import DeviceError
from rig.instrument import setting_differences
from tests.acquisition.cameras.conformance import CameraConformance


@pytest.fixture(autouse=True)
def _emulation(monkeypatch: pytest.MonkeyPatch) -> None:
    with warnings.catch_warnings():
        # its binary part is made by SWIG, whose types warn as they are made
        warnings.simplefilter("ignore")
        pytest.importorskip("pypylon.pylon", reason="pypylon is not installed (optional extra 'pylon')")
    monkeypatch.setenv("PYLON_CAMEMU", "1")


@pytest.fixture
def camera(_emulation: None) -> Iterator[PylonCamera]:
    """The emulated camera, open."""
    camera = PylonCamera()
    camera.open()
    yield camera
    camera.close()


class TestConformance(CameraConformance):
    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8", "mono10", "mono12", "mono16")
    APPLIES: ClassVar[dict[str, float]] = {"exposure_us": 2000.0, "frame_rate_hz": 50.0, "width_px": 320}
    SKIPS_WHEN_SLOW = True

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = PylonCamera()
        yield camera
        camera.close()

    @pytest.fixture
    def blocked_camera(self) -> Iterator[Camera]:
        camera = Triggered()
        yield camera
        camera.close()


class Triggered(PylonCamera):
    """Waits for a software trigger that does not come."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        applied = super().configure(settings)
        self._camera.TriggerSelector.Value = "FrameStart"
        self._camera.TriggerMode.Value = "On"
        self._camera.TriggerSource.Value = "Software"
        return applied


def pictures(folder: Path, count: int) -> list[np.ndarray[Any, Any]]:
    random = np.random.default_rng(11)
    made = [random.integers(0, 256, (48, 64), np.uint8) for _ in range(count)]
    for number, image in enumerate(made):
        cv2.imwrite(str(folder / f"{number:04}.png"), image)
    return made


def showing(folder: Path, camera: PylonCamera) -> PylonCamera:
    camera.open()
    camera._camera.ImageFilename.Value = str(folder)
    camera._camera.ImageFileMode.Value = "On"
    camera._camera.TestImageSelector.Value = "Off"
    camera.configure(CameraSettings(width_px=64, height_px=48, frame_rate_hz=200.0, pixel_format="mono8"))
    return camera


def test_two_hundred_pictures_come_byte_for_byte(tmp_path: Path) -> None:
    made = pictures(tmp_path, 200)
    camera = showing(tmp_path, PylonCamera())
    camera.start()
    for number, image in enumerate(made):
        frame = camera.read(5.0)
        assert frame is not None
        assert frame.sequence == number
        assert np.array_equal(frame.image, image)
    assert camera.status.dropped == 0
    camera.close()


def test_a_region_may_grow_again_up_to_the_end_of_the_sensor_and_no_further(camera: PylonCamera) -> None:
    info = camera.open()
    camera.configure(CameraSettings(width_px=64, offset_x_px=128))
    end_px = info.width_px - 128
    assert camera.configure(CameraSettings(width_px=end_px)).width_px == end_px
    with pytest.raises(DeviceError):
        camera.configure(CameraSettings(width_px=end_px + 8))


def test_a_software_trigger_gives_one_frame_each() -> None:
    camera = Triggered()
    camera.open()
    camera.configure(CameraSettings(width_px=64, height_px=48))
    camera.start()
    for number in range(3):
        with pytest.raises(FrameTimeout):
            camera.read(0.1)
        camera._camera.TriggerSoftware.Execute()
        frame = camera.read(5.0)
        assert frame is not None
        assert frame.sequence == number
    camera.close()


def test_failed_buffers_are_counted_and_never_delivered(tmp_path: Path) -> None:
    made = pictures(tmp_path, 60)
    camera = showing(tmp_path, PylonCamera())
    camera._camera.ForceFailedBufferCount.Value = 5
    camera.start()
    numbers = []
    for step in range(40):
        if step == 10:
            camera._camera.ForceFailedBuffer.Execute()
        frame = camera.read(5.0)
        assert frame is not None
        numbers.append(frame.sequence)
        assert any(np.array_equal(frame.image, image) for image in made)
    assert camera.status.error_status == 5
    assert numbers[-1] - numbers[0] + 1 - len(numbers) == 5
    camera.close()


def test_the_numbers_of_blocks_show_what_the_bus_has_dropped(
    camera: PylonCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera.configure(CameraSettings(width_px=64, height_px=48, frame_rate_hz=200.0))
    camera.start()
    # the last but one has no number
    blocks = iter([7, 8, 12, 2**64 - 1, 14])
    monkeypatch.setattr(camera._pylon.GrabResult, "GetBlockID", lambda _: next(blocks))
    frames = [camera.read(5.0) for _ in range(5)]
    assert [frame.sequence for frame in frames if frame is not None] == [0, 1, 5, 6, 7]
    assert camera.status.dropped_by_bus == 3


def test_padding_that_cannot_be_left_out_is_refused(
    camera: PylonCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels of 12 bits in rows of an odd width end within a byte."""
    camera.configure(CameraSettings(width_px=63, height_px=48, pixel_format="mono12"))
    camera.start()
    assert camera._expected is not None
    camera._expected = replace(camera._expected, format=format_of("Mono12p", None))
    monkeypatch.setattr(camera._pylon.GrabResult, "GetPaddingX", lambda _: 1)
    with pytest.raises(DeviceError, match="pads rows of 63 px in Mono12p; set a width"):
        camera.read(5.0)


def test_the_camera_that_is_meant_is_found_or_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match="0815-0000"):
        PylonCamera(PylonSettings(serial="none")).open()
    monkeypatch.setenv("PYLON_CAMEMU", "2")
    with pytest.raises(DeviceError, match=r"0815-0000.*0815-0001"):
        PylonCamera().open()
    camera = PylonCamera(PylonSettings(serial="0815-0001"))
    assert camera.open().serial == "0815-0001"
    with pytest.raises(DeviceError, match=r"exposure_us = .* are possible"):
        camera.configure(CameraSettings(exposure_us=1e12))
    camera.close()


def test_features_and_settings_are_those_of_the_camera(camera: PylonCamera) -> None:
    applied = camera.configure(CameraSettings(features={"TestImageSelector": "Testimage2"}))
    assert applied.features == {"TestImageSelector": "Testimage2"}
    values = camera.feature_values()
    assert len(values) > 20
    assert values["TestImageSelector"] == "Testimage2"
    assert camera.feature_value("NoSuchFeature") is None
    with pytest.raises(DeviceError, match="has no feature NoSuchFeature"):
        camera.configure(CameraSettings(features={"NoSuchFeature": 1}))


def test_what_another_program_left_on_is_switched_off_unless_asked(camera: PylonCamera) -> None:
    left_on = {"GainAuto": "Continuous", "ExposureAuto": "Continuous", "ExposureMode": "TriggerWidth"}
    for name, value in left_on.items():
        camera._camera.GetNodeMap().GetNode(name).Value = value
    camera._camera.TriggerMode.Value = "On"
    camera._camera.BinningHorizontal.Value = camera._camera.BinningVertical.Value = 2
    assert camera.configure(CameraSettings()).binning == 1
    names = (*left_on, "TriggerMode", "BinningVertical")
    assert [camera.feature_value(name) for name in names] == ["Off", "Off", "Timed", "Off", 1]
    assert camera.configure(CameraSettings(binning=2)).binning == 2
    assert camera.configure(CameraSettings(exposure_us=100.0)).binning == 2, "kept"
    assert camera.feature_value("BinningVertical") == 2
    camera.configure(CameraSettings(features={"GainAuto": "Once"}))
    assert camera.feature_value("GainAuto") == "Once"


def test_trigger_and_exposure_output(camera: PylonCamera) -> None:
    asked = CameraSettings(trigger="Line1", trigger_edge="falling", exposure_output="Line2")
    applied = camera.configure(asked)
    assert (applied.trigger, applied.trigger_edge) == ("Line1", "falling")
    assert applied.exposure_output == "Line2"
    assert camera.feature_value("LineMode") == "Output"
    camera.start()
    with pytest.raises(FrameTimeout):
        camera.read(0.1)
    camera.stop()
    assert camera.configure(CameraSettings(exposure_us=200.0)).trigger == "Line1", "kept"
    camera.open()
    assert camera.configure(CameraSettings(frame_rate_hz=10.0)).trigger is None
    camera.start()
    assert camera.read(5.0) is not None


def test_one_colour_of_a_mosaic_has_half_the_rows_and_columns(camera: PylonCamera) -> None:
    asked = CameraSettings(
        colour_plane="green", pixel_format="mono12", width_px=320, height_px=200, frame_rate_hz=50.0
    )
    applied = camera.configure(asked)
    assert setting_differences(asked, applied) == []
    assert camera.feature_value("PixelFormat") in ("BayerGR12", "BayerRG12", "BayerGB12", "BayerBG12")
    assert camera.feature_value("Width") == 640
    camera.start()
    frame = camera.read(5.0)
    assert frame is not None
    assert frame.image.shape == (200, 320)
    camera.stop()
    camera.open()
    assert camera.configure(CameraSettings()).colour_plane is None
    assert str(camera.feature_value("PixelFormat")).startswith("Mono")
