"""The camera's thread: a silent camera is reported, an unplugged one continues in the same record."""

import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import cast

import numpy as np
import pytest

from acquisition.camera import Camera, CameraInfo, CameraSettings, CameraStatus, Frame, FrameTimeout
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.frames.losses import FrameLosses
from acquisition.frames.queue import Policy
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError
from rig.devices.frame_stream import FrameStream, SleepWatch, read_sleep_ns
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.waiting import until

RATE_HZ = 100.0


def stream_of(faults: FaultSettings, *, real_time: bool) -> FrameStream:
    settings = SimulationSettings.model_validate({"real_time": real_time, "max_duration_s": 8.0})
    camera: Camera = SimulatedCamera(settings, faults)
    info: CameraInfo = camera.open()
    assert info.has_clock
    asked = CameraSettings(width_px=64, height_px=64, offset_x_px=128, offset_y_px=288, frame_rate_hz=RATE_HZ)
    camera.configure(asked)
    camera.start()
    policy = "drop" if real_time else "wait"
    return FrameStream(camera, asked, policy=policy, reconnect_s=10.0)


def drain(stream: FrameStream, last: int) -> tuple[list[Frame], list[tuple[str, str]]]:
    """Frames up to this number or to the end, and events."""
    frames: list[Frame] = []
    events: list[tuple[str, str]] = []
    assert stream.begin() is not None
    deadline_s = time.monotonic() + 60.0
    while not stream.drained and not (frames and frames[-1].sequence >= last):
        assert time.monotonic() < deadline_s, f"no frame {last}, no end"
        frames += stream.take(64, 0.02)
        events += stream.take_events()
    return frames, events


class ScriptedCamera:
    """Frames by its own clock, then silence for as long as it is asked, then its end; it never waits."""

    def __init__(self, frames: int, silences: int, lost_by: CameraStatus | None = None) -> None:
        self._frames = frames
        self._silences = silences
        self.status = lost_by or CameraStatus()
        self.asked_s: list[float] = []
        self.shape = (2, 2)

    def read(self, timeout_s: float) -> Frame | None:
        if self._frames:
            self._frames -= 1
            number = 1000 - self._frames
            return Frame(np.zeros(self.shape, np.uint8), number, round(number / RATE_HZ * 1e9), number)
        if self._silences:
            self._silences -= 1
            self.asked_s.append(timeout_s)
            raise FrameTimeout("no frame")
        return None

    def stop(self) -> None:
        pass


def scripted(camera: ScriptedCamera, policy: Policy = "drop") -> FrameStream:
    stream = FrameStream(cast(Camera, camera), CameraSettings(), policy=policy, timeout_s=5.0)
    assert stream.begin() is not None
    return stream


def test_a_silence_is_named_within_two_frame_times_and_half_a_second() -> None:
    camera = ScriptedCamera(frames=100, silences=1)
    stream = scripted(camera)
    frames, deadline_s = 0, time.monotonic() + 30
    while not stream.drained and time.monotonic() < deadline_s:
        frames += len(stream.take(64, 0.1))
    stream.close()
    assert frames == 100
    assert [kind for kind, _ in stream.take_events()] == ["camera silent"]
    # the rest of the half second is the time that is left for saying it
    assert camera.asked_s[0] < 2 / RATE_HZ + 0.4


def test_who_waits_for_a_frame_is_given_it_as_soon_as_it_comes() -> None:
    """The camera makes one for each that was taken: the queue is empty whenever one comes."""
    camera, taken = ScriptedCamera(100, silences=0), threading.Semaphore(1)
    read = camera.read
    camera.read = lambda timeout_s: read(timeout_s) if taken.acquire() else None  # type: ignore[method-assign]
    stream = scripted(camera)
    for number in range(901, 1001):
        assert [frame.sequence for frame in stream.take(1, 30.0)] == [number]
        taken.release()
    stream.close()


class Hanging(ScriptedCamera):
    """A driver whose first `read` does not return."""

    def __init__(self) -> None:
        super().__init__(0, 0)
        self.over, self.reads = threading.Event(), threading.Event()

    def read(self, timeout_s: float) -> Frame | None:
        self.reads.set()
        self.over.wait()
        self.reads.clear()
        return None

    def stop(self) -> None:
        """The driver's `read` returns some time later."""
        threading.Timer(0.2, self.over.set).start()


@pytest.mark.parametrize("policy", ["drop", "wait"])
def test_a_first_read_that_never_returns_can_be_stopped_and_is_waited_for(policy: Policy) -> None:
    camera = Hanging()
    stream = FrameStream(cast(Camera, camera), CameraSettings(), policy=policy)
    with ThreadPoolExecutor(1) as beginning:
        begun = beginning.submit(stream.begin)
        assert camera.reads.wait(30.0)
        stream.request_stop()
        assert begun.result(30.0) is None
    assert camera.reads.is_set()
    # when nobody reads any more
    stream.close()
    assert not camera.reads.is_set()


