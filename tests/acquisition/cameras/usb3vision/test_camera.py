"""The USB3 Vision driver passes the conformance suite and reports wrong use."""

import itertools
import threading
import time
from collections.abc import Iterator
from typing import ClassVar

import libusb_package
import numpy as np
import pytest
import usb.backend.libusb1

from acquisition.camera import Camera, CameraLost, CameraSettings, ColourPlane, FrameTimeout, PixelFormat
from acquisition.cameras.drivers import make_camera
from acquisition.cameras.pixel_formats import BY_CODE
from acquisition.cameras.usb3vision import discovery
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.discovery import find_camera, find_cameras
from acquisition.cameras.usb3vision.settings import Usb3VisionSettings
from processing.errors import DeviceError
from rig.instrument import setting_differences
from tests.acquisition.cameras.conformance import CameraConformance, Unplug
from tests.acquisition.cameras.usb3vision import description
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend, wait_until
from tests.acquisition.cameras.usb3vision.device import EIRM, SIRM, VisionDevice

pytestmark = pytest.mark.realtime


def camera_on(device: VisionDevice, **settings: object) -> Usb3VisionCamera:
    """The driver on a bus with this camera alone."""
    return Usb3VisionCamera(Usb3VisionSettings.model_validate(settings), InProcessBackend(device))


def read_on(camera: Camera, timeout_s: float = 2.0) -> None:
    """Read until something is raised."""
    while True:
        camera.read(timeout_s)


@pytest.fixture
def device() -> VisionDevice:
    return VisionDevice(frames_inside=1000)


@pytest.fixture
def running(device: VisionDevice) -> Iterator[Usb3VisionCamera]:
    camera = camera_on(device)
    camera.open()
    camera.start()
    yield camera
    camera.close()


class TestConformance(CameraConformance):
    """All that is asked of every driver."""

    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8", "mono10", "mono12", "mono16")
    WRONG_FORMAT: ClassVar[PixelFormat | None] = None
    APPLIES: ClassVar[dict[str, float]] = {"exposure_us": 250.0, "gain_db": 6.0, "frame_rate_hz": 200.0}

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = camera_on(VisionDevice())
        yield camera
        camera.close()

    @pytest.fixture
    def blocked_camera(self) -> Iterator[Camera]:
        camera = camera_on(VisionDevice(frame_rate_hz=0.1))
        yield camera
        camera.close()

    @pytest.fixture
    def unplugged(self) -> Iterator[tuple[Camera, Unplug]]:
        device = VisionDevice()
        camera = camera_on(device)
        yield camera, device.unplug
        camera.close()


class TestConformanceOfASimpleCamera(TestConformance):
    """An older camera: one format, an older name for the exposure, small packets."""

    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8",)
    WRONG_FORMAT: ClassVar[PixelFormat | None] = "mono12"

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        xml = description.description(("Mono8",), "ExposureTimeAbs")
        camera = camera_on(VisionDevice(xml=xml, packing="plain", max_packet=64, first_block=1))
        yield camera
        camera.close()


def test_libusb_of_the_package_serves_where_the_system_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    library = usb.backend.libusb1
    real = library.get_backend
    monkeypatch.setattr(library, "_lib", None)
    monkeypatch.setattr(library, "_lib_object", None)
    monkeypatch.setattr(
        library, "get_backend", lambda find_library=None: real(find_library) if find_library else None
    )
    libusb_package.get_libusb1_backend.cache_clear()
    try:
        assert "libusb_package" in discovery._libusb().lib._name
    finally:
        libusb_package.get_libusb1_backend.cache_clear()


def test_driver_is_registered() -> None:
    assert isinstance(make_camera("usb3vision", Usb3VisionSettings(serial="x")), Usb3VisionCamera)
    assert isinstance(make_camera("usb3vision"), Usb3VisionCamera)


