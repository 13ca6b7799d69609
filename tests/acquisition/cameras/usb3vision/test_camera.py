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

from acquisition.camera import Camera, CameraLost, CameraSettings, FrameTimeout, PixelFormat
from acquisition.cameras.drivers import Usb3VisionSettings, make_camera
from acquisition.cameras.usb3vision import camera as driver
from acquisition.cameras.usb3vision import link
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.link import find_camera, find_cameras
from processing.errors import DeviceError
from tests.acquisition.cameras.conformance import CameraConformance, Unplug
from tests.acquisition.cameras.usb3vision import description
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend, camera_on
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.registers import EIRM
from tests.waiting import until

SOON_S = 4.0
"""Less than the time for which an answer is waited for, on a busy machine."""


def read_on(camera: Camera, timeout_s: float = 2.0) -> None:
    """Read until something is raised."""
    while True:
        camera.read(timeout_s)


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
        assert "libusb_package" in link._libusb().lib._name
    finally:
        libusb_package.get_libusb1_backend.cache_clear()


def test_driver_is_registered() -> None:
    assert isinstance(make_camera("usb3vision", Usb3VisionSettings(serial="x")), Usb3VisionCamera)
    assert isinstance(make_camera("usb3vision"), Usb3VisionCamera)


def test_a_camera_left_running_by_a_program_that_died_is_taken_over(device: VisionDevice) -> None:
    backend = InProcessBackend(device)
    first = Usb3VisionCamera(backend=backend)
    first.open()
    first.start()
    assert first.read(2.0) is not None
    assert first._run is not None
    first._run.stop(1.0)
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


def test_a_clock_that_counts_in_seconds_is_none() -> None:
    camera = camera_on(VisionDevice(clock_step_ns=1_000_000_000))
    assert not camera.open().has_clock
    camera.close()


def test_unplugged_and_plugged_again_the_counts_go_on(
    running: Usb3VisionCamera, device: VisionDevice
) -> None:
    camera = running
    for _ in range(5):
        assert camera.read(2.0) is not None
    device.faults.unplug_after_stream_bytes = device._streamed + 100_000  # in the middle of a frame
    begin_s = time.monotonic()
    with pytest.raises(CameraLost, match="plug it in again"):
        read_on(camera)
    assert time.monotonic() - begin_s < SOON_S
    delivered = camera.status.delivered
    camera.close()
    with pytest.raises(DeviceError, match="usb3vision: no camera answers"):
        camera.open()
    device.plug()
    camera.open()
    camera.start()
    frame = camera.read(2.0)
    assert frame is not None
    assert frame.sequence == 0
    assert camera.status.reconnects == 1
    assert camera.status.delivered == delivered + 1


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


def test_stop_returns_in_time_from_a_camera_that_has_fallen_silent(
    running: Usb3VisionCamera, device: VisionDevice
) -> None:
    assert running.read(2.0) is not None
    device.faults.replies = lambda command, reply: []
    for action in (running.stop, running.close):
        begin_s = time.monotonic()
        action()
        assert time.monotonic() - begin_s < SOON_S


def test_stop_and_close_return_in_time_while_open_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "_REPLY_TIMEOUT_S", 5.0)
    device = VisionDevice()
    device.faults.replies = lambda command, reply: []
    camera = camera_on(device)
    failed = threading.Event()

    def opening() -> None:
        with pytest.raises(DeviceError):
            camera.open()
        failed.set()

    thread = threading.Thread(target=opening, daemon=True)
    thread.start()
    until(lambda: device.commands > 0)
    begin_s = time.monotonic()
    camera.close()
    assert time.monotonic() - begin_s < SOON_S
    assert failed.wait(10.0)
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
