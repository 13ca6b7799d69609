"""Runs in the guest: conformance suite and faults with the kernel's vivid driver, which goes and comes back.

What is done to it: its driver is unbound and bound, as when a cable is pulled and plugged in; its module is
unloaded and loaded; its device is given another number, because another program still holds the old one.
The argument is the file of vivid's module; names of scenarios may follow.
"""

import fcntl
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
import pytest

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, PixelFormat
from acquisition.cameras.drivers import V4l2Settings
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.camera import V4l2Camera
from acquisition.cameras.v4l2.devices import list_devices
from processing.errors import DeviceError
from rig.devices.frame_stream import FrameStream
from tests.acquisition.cameras.conformance import CameraConformance
from tests.kernel.scenarios import run_scenarios

SET_INPUT = 3 << 30 | 4 << 16 | ord("V") << 8 | 39  # VIDIOC_S_INPUT
WEBCAM, HDMI = 0, 3
COLOUR_BARS, COLOUR_SQUARES, NO_TEXT = 1, 4, 2
SMALL = CameraSettings(width_px=320, height_px=180)
AT_30_HZ = CameraSettings(width_px=320, height_px=180, frame_rate_hz=30.0)
DRIVER = Path("/sys/bus/platform/drivers/vivid")
WITHIN_S = 120.0


def device() -> str:
    """The first vivid device that captures grey images."""
    return next(found.path for found in list_devices() if "vivid" in found.name and "GREY" in found.formats)


@contextmanager
def opened() -> Iterator[int]:
    """The device itself, as another program opens it."""
    handle = kernel.open_device(device())
    try:
        yield handle
    finally:
        os.close(handle)


def make(**more: Any) -> V4l2Camera:
    return V4l2Camera(V4l2Settings.model_validate({"device": device(), **more}))


@contextmanager
def running(asked: CameraSettings = SMALL, **more: Any) -> Iterator[V4l2Camera]:
    """The camera, opened, configured and started; closed at the end."""
    camera = make(**more)
    camera.open()
    camera.configure(asked)
    camera.start()
    try:
        yield camera
    finally:
        camera.close()


class TestKernelReading(CameraConformance):
    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8", "mono10", "mono12", "mono16")
    HAS_REGION = False
    APPLIES: ClassVar[dict[str, float]] = {"width_px": 320, "height_px": 180, "frame_rate_hz": 30.0}
    SKIPS_WHEN_SLOW = True

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = make()
        camera.open()
        camera.configure(SMALL)
        camera.close()
        yield camera
        camera.close()


def suite(name: str) -> dict[str, Any]:
    """Outcome of each test of a class; nothing that failed is left out."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        status = pytest.main(
            [f"{__file__}::{name}", "-q", "-p", "no:cacheprovider", "-m", "", f"--junitxml={report}"]
        )
        cases = ElementTree.parse(report).iter("testcase")
        outcome = {
            str(case.get("name")): "".join(f"{part.tag}: {part.get('message')}" for part in case)
            for case in cases
        }
    return {"status": int(status), "tests": outcome}


def select_input(number: int) -> None:
    with opened() as handle:
        fcntl.ioctl(handle, SET_INPUT, struct.pack("<i", number))


def control(name: str, value: int) -> None:
    with opened() as handle:
        number = next(there.number for there in kernel.controls(handle) if there.name == name)
        kernel.set_control(handle, number, value)


def dropped() -> dict[str, Any]:
    """The driver drops a part of its buffers: what is missing is counted, the rest is in order."""
    control("Percentage of Dropped Buffers", 30)
    with running() as camera:
        frames = [camera.read(5.0) for _ in range(60)]
        status = camera.status
    control("Percentage of Dropped Buffers", 0)
    numbers = [frame.sequence for frame in frames if frame]
    times = np.array([frame.device_time_ns for frame in frames if frame])
    return {
        "numbers": numbers,
        "dropped_by_bus": status.dropped_by_bus,
        "dropped_by_host": status.dropped_by_host,
        "ms_per_number": (np.diff(times) / np.diff(numbers) / 1e6).tolist(),
        "age_ms": [(frame.host_time_ns - frame.device_time_ns) / 1e6 for frame in frames if frame],
    }


def late() -> dict[str, Any]:
    """Nobody reads for a second: all buffers are full, and what is missing then is the host's loss."""
    with running(AT_30_HZ) as camera:
        frames = [camera.read(5.0) for _ in range(5)]
        time.sleep(1.0)
        frames += [camera.read(5.0) for _ in range(20)]
        status = camera.status
    return {
        "numbers": [frame.sequence for frame in frames if frame],
        "dropped_by_bus": status.dropped_by_bus,
        "dropped_by_host": status.dropped_by_host,
        "delivered": status.delivered,
    }