@pytest.mark.parametrize("name", [name for name in description.FORMATS if name.startswith("Mono")])
def test_every_format_gives_the_cameras_pixels(name: str) -> None:
    device = VisionDevice()
    camera = camera_on(device, transfer_bytes=1 << 16)  # frames of several transfers
    camera.open()
    camera.features.set("PixelFormat", name)
    camera.configure(CameraSettings(width_px=328, height_px=202, offset_x_px=10))
    camera.start()
    for _ in range(3):
        frame = camera.read(2.0)
        assert frame is not None
        assert np.array_equal(frame.image, device.pixels(frame.sequence))
        assert frame.image.dtype == (
            np.uint8 if BY_CODE[device.pixel_format].full_scale_dn == 255 else np.uint16
        )
        assert not frame.image.flags.writeable
    camera.close()


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"exposure_us": 5.0}, "ExposureTime = 5.0 is out of range; allowed is 20 to 1000000 us"),
        ({"gain_db": 40.0}, "Gain = 40.0 is out of range; allowed is -12 to 24 dB"),
        ({"width_px": 1448}, "Width = 1448 is out of range; allowed is 8 to 1440 in steps of 8"),
        ({"width_px": 641}, "allowed is 8 to 1440 in steps of 8"),
        ({"offset_y_px": 1000}, "Height 480 at OffsetY 1000 reaches 1480; the sensor has 1080"),
        ({"frame_rate_hz": 5000.0}, "AcquisitionFrameRate = 5000.0 is out of range"),
    ],
)
def test_a_setting_out_of_range_says_the_range(
    device: VisionDevice, settings: dict[str, float], expected: str
) -> None:
    camera = camera_on(device)
    camera.open()
    with pytest.raises(DeviceError, match=expected):
        camera.configure(CameraSettings.model_validate(settings))
    camera.start()  # and the camera is still good
    assert camera.read(2.0) is not None
    camera.close()


