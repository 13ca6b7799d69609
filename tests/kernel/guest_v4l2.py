"""Runs inside the guest: the conformance suite and faults against the kernel's vivid driver."""

import json
import os
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
import pytest

from acquisition.camera import Camera, CameraLost, CameraSettings, PixelFormat
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.camera import V4l2Camera
from acquisition.cameras.v4l2.devices import list_devices
from acquisition.cameras.v4l2.source import V4l2Settings
from tests.acquisition.camera_conformance import CameraConformance
from tests.kernel.boot import MARK

SMALL = CameraSettings(width_px=320, height_px=180)


def device() -> str:
    """The first vivid device that captures grey images."""
    return next(found.path for found in list_devices() if "vivid" in found.name and "GREY" in found.formats)


def make(reading: str = "kernel", **more: Any) -> V4l2Camera:
    return V4l2Camera(V4l2Settings.model_validate({"device": device(), "reading": reading, **more}))


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


class TestOpenCvReading(TestKernelReading):
    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = make("opencv")
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


def control(name: str, value: int) -> None:
    handle = kernel.open_device(device())
    number = next(there.number for there in kernel.controls(handle) if there.name == name)
    kernel.set_control(handle, number, value)
    os.close(handle)


def dropped() -> dict[str, Any]:
    """The driver drops a part of its buffers: what is missing is counted, the rest is in order."""
    control("Percentage of Dropped Buffers", 30)
    camera = make()
    camera.open()
    camera.configure(SMALL)
    camera.start()
    frames = [camera.read(5.0) for _ in range(60)]
    status = camera.status
    camera.close()
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


def stale(reading: str) -> dict[str, Any]:
    """After a second in which nobody read: is the first frame of the next start older than it?"""
    camera = make(reading)
    camera.open()
    camera.configure(SMALL)
    camera.start()
    camera.read(5.0)
    camera.stop()
    time.sleep(1.0)
    begin_ns = time.monotonic_ns()
    camera.start()
    frame = camera.read(5.0)
    camera.close()
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
    handle = kernel.open_device(device())
    said["gain set"] = str(kernel.get_control(handle, kernel.GAIN))
    os.close(handle)
    other.close()
    return said


def unplugged(reading: str) -> dict[str, Any]:
    """vivid's button 'Disconnect' while frames run."""
    camera = make(reading)
    name = device()
    camera.open()
    camera.configure(SMALL)
    camera.start()
    for _ in range(5):
        camera.read(5.0)
    control("Disconnect", 1)
    begin_s = time.monotonic()
    message = ""
    try:
        while time.monotonic() - begin_s < 15:
            camera.read(5.0)
    except CameraLost as lost:
        message = str(lost)
    noticed_s = time.monotonic() - begin_s
    stop_s = time.monotonic()
    camera.close()
    return {
        "device": name,
        "noticed_s": noticed_s,
        "message": message,
        "close_s": time.monotonic() - stop_s,
    }


def devices() -> dict[str, Any]:
    return {"found": [found._asdict() for found in list_devices()]}


def main() -> None:
    results: dict[str, Any] = {}
    scenarios: dict[str, Callable[[], dict[str, Any]]] = {
        "devices": devices,
        "kernel": lambda: suite("TestKernelReading"),
        "opencv": lambda: suite("TestOpenCvReading"),
        "dropped": dropped,
        "stale_kernel": lambda: stale("kernel"),
        "stale_opencv": lambda: stale("opencv"),
        "refused": refused,
        "unplugged": lambda: unplugged("kernel"),
    }
    for name, scenario in scenarios.items():
        begin_s = time.monotonic()
        try:
            results[name] = scenario()
        except BaseException:
            results[name] = {"error": traceback.format_exc()}
        results[name]["seconds"] = time.monotonic() - begin_s
        print(name, results[name], flush=True)
    print("\n" + MARK + json.dumps(results), flush=True)


if __name__ == "__main__":
    main()
