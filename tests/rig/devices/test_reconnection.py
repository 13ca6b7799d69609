"""At default settings an unplugged camera continues the run, whether or not its driver notices the loss.

libaravis has the same test in its own network (tests/acquisition/cameras/aravis/suite.py), the simulated rig
in test_frame_stream.py.
"""

import struct
import threading
import time
import warnings
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from acquisition.camera import CameraLost, CameraSettings, Frame, FrameTimeout
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.frames.losses import FrameLosses
from processing.errors import DeviceError
from rig.devices import frame_stream
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.rig.devices.streams import Run

pytestmark = pytest.mark.slow

ASKED = CameraSettings(width_px=32, height_px=32, frame_rate_hz=50.0, exposure_us=100.0)


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
) -> tuple[Run, VisionDevice]:
    """A run with a device that can be unplugged, in which another program has left its settings."""
    device = VisionDevice()
    camera = driver(backend=InProcessBackend(device))
    camera.open()
    camera.configure(ASKED)
    return Run(camera, asked), device


def emulated() -> tuple[Run, Any]:
    """Of pylon, whose emulation has no cable: what stands for it refuses to read and to open meanwhile."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("pypylon.pylon", reason="pypylon is not installed (optional extra 'pylon')")
    from acquisition.cameras.pylon import PylonCamera

    class Pulled(PylonCamera):
        is_pulled = False

        def open(self) -> Any:
            if self.is_pulled:
                raise DeviceError("pylon camera: there is none")
            return super().open()

        def read(self, timeout_s: float) -> Frame | None:
            if self.is_pulled:
                self._was_lost = True
                raise CameraLost("pylon camera: is no longer connected; plug it in again")
            return super().read(timeout_s)

        def unplug(self) -> None:
            self.is_pulled = True

        def plug(self) -> None:
            self.is_pulled = False

    camera = Pulled()
    camera.open()
    return Run(camera, CameraSettings(width_px=64, height_px=48, frame_rate_hz=100.0)), camera


@pytest.mark.parametrize("made", [plugged, partial(plugged, Unnoticing), emulated])
def test_a_run_goes_on_when_its_camera_comes_back(
    made: Callable[[], tuple[Run, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    run, device = made()
    run.more()
    device.unplug()
    run.until(lambda: "camera lost" in run.kinds)
    device.plug()
    run.more(kind="camera back")
    run.close()
    assert run.stream.losses.while_unplugged > 0
    assert run.camera.status.reconnects == 1


@pytest.mark.parametrize("refused", [False, True])
def test_one_that_has_lost_its_power_makes_the_same_images_again_or_ends_the_run(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was asked for, so that the camera kept what it had, which it has no more."""
    run, device = plugged(asked=CameraSettings())
    run.more()
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
    device.plug()
    if refused:
        run.until(lambda: run.stream.failure is not None)
    else:
        run.more(kind="camera back")
    run.close(failed=refused)
    said = "; ".join(text for kind, text in run.texts if kind == "camera back")
    assert ("with other settings: camera.exposure_us = 100.0 was requested" in said) is refused
    assert ("other settings" in said) is refused
    if refused:
        # a position in them has nothing to do with one in those before
        assert "has 640 x 480 pixels of uint8, those before had 32 x 32" in str(run.stream.failure)
    assert {frame.image.shape for frame in run.frames} == {(32, 32)}


def test_a_run_goes_on_when_its_camera_resets_itself_on_the_bus() -> None:
    """Ids and clock begin again and nothing is plugged in: a few frames are discarded, and counted."""
    run, device = plugged()
    run.more(100)
    device.reset()
    run.until(lambda: "camera back" in run.kinds)
    run.more()
    steps = run.stream.take_clock_steps()
    # a machine that stands still makes the camera lose some besides
    run.close()
    assert run.stream.losses.wrong_id == 3
    assert run.stream.losses.while_unplugged > 0
    assert len(steps) == 1
    assert steps[0].step_ns < -1_000_000_000
    times = [frame.device_time_ns for frame in run.frames]
    hosts = [frame.host_time_ns for frame in run.frames]
    assert all(later > earlier for earlier, later in pairwise(times))
    # the line follows the computer's clock over the gap, in which the camera's went back by seconds
    assert abs((times[-1] - times[0]) - (hosts[-1] - hosts[0])) < 1_000_000_000


def test_frames_with_an_error_status_alone_are_said_with_their_reason_and_survived() -> None:
    run, device = plugged()
    run.more()
    device.faults.units = lambda kind, block, data: [
        data[:16] + struct.pack("<H", 0xA001) + data[18:] if kind == "trailer" else data
    ]
    run.until(lambda: "camera silent" in run.kinds)
    device.faults.units = lambda kind, block, data: [data]
    run.more()
    run.close()
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
    run.more()
    assert isinstance(run.camera, Silent)
    run.camera.is_silent = True
    run.stream._timeout_s = 1.5
    run.until(lambda: run.stream.drained)
    run.close(failed=True)
    assert run.stream.end_reason == "no frame for 1.5 s: the camera has stalled"
    assert run.kinds == ["camera silent", "camera lost", "camera silent"]
    assert run.camera.opened == 2


def test_one_that_does_not_come_back_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_stream, "_RECONNECT_S", 1.0)
    run, device = plugged()
    run.more()
    device.unplug()
    run.until(lambda: run.stream.drained)
    run.close(failed=True)
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
    run = Run(camera, CameraSettings(), "wait")
    run.more(40)
    share.rename(tmp_path / "gone")
    run.until(lambda: "camera lost" in run.kinds)
    (tmp_path / "gone").rename(share)
    run.until(lambda: run.stream.drained)
    run.texts += run.stream.take_events()
    run.close()
    assert run.kinds == ["camera lost", "camera back"]
    assert run.numbers == [int(frame.image[0, 0]) for frame in run.frames] == list(range(count))
    times_ns = [frame.device_time_ns for frame in run.frames]
    assert {later - earlier for earlier, later in pairwise(times_ns)} == {20_000_000}
    assert run.stream.losses == FrameLosses()
