"""At default settings an unplugged camera continues the run, whether or not its driver notices the loss.

libaravis has the same test in its own network (tests/acquisition/cameras/aravis/suite.py), the simulated rig
in test_frame_stream.py.
"""

import struct
import threading
import time
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition.camera import Camera, CameraInfo, CameraLost, CameraSettings, Frame, FrameTimeout
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.frames.losses import FrameLosses
from processing.errors import DeviceError
from rig.devices.frame_stream import FrameStream
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice

pytestmark = pytest.mark.slow

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


def plugged(
    driver: type[Usb3VisionCamera] = Usb3VisionCamera, asked: CameraSettings = ASKED
) -> tuple["Run", VisionDevice]:
    """A run with a device that can be unplugged, in which another program has left its settings."""
    device = VisionDevice()
    camera = driver(backend=InProcessBackend(device))
    camera.open()
    camera.configure(ASKED)
    return Run(camera, asked), device


class Run:
    """A stream at default settings, and what came out of it."""

    def __init__(self, camera: Camera, asked: CameraSettings = ASKED) -> None:
        self.camera = camera
        self.stream = FrameStream(self.camera, asked, applied=self.camera.configure(asked))
        self.stream.start_camera()
        assert self.stream.begin() is not None
        self.frames: list[Frame] = []
        self.kinds: list[str] = []
        self.texts: list[tuple[str, str]] = []

    def until(self, reached: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + WITHIN_S
        while not reached():
            assert time.monotonic() < deadline_s, (self.kinds, self.stream.end_reason)
            self.frames += self.stream.take(64, 0.1)
            self.texts += self.stream.take_events()
            self.kinds = [kind for kind, _ in self.texts]

    def close(self) -> None:
        self.stream.close()
        self.camera.close()


@pytest.mark.parametrize("driver", [Usb3VisionCamera, Unnoticing])
def test_a_run_goes_on_when_its_camera_comes_back(driver: type[Usb3VisionCamera]) -> None:
    run, device = plugged(driver)
    run.until(lambda: len(run.frames) > 20)
    device.unplug()
    run.until(lambda: "camera lost" in run.kinds)
    before = len(run.frames)
    delivered = run.camera.status.delivered
    device.plug()
    run.until(lambda: "camera back" in run.kinds and len(run.frames) > before + 20)
    run.close()
    assert run.stream.failure is None
    numbers = [frame.sequence for frame in run.frames]
    assert numbers == sorted(set(numbers))
    assert run.stream.losses.while_unplugged > 0
    assert numbers[-1] + 1 - len(numbers) == run.stream.losses.total
    assert delivered >= 20


@pytest.mark.parametrize("refused", [False, True])
def test_one_that_has_lost_its_power_makes_the_same_images_again_or_ends_the_run(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was asked for, so that the camera kept what it had, which it has no more."""
    run, device = plugged(asked=CameraSettings())
    run.until(lambda: len(run.frames) > 20)
    device.unplug()
    run.until(lambda: "camera lost" in run.kinds)
    fresh = VisionDevice()
    for place in (layout.WIDTH, layout.HEIGHT, layout.EXPOSURE_TICKS):
        device.poke(place, fresh.peek(place))
    configure = run.camera.configure

    def configured(settings: CameraSettings) -> CameraSettings:
        if refused and settings.exposure_us is not None:
            raise DeviceError("the exposure cannot be set")
        return configure(settings)

    monkeypatch.setattr(run.camera, "configure", configured)
    before = len(run.frames)
    device.plug()
    if refused:
        run.until(lambda: run.stream.failure is not None)
    else:
        run.until(lambda: "camera back" in run.kinds and len(run.frames) > before + 20)
    run.close()
    said = "; ".join(text for kind, text in run.texts if kind == "camera back")
    if refused:
        assert "with other settings: camera.exposure_us = 100.0 was requested" in said
        # a position in them has nothing to do with one in those before
        assert "has 640 x 480 pixels of uint8, those before had 32 x 32" in str(run.stream.failure)
    else:
        assert run.stream.failure is None
        assert "other settings" not in said
    assert {frame.image.shape for frame in run.frames} == {(32, 32)}


def test_a_run_goes_on_when_its_camera_resets_itself_on_the_bus() -> None:
    """Ids and clock begin again and nothing is plugged in: a few frames are discarded, and counted."""
    run, device = plugged()
    run.until(lambda: len(run.frames) > 100)
    device.reset()
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
    assert losses.while_unplugged > 0
    # a machine that stands still makes the camera lose some besides
    assert numbers[-1] + 1 - len(numbers) == losses.total
    assert len(steps) == 1
    assert steps[0].step_ns < -1_000_000_000
    times = [frame.device_time_ns for frame in run.frames]
    hosts = [frame.host_time_ns for frame in run.frames]
    assert all(later > earlier for earlier, later in pairwise(times))
    # the line follows the computer's clock over the gap, in which the camera's went back by seconds
    assert abs((times[-1] - times[0]) - (hosts[-1] - hosts[0])) < 1_000_000_000


def test_frames_with_an_error_status_alone_are_said_with_their_reason_and_survived() -> None:
    run, device = plugged()
    run.until(lambda: len(run.frames) > 50)
    device.faults.units = lambda kind, block, data: [
        data[:16] + struct.pack("<H", 0xA001) + data[18:] if kind == "trailer" else data
    ]
    run.until(lambda: "camera silent" in run.kinds)
    before = len(run.frames)
    device.faults.units = lambda kind, block, data: [data]
    run.until(lambda: len(run.frames) > before + 20)
    run.close()
    assert run.stream.failure is None
    assert run.stream.losses.error_status > 5
    said = dict(run.texts)["camera silent"]
    assert "no usable frame; of those that came" in said
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

    run, _ = plugged(Silent)
    run.until(lambda: len(run.frames) > 20)
    assert isinstance(run.camera, Silent)
    run.camera.is_silent = True
    run.stream._timeout_s = 1.5
    run.until(lambda: run.stream.drained)
    run.close()
    assert run.stream.end_reason == "no frame for 1.5 s: the camera has stalled"
    assert run.kinds == ["camera silent", "camera lost", "camera silent"]
    assert run.camera.opened == 2


def test_one_that_does_not_come_back_is_named() -> None:
    run, device = plugged()
    run.stream._reconnect_s = 1.0
    run.until(lambda: len(run.frames) > 20)
    device.unplug()
    run.until(lambda: run.stream.drained)
    run.close()
    assert isinstance(run.stream.failure, DeviceError)
    assert "plug it in again; it could not be reopened within 1 s" in str(run.stream.failure)


def test_frames_of_a_share_that_was_gone_go_on_where_they_were(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    count = 200
    for number in range(count):
        assert cv2.imwrite(str(share / f"{number:04}.png"), np.full((8, 8), number, np.uint8))
    camera = FilesCamera(FilesSettings(path=share, frame_rate_hz=50.0))
    camera.open()
    camera.configure(CameraSettings())
    stream = FrameStream(camera, CameraSettings(), policy="wait")
    stream.start_camera()
    assert stream.begin() is not None
    frames, kinds = [], []
    gone = tmp_path / "gone"
    deadline_s = time.monotonic() + WITHIN_S
    while not stream.drained:
        assert time.monotonic() < deadline_s, (kinds, stream.end_reason)
        frames += stream.take(8, 0.1)
        kinds += [kind for kind, _ in stream.take_events()]
        if len(frames) > 40 and not kinds and not gone.exists():
            share.rename(gone)
        if "camera lost" in kinds and gone.exists():
            gone.rename(share)
    kinds += [kind for kind, _ in stream.take_events()]
    stream.close()
    assert stream.failure is None
    assert kinds == ["camera lost", "camera back"]
    assert [frame.sequence for frame in frames] == list(range(count))
    assert [int(frame.image[0, 0]) for frame in frames] == list(range(count))
    assert {later - earlier for earlier, later in pairwise(frame.device_time_ns for frame in frames)} == {
        20_000_000
    }
    assert stream.losses == FrameLosses()


def test_an_emulated_camera_of_pylon_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The emulation has no cable: what stands for it refuses to read and to open meanwhile."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("pypylon.pylon", reason="pypylon is not installed (optional extra 'pylon')")
    from acquisition.cameras.pylon import PylonCamera

    monkeypatch.setenv("PYLON_CAMEMU", "1")

    class Pulled(PylonCamera):
        is_pulled = False

        def open(self) -> CameraInfo:
            if self.is_pulled:
                raise DeviceError("pylon camera: there is none")
            return super().open()

        def read(self, timeout_s: float) -> Frame | None:
            if self.is_pulled:
                self._was_lost = True
                raise CameraLost("pylon camera: is no longer connected; plug it in again")
            return super().read(timeout_s)

    camera, asked = Pulled(), CameraSettings(width_px=64, height_px=48, frame_rate_hz=100.0)
    camera.open()
    run = Run(camera, asked)
    run.until(lambda: len(run.frames) > 20)
    camera.is_pulled = True
    run.until(lambda: "camera lost" in run.kinds)
    before = len(run.frames)
    camera.is_pulled = False
    run.until(lambda: "camera back" in run.kinds and len(run.frames) > before + 20)
    run.close()
    assert run.stream.failure is None
    numbers = [frame.sequence for frame in run.frames]
    assert numbers == sorted(set(numbers))
    assert camera.status.reconnects == 1
    assert numbers[-1] + 1 - len(numbers) == run.stream.losses.total
