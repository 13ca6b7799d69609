"""Settings of a USB3 Vision camera: what is applied, read back, refused, and left as it is."""

import numpy as np
import pytest

from acquisition.camera import CameraSettings, ColourPlane, FrameTimeout
from acquisition.cameras.pixel_formats import FORMATS
from acquisition.cameras.usb3vision import camera as driver
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from processing.errors import DeviceError
from rig.instrument import setting_differences
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import camera_on
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.registers import SIRM


@pytest.mark.parametrize("name", [name for name in layout.FORMATS if name.startswith("Mono")])
def test_every_format_gives_the_cameras_pixels(
    camera: Usb3VisionCamera, device: VisionDevice, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "_MAX_TRANSFER_BYTES", 1 << 16)  # frames of several transfers
    camera.features.put("PixelFormat", name)
    camera.configure(CameraSettings(width_px=328, height_px=202, offset_x_px=10))
    camera.start()
    full_scale_dn = {item.code: item.full_scale_dn for item in FORMATS}
    for _ in range(3):
        frame = camera.read(2.0)
        assert frame is not None
        assert np.array_equal(frame.image, device.pixels(frame.sequence))
        assert frame.image.dtype == (np.uint8 if full_scale_dn[device.pixel_format] == 255 else np.uint16)
        assert not frame.image.flags.writeable


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"exposure_us": 5.0}, r"exposure_us = 5 is out of range; 20 to 1e\+06 are possible"),
        ({"gain_db": 40.0}, "gain_db = 40 is out of range; -12 to 24 are possible"),
        ({"width_px": 1448}, "width_px with its offset reaches 1448; the sensor has 1440"),
        ({"width_px": 641}, "allowed is 8 to 1440 in steps of 8"),
        ({"offset_y_px": 1000}, "height_px with its offset reaches 1480; the sensor has 1080"),
        ({"frame_rate_hz": 5000.0}, "frame_rate_hz = 5000 is out of range"),
    ],
)
def test_a_setting_out_of_range_says_the_range(
    camera: Usb3VisionCamera, settings: dict[str, float], expected: str
) -> None:
    with pytest.raises(DeviceError, match=expected):
        camera.configure(CameraSettings.model_validate(settings))
    camera.start()  # and the camera is still good
    assert camera.read(2.0) is not None


def test_a_region_moves_although_old_and_new_limits_cross(camera: Usb3VisionCamera) -> None:
    for width, offset in ((160, 1280), (1440, 0), (800, 640), (640, 800), (8, 0)):
        applied = camera.configure(CameraSettings(width_px=width, offset_x_px=offset))
        assert (applied.width_px, applied.offset_x_px) == (width, offset)
    camera.configure(CameraSettings(width_px=160, offset_x_px=1280))
    with pytest.raises(DeviceError, match=r"width_px with its offset reaches 1480; .*set the offset, too"):
        camera.configure(CameraSettings(width_px=200))
    assert camera.features.region()[::2] == (1280, 160), "as it was"


def test_a_colour_camera_is_refused_with_the_formats_that_work(camera: Usb3VisionCamera) -> None:
    camera.features.put("PixelFormat", "BayerRG8")
    with pytest.raises(
        DeviceError, match=r"BayerRG8 is not supported; set one of: mono8, mono10, mono12, mono14, mono16"
    ):
        camera.start()


@pytest.mark.parametrize(
    ("name", "plane", "row", "column"),
    [
        ("BayerRG8", "red", 0, 0),
        ("BayerRG8", "green", 0, 1),
        ("BayerRG8", "blue", 1, 1),
        ("BayerGB12p", "red", 1, 0),
        ("BayerGB12p", "green", 1, 1),
        ("BayerGB12p", "blue", 0, 1),
    ],
)
def test_one_colour_of_a_mosaic_is_delivered_as_it_was_read(
    camera: Usb3VisionCamera, device: VisionDevice, name: str, plane: ColourPlane, row: int, column: int
) -> None:
    camera.features.put("PixelFormat", name)
    asked = CameraSettings(colour_plane=plane, width_px=160, height_px=101, offset_x_px=5, offset_y_px=3)
    applied = camera.configure(asked)
    assert setting_differences(asked, applied) == []
    assert device.shape == (202, 320)
    assert device.number(layout.OFFSET_X) == 10
    camera.start()
    for _ in range(2):
        frame = camera.read(2.0)
        assert frame is not None
        assert frame.image.shape == (101, 160)
        assert np.array_equal(frame.image, device.pixels(frame.sequence)[row::2, column::2])
        assert not frame.image.flags.writeable