def test_a_region_moves_although_old_and_new_limits_cross(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    for width, offset in ((160, 1280), (1440, 0), (800, 640), (640, 800), (8, 0)):
        applied = camera.configure(CameraSettings(width_px=width, offset_x_px=offset))
        assert (applied.width_px, applied.offset_x_px) == (width, offset)
    camera.close()


def test_a_colour_camera_is_refused_with_the_formats_that_work(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    camera.features.set("PixelFormat", "BayerRG8")
    with pytest.raises(
        DeviceError, match=r"BayerRG8 is not supported; set one of: mono8, mono10, mono12, mono14, mono16"
    ):
        camera.start()
    camera.close()


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
    device: VisionDevice, name: str, plane: ColourPlane, row: int, column: int
) -> None:
    camera = camera_on(device)
    camera.open()
    camera.features.set("PixelFormat", name)
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
    camera.close()


def test_a_mosaic_is_chosen_where_a_colour_is_asked_for(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    assert camera.configure(CameraSettings(colour_plane="red")).pixel_format == "mono8"
    assert camera.features.get("PixelFormat") == "BayerRG8"
    assert camera.configure(CameraSettings(pixel_format="mono12")).colour_plane == "red", "kept"
    assert camera.features.get("PixelFormat") == "BayerGB12p"
    with pytest.raises(DeviceError, match="does not offer pixel format mono10; it offers: mono8, mono12"):
        camera.configure(CameraSettings(pixel_format="mono10"))
    camera.close()
    camera.open()
    camera.configure(CameraSettings(pixel_format="mono8"))
    assert camera.features.get("PixelFormat") == "Mono8"
    camera.close()


def test_triggers_and_automatisms_are_off_when_they_would_be_in_the_way(device: VisionDevice) -> None:
    device.poke(description.TRIGGER_MODE, b"\x01\x01")
    device.poke(description.EXPOSURE_AUTO, b"\x01")
    device.poke(description.ACQUISITION_MODE, b"\x01")
    camera = camera_on(device)
    camera.open()
    camera.configure(CameraSettings(exposure_us=100.0))
    camera.start()
    assert device.peek(description.TRIGGER_MODE, 2) == b"\0\0"
    assert device.number(description.EXPOSURE_AUTO) == 0
    assert device.number(description.ACQUISITION_MODE) == 0
    assert device.number(description.LOCKED) == 1
    camera.close()
    assert device.number(description.LOCKED) == 0
    assert device.number(SIRM + 4) == 0


def test_a_camera_left_running_by_a_program_that_died_is_taken_over(device: VisionDevice) -> None:
    backend = InProcessBackend(device)
    first = Usb3VisionCamera(backend=backend)
    first.open()
    first.start()
    assert first.read(2.0) is not None
    assert first._stream is not None
    first._stream.reading.stop(1.0)
    device.owner = None  # the operating system has closed it
    second = Usb3VisionCamera(backend=backend)
    second.open()
    second.configure(CameraSettings(width_px=320))
    second.start()
    frame = second.read(2.0)
    assert frame is not None
    assert frame.sequence == 0
    assert np.array_equal(frame.image, device.pixels(0))
    second.close()


@pytest.mark.parametrize(
    ("xml", "expected"),
    [
        ("<RegisterDescription><Integer></RegisterDescription>", "malformed XML"),
        ("<html/>", "not a RegisterDescription"),
        ("<RegisterDescription></RegisterDescription>", "has no features"),
        (description.description().replace('Name="Height"', 'Name="Hoehe"'), "lacks Height"),
        (
            description.description().replace("<Min>8</Min>", "<Min>eight</Min>"),
            "its Min 'eight' is not a number",
        ),
        (
            description.description().replace(
                "<Formula>1440 - SIZE</Formula>", "<Formula>1440 / 0</Formula>"
            ),
            "OffsetXLimit: the formula '1440 / 0' in the camera's description divides by zero",
        ),
        (
            description.description().replace("<Formula>1440 - SIZE</Formula>", "<Formula>SIZE -</Formula>"),
            "ends too early",
        ),
        (description.description().replace("<pValue>WidthReg", "<pValue>Width"), "refers to itself"),
        (
            description.description().replace("<pValue>WidthReg", "<pValue>Nothing"),
            "has no feature 'Nothing'",
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


def test_clocks_are_related_to_within_the_commands_duration(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    first = camera.read_clocks()
    time.sleep(0.05)
    second = camera.read_clocks()
    device_ns = second.device_time_ns - first.device_time_ns
    host_ns = second.host_time_ns - first.host_time_ns
    assert abs(device_ns - host_ns) <= first.u_host_time_ns + second.u_host_time_ns + 16  # two steps of 8 ns
    camera.start()
    frame = camera.read(2.0)
    assert frame is not None
    latest = camera.read_clocks()
    age_ns = latest.device_time_ns - frame.device_time_ns
    assert 0 < age_ns < 2_000_000_000
    camera.close()


def test_what_another_program_left_on_is_switched_off_unless_asked(device: VisionDevice) -> None:
    for address in (layout.EXPOSURE_AUTO, layout.GAIN_AUTO, layout.GAMMA_ENABLE):
        device.poke(address, b"\1\0\0\0")
    camera = camera_on(device)
    camera.open()
    camera.configure(CameraSettings())
    names = ("ExposureAuto", "GainAuto", "GammaEnable")
    assert [camera.feature_value(name) for name in names] == ["Off", "Off", False]
    applied = camera.configure(CameraSettings(features={"GainAuto": "Continuous", "GammaEnable": True}))
    assert applied.features == {"GainAuto": "Continuous", "GammaEnable": True}
    assert camera.feature_value("ExposureAuto") == "Off"
    camera.close()


def test_each_edge_on_the_trigger_line_gives_one_frame(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
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
    camera.close()


def test_the_exposure_is_shown_on_the_line_that_is_named(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
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
    camera.close()


@pytest.mark.parametrize(
    ("exposure_us", "bytes_per_s", "possible_hz"), [(40_000.0, 0, 25.0), (1000.0, 30_720_000, 100.0)]
)
def test_a_rate_that_exposure_or_bus_do_not_allow_is_said_with_the_one_that_is_possible(
    device: VisionDevice, exposure_us: float, bytes_per_s: int, possible_hz: float
) -> None:
    device.poke(layout.THROUGHPUT, bytes_per_s.to_bytes(4, "little"))
    camera = camera_on(device)
    camera.open()
    asked = CameraSettings(exposure_us=exposure_us, frame_rate_hz=500.0)
    applied = camera.configure(asked)
    assert setting_differences(asked, applied) == [
        f"camera.frame_rate_hz = 500.0 was requested, the camera reports {possible_hz}"
    ]
    camera.close()


def test_exposure_and_rate_that_fit_together_are_set_in_either_direction(device: VisionDevice) -> None:
    """Each limits the other: 500 Hz do not fit while an exposure takes 40 ms."""
    camera = camera_on(device)
    camera.open()
    for exposure_us, rate_hz in ((40_000.0, 20.0), (1000.0, 500.0), (40_000.0, 20.0)):
        applied = camera.configure(CameraSettings(exposure_us=exposure_us, frame_rate_hz=rate_hz))
        assert (applied.exposure_us, applied.frame_rate_hz) == (exposure_us, rate_hz)
    camera.close()


def test_a_camera_without_a_driver_on_windows_is_listed_and_named(
    device: VisionDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    """libusb then says of everything but the descriptors that it is not implemented."""

    def not_implemented(*_: object) -> str:
        raise NotImplementedError("Operation not supported or unimplemented on this platform")

    monkeypatch.setattr("usb.util.get_string", not_implemented)
    (found,) = find_cameras(InProcessBackend(device))
    assert not found.accessible
    monkeypatch.setattr("sys.platform", "win32")
    with pytest.raises(DeviceError, match="give it WinUSB"):
        find_camera(None, InProcessBackend(device))


def test_attenuation_is_reported_as_such(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    assert camera.configure(CameraSettings(gain_db=-6.0)).gain_db == -6.0
    camera.close()


@pytest.mark.parametrize("step_ns", [8, 125_000])
def test_timestamps_are_ns_whatever_their_resolution(step_ns: int, caplog: pytest.LogCaptureFixture) -> None:
    """The increment is the resolution of the clock and not its unit; one of 125 us is said to be coarse."""
    camera = camera_on(VisionDevice(clock_step_ns=step_ns))
    assert camera.open().has_clock
    assert ("steps of 125 us" in caplog.text) == (step_ns == 125_000)
    camera.configure(CameraSettings(frame_rate_hz=100.0, width_px=32, height_px=32))
    camera.start()
    frames = [camera.read(2.0) for _ in range(3)]
    camera.close()
    times_ns = [frame.device_time_ns for frame in frames if frame is not None]
    for before_ns, after_ns in itertools.pairwise(times_ns):
        assert after_ns - before_ns == pytest.approx(10_000_000, abs=step_ns)


def test_unplugged_and_plugged_again_the_counts_go_on(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    camera.start()
    for _ in range(5):
        assert camera.read(2.0) is not None
    device.faults.unplug_after_stream_bytes = device._streamed + 100_000  # in the middle of a frame
    begin_s = time.monotonic()
    with pytest.raises(CameraLost, match="plug it in again"):
        read_on(camera)
    assert time.monotonic() - begin_s < 2 / 100.0 + 0.5
    delivered = camera.status.delivered
    camera.close()
    with pytest.raises(DeviceError, match="no USB3 Vision camera is plugged in"):
        camera.open()
    device.plug()
    camera.open()
    camera.start()
    frame = camera.read(2.0)
    assert frame is not None
    assert frame.sequence == 0
    assert camera.status.reconnects == 1
    assert camera.status.delivered == delivered + 1
    camera.close()


def test_what_a_slow_reader_leaves_to_the_camera_is_lost_there_and_counted() -> None:
    later_s = 0.0
    device = VisionDevice(frames_inside=8, clock=lambda: time.monotonic() + later_s)
    camera = camera_on(device)
    camera.open()
    camera.start()
    numbers = [frame.sequence for frame in (camera.read(2.0) for _ in range(2)) if frame is not None]
    before = device.frames_lost_inside - camera.status.dropped
    later_s = 1.0
    numbers += [frame.sequence for frame in (camera.read(2.0) for _ in range(20)) if frame is not None]
    status = camera.status
    assert len(numbers) == status.delivered == 22
    assert numbers[-1] + 1 == status.delivered + status.dropped
    assert status.dropped == status.dropped_by_camera == device.frames_lost_inside - before > 50
    camera.close()


def test_the_driver_has_no_thread_of_its_own(device: VisionDevice) -> None:
    threads = set(threading.enumerate())
    camera = camera_on(device)
    camera.open()
    camera.start()
    assert camera.read(2.0) is not None
    assert set(threading.enumerate()) == threads
    camera.close()


def test_a_number_of_buffers_of_an_earlier_version_is_accepted_and_said_to_do_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    assert Usb3VisionSettings.model_validate({"buffers": 64}) == Usb3VisionSettings()
    assert not caplog.records
    assert Usb3VisionSettings.model_validate({"buffers": 500}) == Usb3VisionSettings()
    assert "camera.usb3vision.buffers = 500 has no effect any more" in caplog.text


def test_stop_returns_in_time_from_a_camera_that_has_fallen_silent(
    running: Usb3VisionCamera, device: VisionDevice
) -> None:
    assert running.read(2.0) is not None
    device.faults.replies = lambda command, reply: []
    for action in (running.stop, running.close):
        begin_s = time.monotonic()
        action()
        assert time.monotonic() - begin_s < 1.0


def test_stop_and_close_return_in_time_while_open_hangs() -> None:
    device = VisionDevice()
    device.faults.replies = lambda command, reply: []
    camera = camera_on(device, control_timeout_s=5.0)
    failed = threading.Event()

    def opening() -> None:
        with pytest.raises(DeviceError):
            camera.open()
        failed.set()

    thread = threading.Thread(target=opening, daemon=True)
    thread.start()
    assert wait_until(lambda: device.commands > 0)
    begin_s = time.monotonic()
    camera.close()
    assert time.monotonic() - begin_s < 1.0
    assert failed.wait(1.0)
    assert device.owner is None


def test_a_stall_is_a_timeout_not_a_loss(running: Usb3VisionCamera, device: VisionDevice) -> None:
    assert running.read(2.0) is not None
    device._running_since = None
    with pytest.raises(FrameTimeout, match="no frame within"):
        read_on(running, 0.2)


def test_events_are_switched_off(device: VisionDevice) -> None:
    device.poke(EIRM, b"\x01")
    camera = camera_on(device)
    camera.open()
    assert device.number(EIRM) == 0
    device.faults.refuse = lambda command, address: 0x8003 if address == EIRM else 0
    camera.close()
    camera.open()  # a camera without events refuses the register, which is no matter
    camera.close()


def test_all_features_can_be_listed(device: VisionDevice) -> None:
    camera = camera_on(device)
    camera.open()
    seen = {reading.name: reading for reading in camera.features.readings()}
    assert seen["Width"].value == 640
    assert (seen["Width"].minimum, seen["Width"].maximum) == (8, 1440)
    assert seen["ExposureTime"].unit == "us"
    assert seen["PixelFormat"].value == "Mono8"
    assert "Mono12p" in seen["PixelFormat"].choices
    assert seen["AcquisitionStart"].access == "write-only"
    assert seen["DeviceSerialNumber"].value == device.serial
    assert all(reading.problem == "" for reading in seen.values())
    camera.close()