def test_losses_are_told_apart() -> None:
    lost_by = CameraStatus(dropped_by_camera=1, dropped_by_bus=2, dropped_by_host=3, incomplete=4)
    camera = ScriptedCamera(frames=1500, silences=0, lost_by=lost_by)
    camera.shape = (600, 600)  # 540 MB in all
    stream = scripted(camera)
    deadline_s = time.monotonic() + 30
    while not stream.end_reason and time.monotonic() < deadline_s:
        time.sleep(0.01)
    # nobody took the frames: the queue held what it could, the rest is ours to answer for
    kept = len(stream)
    assert 0 < kept < 1500
    assert stream.losses == FrameLosses(1, 2, 3 + 1500 - kept, 4, 0)
    assert stream.losses.since(FrameLosses(by_bus=2)).total == stream.losses.total - 2
    stream.close()


def test_a_silent_stall_is_named_and_the_stream_goes_on() -> None:
    faults = FaultSettings(frames_stalled_at_s=0.5, frames_stalled_duration_s=1.5)
    stream = stream_of(faults, real_time=True)
    frames, events = drain(stream, 220)
    stream.close()
    # a busy machine may add a silence of its own
    kinds = [kind for kind, _ in events]
    assert kinds
    assert kinds == ["camera silent", "camera speaks"] * (len(kinds) // 2)
    assert frames[-1].sequence >= 220, "the stream goes on after it"
    assert stream.failure is None


def test_unplugging_leaves_a_gap_of_the_right_length() -> None:
    faults = FaultSettings(camera_unplugged_at_s=0.5, camera_replugged_at_s=1.5)
    stream = stream_of(faults, real_time=False)
    frames, events = drain(stream, 250)
    stream.close()
    lost, back = [(kind, text) for kind, text in events if kind in ("camera lost", "camera back")]
    assert (lost[0], back[0]) == ("camera lost", "camera back")
    numbers = [frame.sequence for frame in frames]
    steps = [(later - earlier, index) for index, (earlier, later) in enumerate(itertools.pairwise(numbers))]
    longest, index = max(steps)
    passed_ns = frames[index + 1].time_ns - frames[index].time_ns
    # the gap in the numbers is the gap in time, to half a frame
    assert longest == round(passed_ns * 1e-9 * RATE_HZ)
    assert longest >= 100
    assert "without frames" in back[1]
    assert stream.losses == FrameLosses(while_unplugged=longest - 1)


def test_what_a_stalled_consumer_leaves_is_the_hosts_loss_and_nothing_is_missing_from_the_sum() -> None:
    """The one thread goes on reading: neither camera nor bus has to answer for the consumer."""
    device = VisionDevice(frames_inside=100_000)
    camera = Usb3VisionCamera(backend=InProcessBackend(device))
    camera.open()
    asked = CameraSettings(width_px=640, height_px=480, frame_rate_hz=1000.0, exposure_us=20.0)
    camera.configure(asked)
    before = threading.active_count()
    stream = FrameStream(camera, asked)
    stream.start_camera()
    assert stream.begin() is not None
    # the one that reads, and the one that notices when all of them stand still
    assert threading.active_count() == before + 1
    until(lambda: stream.losses.by_host > 100)
    stream.close()
    frames = stream.take(10_000, 0.0)
    assert [frame.sequence for frame in frames] == list(range(len(frames)))
    status = camera.status
    assert status.dropped == 0
    lost = stream.losses
    assert lost.total == lost.by_host
    # the frame that was being read when the stream was closed is in neither
    assert status.delivered - len(frames) - lost.by_host in (0, 1)
    camera.close()


class EightTimesAsFast(ScriptedCamera):
    def read(self, timeout_s: float) -> Frame | None:
        frame = super().read(timeout_s)
        if frame is None:
            return None
        device_ns = frame.device_time_ns + 100 * 10**9
        return frame._replace(device_time_ns=device_ns, host_time_ns=device_ns // 8)


def test_a_stream_ends_at_a_camera_that_counts_in_another_unit() -> None:
    stream = scripted(EightTimesAsFast(frames=9000, silences=0))
    until(lambda: stream.end_reason)
    stream.close()
    assert "times as fast as the computer" in str(stream.failure)


@pytest.mark.parametrize(
    ("awake_s", "with_sleep_s", "said"),
    [(12.75, 12.75, ""), (0.02, 600.02, "slept for 600 s, in which its clock")],
)
def test_after_a_sleep_no_time_is_believed_but_after_a_standstill(
    awake_s: float, with_sleep_s: float, said: str
) -> None:
    slept_ns = iter([7 * 10**9, 7 * 10**9 + round((with_sleep_s - awake_s) * 1e9)])
    watch = SleepWatch(lambda: next(slept_ns))
    with pytest.raises(DeviceError, match=said) if said else nullcontext():
        watch.raise_if_slept()


def test_the_clocks_agree_while_nothing_sleeps() -> None:
    assert abs(read_sleep_ns() - read_sleep_ns()) < 10**9