def test_a_mosaic_is_chosen_where_a_colour_is_asked_for(camera: Usb3VisionCamera) -> None:
    assert camera.configure(CameraSettings(colour_plane="red")).pixel_format == "mono8"
    assert camera.features.read("PixelFormat") == "BayerRG8"
    assert camera.configure(CameraSettings(pixel_format="mono12")).colour_plane == "red", "kept"
    assert camera.features.read("PixelFormat") == "BayerGB12p"
    with pytest.raises(DeviceError, match="pixel format mono10 is not supported; there are mono8, mono12"):
        camera.configure(CameraSettings(pixel_format="mono10"))
    camera.close()
    camera.open()
    camera.configure(CameraSettings(pixel_format="mono8"))
    assert camera.features.read("PixelFormat") == "Mono8"


def test_triggers_and_automatisms_are_off_when_they_would_be_in_the_way(device: VisionDevice) -> None:
    device.poke(layout.TRIGGER_MODE, b"\x01\x01")
    device.poke(layout.EXPOSURE_AUTO, b"\x01")
    device.poke(layout.ACQUISITION_MODE, b"\x01")
    camera = camera_on(device)
    camera.open()
    camera.configure(CameraSettings(exposure_us=100.0))
    camera.start()
    assert device.peek(layout.TRIGGER_MODE, 2) == b"\0\0"
    assert device.number(layout.EXPOSURE_AUTO) == 0
    assert device.number(layout.ACQUISITION_MODE) == 0
    assert device.number(layout.LOCKED) == 1
    camera.close()
    assert device.number(layout.LOCKED) == 0
    assert device.number(SIRM + 4) == 0


@pytest.mark.parametrize(
    ("xml", "expected"),
    [
        ("<html/>", "description is not valid: Error while parsing XML stream at line 1"),
        ("<RegisterDescription></RegisterDescription>", "description is not valid"),
        (
            layout.description()
            .replace("<pFeature>Height</pFeature>", "")
            .replace('Name="Height"', 'Name="Hoehe"'),
            "lacks Height",
        ),
        (layout.description().replace("<Min>8</Min>", "<Min>eight</Min>"), "cannot convert 'eight'"),
        (
            layout.description().replace("<Formula>1440 - SIZE</Formula>", "<Formula>1440 / 0</Formula>"),
            "OffsetX cannot be set to 4: OffsetXLimit : Failed to evaluate formula '1440 / 0'",
        ),
        (
            layout.description().replace("<pValue>WidthReg", "<pValue>Nothing"),
            "(?i)dangling node reference 'Nothing'",
        ),
    ],
)
def test_a_description_that_is_wrong_is_one_clear_line(xml: str, expected: str) -> None:
    camera = camera_on(VisionDevice(xml=xml))

    def use() -> None:
        camera.open()
        camera.configure(CameraSettings(width_px=320, offset_x_px=4))

    with pytest.raises(DeviceError, match=expected) as error:
        use()
    assert "\n" not in str(error.value)
    camera.close()


def test_what_another_program_left_on_is_switched_off_unless_asked(
    camera: Usb3VisionCamera, device: VisionDevice
) -> None:
    for address in (layout.EXPOSURE_AUTO, layout.GAIN_AUTO, layout.GAMMA_ENABLE):
        device.poke(address, b"\1\0\0\0")
    camera.configure(CameraSettings())
    names = ("ExposureAuto", "GainAuto", "GammaEnable")
    assert [camera.feature_value(name) for name in names] == ["Off", "Off", False]
    applied = camera.configure(CameraSettings(features={"GainAuto": "Continuous", "GammaEnable": True}))
    assert applied.features == {"GainAuto": "Continuous", "GammaEnable": True}
    assert camera.feature_value("ExposureAuto") == "Off"


def test_each_edge_on_the_trigger_line_gives_one_frame(
    camera: Usb3VisionCamera, device: VisionDevice
) -> None:
    applied = camera.configure(CameraSettings(trigger="Line3", frame_rate_hz=5000.0, exposure_us=500.0))
    assert (applied.trigger, applied.trigger_edge) == ("Line3", "rising")
    assert applied.frame_rate_hz == 2000.0, "what the exposure allows, whoever triggers"
    camera.start()
    with pytest.raises(FrameTimeout, match="is its trigger on"):
        camera.read(0.05)
    for line in (1, 3, 1, 3):
        device.edge(line)
    frames = [camera.read(2.0) for _ in range(2)]
    assert [frame.sequence for frame in frames if frame] == [0, 1]
    with pytest.raises(FrameTimeout):
        camera.read(0.05)
    camera.stop()
    camera.configure(CameraSettings(trigger="Line3", trigger_edge="falling"))
    assert device.number(layout.TRIGGER_ACTIVATION) == 1
    assert camera.configure(CameraSettings(exposure_us=100.0)).trigger == "Line3", "kept"
    camera.close()
    camera.open()
    assert camera.configure(CameraSettings()).trigger is None
    camera.start()
    assert camera.read(2.0) is not None, "without the setting it runs freely again"


