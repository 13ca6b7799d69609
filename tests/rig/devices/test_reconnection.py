"""At default settings an unplugged camera continues the run, whether or not its driver notices the loss.

libaravis has the same test in its own network (tests/acquisition/cameras/aravis/suite.py), the simulated rig
in test_frame_stream.py.
"""

import struct
import threading
import time
from collections.abc import Callable
from itertools import pairwise

import pytest

from acquisition.camera import CameraLost, CameraSettings, FrameTimeout
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.frame import Frame
from processing.errors import DeviceError
from rig.devices.frame_stream import FrameStream
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

ASKED = CameraSettings(width_px=32, height_px=32, frame_rate_hz=50.0, exposure_us=100.0)
WITHIN_S = 60.0


class Unnoticing(Usb3VisionCamera):
    """A driver to which an unplugged camera is a silent one."""

    def read(self, timeout_s: float) -> Frame | None:
        begun_s = time.monotonic()
        try:
            return super().read(timeout_s)
        except CameraLost:
            threading.Event().wait(max(begun_s + timeout_s - time.monotonic(), 0.0))
            raise FrameTimeout(f"no frame within {timeout_s:g} s") from None


class Run:
    """A stream at default settings, and what came out of it."""

    def __init__(self, driver: type[Usb3VisionCamera]) -> None:
        self.device = VisionDevice()
        self.camera = driver(backend=InProcessBackend(self.device))
        self.camera.open()
        self.camera.configure(ASKED)
        self.stream = FrameStream(self.camera, ASKED)
        self.stream.start_camera()
        assert self.stream.begin() is not None
        self.frames: list[Frame] = []
        self.kinds: list[str] = []
        self.texts: list[tuple[str, str]] = []

    def until(self, reached: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + WITHIN_S
        while not reached():
            assert time.monotonic() < deadline_s, (self.kinds, self.stream.ended)
            self.frames += self.stream.take(64, 0.1)
            self.texts += self.stream.take_events()
            self.kinds = [kind for kind, _ in self.texts]

    def close(self) -> None:
        self.stream.close()
        self.camera.close()


@pytest.mark.parametrize("driver", [Usb3VisionCamera, Unnoticing])
def test_a_run_goes_on_when_its_camera_comes_back(driver: type[Usb3VisionCamera]) -> None:
    run = Run(driver)
    run.until(lambda: len(run.frames) > 20)
    run.device.unplug()
    run.until(lambda: "camera lost" in run.kinds)
    before = len(run.frames)
    delivered = run.camera.status.delivered
    run.device.plug()
    run.until(lambda: "camera back" in run.kinds and len(run.frames) > before + 20)
    run.close()
    assert run.stream.failure is None
    numbers = [frame.sequence for frame in run.frames]
    assert numbers == sorted(set(numbers))
    assert run.stream.losses.while_unplugged > 0
    assert numbers[-1] + 1 - len(numbers) == run.stream.losses.total
    assert delivered >= 20


def test_a_run_goes_on_when_its_camera_resets_itself_on_the_bus() -> None:
    """Ids and clock begin again and nothing is plugged in: a few frames are discarded, and counted."""
    run = Run(Usb3VisionCamera)
    run.until(lambda: len(run.frames) > 100)
    run.device.reset()
    run.until(lambda: "camera back" in run.kinds)
    before = len(run.frames)
    run.until(lambda: len(run.frames) > before + 50)
    steps = run.stream.take_clock_steps()
    run.close()
    assert run.stream.failure is None
    losses = run.stream.losses
    assert losses.wrong_id == 3
    numbers = [frame.sequence for frame in run.frames]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] + 1 - len(numbers) == losses.total == losses.while_unplugged
    assert len(steps) == 1
    assert steps[0].step_ns < -1_000_000_000
    times = [frame.device_time_ns for frame in run.frames]
    hosts = [frame.host_time_ns for frame in run.frames]
    assert all(later > earlier for earlier, later in pairwise(times))
    # the line follows the computer's clock over the gap
    assert abs((times[-1] - times[0]) - (hosts[-1] - hosts[0])) < 100_000_000


def test_frames_with_an_error_status_alone_are_said_with_their_reason_and_survived() -> None:
    run = Run(Usb3VisionCamera)
    run.until(lambda: len(run.frames) > 50)
    run.device.faults.units = lambda kind, block, data: [
        data[:16] + struct.pack("<H", 0xA001) + data[18:] if kind == "trailer" else data
    ]
    run.until(lambda: "camera silent" in run.kinds)
    before = len(run.frames)
    run.device.faults.units = lambda kind, block, data: [data]
    run.until(lambda: len(run.frames) > before + 20)
    run.close()
    assert run.stream.failure is None
    assert run.stream.losses.error_status > 5
    said = dict(run.texts)["camera silent"]
    assert "no frame that can be used; of those that came" in said
    assert "with an error status" in said
    assert "trigger" not in said


def test_one_that_is_there_and_stays_silent_is_opened_again_once() -> None:
    class Silent(Unnoticing):
        opened = 0
        is_silent = False

        def open(self) -> object:  # type: ignore[override]
            self.opened += 1
            return super().open()

        def read(self, timeout_s: float) -> Frame | None:
            if self.is_silent:
                threading.Event().wait(timeout_s)
                raise FrameTimeout(f"no frame within {timeout_s:g} s")
            return super().read(timeout_s)

    run = Run(Silent)
    run.until(lambda: len(run.frames) > 20)
    assert isinstance(run.camera, Silent)
    run.camera.is_silent = True
    run.until(lambda: run.stream.drained)
    run.close()
    assert run.stream.ended == "no frame for 5 s: the camera has stalled"
    assert run.kinds == ["camera silent", "camera lost", "camera silent"]
    assert run.camera.opened == 2


def test_one_that_does_not_come_back_is_named() -> None:
    run = Run(Usb3VisionCamera)
    run.stream._reconnect_s = 1.0
    run.until(lambda: len(run.frames) > 20)
    run.device.unplug()
    run.until(lambda: run.stream.drained)
    run.close()
    assert isinstance(run.stream.failure, DeviceError)
    assert "plug it in again; it was not to be opened again within 1 s" in str(run.stream.failure)