def region() -> dict[str, Any]:
    """A part of the sensor holds the pixels of the whole: nothing is scaled or shifted.

    vivid's webcam has sizes only; its HDMI input has a region.
    """
    select_input(HDMI)
    control("Test Pattern", COLOUR_SQUARES)
    control("OSD Text Mode", NO_TEXT)
    camera = make()
    info = camera.open()
    wide, high = info.width_px, info.height_px
    regions = [(0, 0, wide, high), (wide // 4, high // 4, wide // 2, high // 2), (40, 24, 320, 240)]
    said: dict[str, Any] = {"sensor": (wide, high), "equal": [], "applied": []}
    whole = None
    for x, y, width, height in regions:
        applied = camera.configure(
            CameraSettings(width_px=width, height_px=height, offset_x_px=x, offset_y_px=y)
        )
        camera.start()
        frame = camera.read(10.0)
        camera.stop()
        assert frame is not None
        whole = frame.image if whole is None else whole
        said["equal"].append(bool(np.array_equal(frame.image, whole[y : y + height, x : x + width])))
        said["applied"].append(
            [applied.offset_x_px, applied.offset_y_px, applied.width_px, applied.height_px]
        )
    assert whole is not None
    said["asked"] = [list(one) for one in regions]
    said["levels"] = len(np.unique(whole))
    try:
        camera.configure(CameraSettings(width_px=wide, offset_x_px=8))
    except DeviceError as error:
        said["beyond"] = str(error)
    camera.close()
    select_input(WEBCAM)
    return said


def damaged() -> dict[str, Any]:
    """Buffers that the driver marks as damaged are counted as such, and not delivered."""
    numbers: list[int] = []
    with running() as camera:

        def read() -> None:
            frame = camera.read(5.0)
            assert frame is not None
            numbers.append(frame.sequence)

        for count in range(1, 6):
            control("Inject V4L2_BUF_FLAG_ERROR", 1)
            # Frames that were waiting come first. A gap in the numbers is not enough: on a slow host vivid
            # leaves out frames of its own accord, undamaged.
            while camera.status.error_status < count:
                assert len(numbers) < 500, f"{count}. damaged buffer is not counted: {camera.status}"
                read()
        # the frame after the last damaged one shows the gap
        read()
        status = camera.status
    return {"numbers": numbers, "error_status": status.error_status, "dropped": status.dropped}


def stale() -> dict[str, Any]:
    """After a second in which nobody read: is the first frame of the next start older than it?"""
    with running() as camera:
        camera.read(5.0)
        camera.stop()
        time.sleep(1.0)
        begin_ns = time.monotonic_ns()
        camera.start()
        frame = camera.read(5.0)
    assert frame is not None
    return {"before_start_ms": (begin_ns - frame.device_time_ns) / 1e6, "sequence": frame.sequence}


def refused() -> dict[str, Any]:
    """What can't be had is refused in one line that says what can."""
    camera = make()
    camera.open()
    said = {}
    for name, settings in {
        "exposure": CameraSettings(exposure_us=100.0),
        "gain": CameraSettings(gain_db=3.0),
        "offset": CameraSettings(offset_x_px=8),
    }.items():
        try:
            camera.configure(settings)
        except Exception as error:
            said[name] = f"{type(error).__name__}: {error}"
    camera.close()
    for name, options in {"gain range": {"gain": 9999}, "no device": {"device": "/dev/video99"}}.items():
        other = make(**options)
        try:
            other.open()
            other.configure(CameraSettings())
        except Exception as error:
            said[name] = f"{type(error).__name__}: {error}"
        other.close()
    other = make(gain=50)
    other.open()
    other.configure(CameraSettings())
    with opened() as handle:
        said["gain set"] = str(kernel.get_control(handle, kernel.GAIN))
    other.close()
    return said


def automatic() -> dict[str, Any]:
    """An automatic gain that another program left on is switched off by any configuration, unless asked."""
    control("Gain, Automatic", 1)
    camera = make()
    camera.open()
    said: dict[str, Any] = {"left": camera.feature_value("gain_automatic")}
    camera.configure(CameraSettings())
    said["configured"] = camera.feature_value("gain_automatic")
    camera.configure(CameraSettings(features={"gain_automatic": True}))
    said["asked"] = camera.feature_value("gain_automatic")
    camera.configure(CameraSettings())
    try:
        camera.configure(CameraSettings(trigger="Line1"))
    except DeviceError as error:
        said["trigger"] = str(error)
    camera.close()
    return said


def unplugged() -> dict[str, Any]:
    """vivid's button 'Disconnect' while frames run."""
    message = ""
    with running() as camera:
        for _ in range(5):
            camera.read(5.0)
        control("Disconnect", 1)
        begin_s = time.monotonic()
        try:
            while time.monotonic() - begin_s < 15:
                camera.read(5.0)
        except CameraLost as lost:
            message = str(lost)
        stop_s = time.monotonic()
    return {"noticed_s": stop_s - begin_s, "message": message, "close_s": time.monotonic() - stop_s}


def mosaic() -> dict[str, Any]:
    """The same picture in several mosaics: a colour's plane is the same in all of them."""
    control("Test Pattern", COLOUR_BARS)
    means: dict[str, dict[str, list[float]]] = {}
    shapes = set()
    for fourcc in ("RGGB", "GRBG", "GBRG", "BA81", "RG10", "BA12"):
        means[fourcc] = {}
        for plane in ("red", "green", "blue"):
            with opened() as handle:
                kernel.set_layout(handle, 640, 360, fourcc)
            camera = make()
            info = camera.open()
            camera.configure(CameraSettings.model_validate({"colour_plane": plane}))
            camera.start()
            frame = camera.read(5.0)
            camera.close()
            assert frame is not None
            shapes.add(frame.image.shape)
            # the means of the picture's colour bars
            bars = np.array_split(frame.image.mean(axis=0) / info.full_scale_dn, 8)
            means[fourcc][plane] = [float(bar[5:-5].mean()) for bar in bars]
    return {"means": means, "shapes": sorted(shapes)}


class Run:
    """A stream at default settings, and what came out of it."""

    def __init__(self, asked: CameraSettings = AT_30_HZ, **options: str) -> None:
        self.camera = V4l2Camera(V4l2Settings.model_validate(options))
        self.camera.open()
        self.stream = FrameStream(self.camera, asked, applied=self.camera.configure(asked))
        self.stream.start_camera()
        assert self.stream.begin() is not None
        self.frames: list[Frame] = []
        self.events: list[tuple[str, str]] = []

    def until(self, reached: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + WITHIN_S
        while not reached():
            if time.monotonic() > deadline_s or self.stream.drained:
                raise AssertionError((self.events, self.stream.ended, len(self.frames)))
            self.frames += self.stream.take(64, 0.1)
            self.events += [(str(kind), text) for kind, text in self.stream.take_events()]

    def goes_and_comes(self, go: Callable[[], None], come: Callable[[], None]) -> dict[str, Any]:
        """What the stream made of a camera that was away for a second."""
        try:
            self.until(lambda: len(self.frames) > 20)
            go()
            self.until(lambda: "camera lost" in dict(self.events))
            before = len(self.frames)
            away_s = time.monotonic() + 1.0
            self.until(lambda: time.monotonic() > away_s)
            come()
            self.until(lambda: "camera back" in dict(self.events) and len(self.frames) > before + 20)
        finally:
            self.stream.close()
            reconnects = self.camera.status.reconnects
            self.camera.close()
        return {
            "failure": repr(self.stream.failure) if self.stream.failure else "",
            "events": self.events,
            "numbers": [frame.sequence for frame in self.frames],
            "device_time_ns": [frame.device_time_ns for frame in self.frames],
            "host_time_ns": [frame.host_time_ns for frame in self.frames],
            "images": sorted({(*frame.image.shape, str(frame.image.dtype)) for frame in self.frames}),
            "while_unplugged": self.stream.losses.while_unplugged,
            "lost": self.stream.losses.total,
            "reconnects": reconnects,
        }


def bind(how: str = "bind") -> None:
    (DRIVER / how).write_text("vivid.0")


def unbind() -> None:
    bind("unbind")


def cable() -> dict[str, Any]:
    return Run().goes_and_comes(unbind, bind)


def same_settings() -> dict[str, Any]:
    """Nothing is asked for: the format that another program has set is that of the whole run."""
    with opened() as handle:
        kernel.set_layout(handle, 640, 360, "Y12 ")
        kernel.set_rate_hz(handle, 25.0)
    return Run(CameraSettings()).goes_and_comes(unbind, bind)


def module() -> dict[str, Any]:
    def come() -> None:
        # a module in use is not unloaded: its device goes first
        for words in (("rmmod", "vivid"), ("insmod", sys.argv[1])):
            done = subprocess.run(["busybox", *words], capture_output=True, text=True, check=False)
            assert not done.returncode, done.stderr

    return Run().goes_and_comes(unbind, come)


def other_number() -> dict[str, Any]:
    """The configuration names the device, whose number is then taken by a program that holds the old one."""
    before = device()
    run = Run(device=before)
    held = os.open(before, os.O_RDWR | os.O_NONBLOCK)
    try:
        return {**run.goes_and_comes(unbind, bind), "before": before, "after": device()}
    finally:
        os.close(held)


def main() -> None:
    scenarios: dict[str, Callable[[], dict[str, Any]]] = {
        "devices": lambda: {"found": [found._asdict() for found in list_devices()]},
        "kernel": lambda: suite("TestKernelReading"),
        "dropped": dropped,
        "late": late,
        "damaged": damaged,
        "region": region,
        "stale": stale,
        "refused": refused,
        "automatic": automatic,
        "mosaic": mosaic,
        "cable": cable,
        "same_settings": same_settings,
        "module": module,
        "other_number": other_number,
        "unplugged": unplugged,
    }
    run_scenarios(scenarios, sys.argv[2:])


if __name__ == "__main__":
    main()