def test_a_trigger_that_is_set_as_a_feature_stays_on(camera: Usb3VisionCamera, device: VisionDevice) -> None:
    camera.configure(CameraSettings(features={"TriggerSource": "Line3", "TriggerMode": "On"}))
    camera.start()
    with pytest.raises(FrameTimeout):
        camera.read(0.05)
    device.edge(3)
    assert camera.read(2.0) is not None


def test_the_exposure_is_shown_on_the_line_that_is_named(
    camera: Usb3VisionCamera, device: VisionDevice
) -> None:
    assert camera.configure(CameraSettings(exposure_output="Line2")).exposure_output == "Line2"
    assert device.peek(layout.LINE_MODE, 2) == device.peek(layout.LINE_SOURCE, 2) == b"\0\1"
    with pytest.raises(DeviceError, match="LineSelector cannot be Line7; it can be Line1, Line2"):
        camera.configure(CameraSettings(exposure_output="Line7"))
    with pytest.raises(DeviceError, match="TriggerSource cannot be Line2; it can be Software, Line1, Line3"):
        camera.configure(CameraSettings(trigger="Line2"))
    with pytest.raises(DeviceError, match=r"has no BinningHorizontal; leave camera\.binning out"):
        camera.configure(CameraSettings(binning=2))
    with pytest.raises(DeviceError, match=r"has no PtpEnable; leave camera\.ptp out"):
        camera.configure(CameraSettings(ptp=True))


@pytest.mark.parametrize(
    ("exposure_us", "bytes_per_s", "possible_hz"), [(40_000.0, 0, 25.0), (1000.0, 30_720_000, 100.0)]
)
def test_a_rate_that_exposure_or_bus_do_not_allow_is_said_with_the_one_that_is_possible(
    camera: Usb3VisionCamera, device: VisionDevice, exposure_us: float, bytes_per_s: int, possible_hz: float
) -> None:
    device.poke(layout.THROUGHPUT, bytes_per_s.to_bytes(4, "little"))
    asked = CameraSettings(exposure_us=exposure_us, frame_rate_hz=500.0)
    applied = camera.configure(asked)
    assert setting_differences(asked, applied) == [
        f"camera.frame_rate_hz = 500.0 was requested, the camera reports {possible_hz}"
    ]


def test_a_setting_that_differs_by_more_than_a_thousandth_is_said() -> None:
    asked = CameraSettings(exposure_us=1000.0, frame_rate_hz=999.5)
    assert setting_differences(asked, CameraSettings(exposure_us=1000.9, frame_rate_hz=1000.4)) == []
    slow, fast = setting_differences(asked, CameraSettings(exposure_us=1001.6, frame_rate_hz=999.5))
    assert slow == "camera.exposure_us = 1000.0 was requested, the camera reports 1001.6"
    assert fast.endswith("an exposure of 1001.6 µs leaves at most 998.403 Hz")


def test_exposure_and_rate_that_fit_together_are_set_in_either_direction(camera: Usb3VisionCamera) -> None:
    """Each limits the other: 500 Hz do not fit while an exposure takes 40 ms."""
    for exposure_us, rate_hz in ((40_000.0, 20.0), (1000.0, 500.0), (40_000.0, 20.0)):
        applied = camera.configure(CameraSettings(exposure_us=exposure_us, frame_rate_hz=rate_hz))
        assert (applied.exposure_us, applied.frame_rate_hz) == (exposure_us, rate_hz)
    assert camera.configure(CameraSettings(gain_db=-6.0)).gain_db == -6.0, "attenuation is reported as such"


def test_all_features_can_be_listed(camera: Usb3VisionCamera, device: VisionDevice) -> None:
    seen = {reading.name: reading for reading in camera.features.readings()}
    assert seen["Width"].value == 640
    assert (seen["Width"].minimum, seen["Width"].maximum) == (8, 1440)
    assert seen["ExposureTime"].unit == "us"
    assert seen["PixelFormat"].value == "Mono8"
    assert "Mono12p" in seen["PixelFormat"].choices
    assert seen["AcquisitionStart"].access == "write-only"
    assert seen["DeviceSerialNumber"].value == device.serial
    assert all(reading.problem == "" for reading in seen.values())
