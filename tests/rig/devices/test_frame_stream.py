"""The camera's thread: a silent camera is reported, an unplugged one continues in the same record."""

import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import cast

import numpy as np
import pytest

from acquisition.camera import Camera, CameraSettings, CameraStatus, Frame
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.frames.losses import FrameLosses
from acquisition.frames.queue import Policy
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError
from rig.devices import frame_stream
from rig.devices.frame_stream import FrameStream, raise_if_slept, read_sleep_ns
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.rig.devices.streams import Driver, Run, frames_of
from tests.waiting import until

RATE_HZ = 100.0


def run_with(faults: FaultSettings, *, real_time: bool) -> Run:
    settings = SimulationSettings.model_validate({"real_time": real_time, "max_duration_s": 8.0})
    camera = SimulatedCamera(settings, faults)
    assert camera.open().has_clock
    asked = CameraSettings(width_px=64, height_px=64, offset_x_px=128, offset_y_px=288, frame_rate_hz=RATE_HZ)
    return Run(camera, asked, "drop" if real_time else "wait")


def scripted(driver: Driver) -> FrameStream:
    stream = FrameStream(cast(Camera, driver), CameraSettings(), timeout_s=5.0)
    assert stream.begin() is not None
    return stream


def test_a_silence_is_named_within_two_frame_times_and_half_a_second() -> None:
    camera = Driver(frames_of(100, silences=1))
    stream = scripted(camera)
    frames, deadline_s = 0, time.monotonic() + 30
    while not stream.drained and time.monotonic() < deadline_s:
        frames += len(stream.take(64, 0.1))
    stream.close()
    assert frames == 100
    assert [kind for kind, _ in stream.take_events()] == ["camera silent"]
    # the rest of the half second is the time that is left for saying it
    assert camera.asked_s[100] < 2 / RATE_HZ + 0.4


def test_who_waits_for_a_frame_is_given_it_as_soon_as_it_comes() -> None:
    """The camera makes one for each that was taken: the queue is empty whenever one comes."""
    make, taken = frames_of(100), threading.Semaphore(1)
    stream = scripted(Driver(lambda number: make(number) if taken.acquire() else None))
    for number in range(100):
        assert [frame.sequence for frame in stream.take(1, 30.0)] == [number]
        taken.release()
    stream.close()


class Hanging(Driver):
    """A driver whose first `read` does not return."""

    def __init__(self) -> None:
        super().__init__(frames_of(0))
        self.over, self.reads = threading.Event(), threading.Event()

    def read(self, timeout_s: float) -> object:
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
    # 540 MB in all
    stream = scripted(Driver(frames_of(1500, shape=(600, 600)), lost_by=lost_by))
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
    run = run_with(faults, real_time=True)
    run.until_number(220)
    run.close()
    # a busy machine may add a silence of its own
    assert run.kinds
    assert run.kinds == ["camera silent", "camera speaks"] * (len(run.kinds) // 2)


def test_unplugging_leaves_a_gap_of_the_right_length() -> None:
    faults = FaultSettings(camera_unplugged_at_s=0.5, camera_replugged_at_s=1.5)
    run = run_with(faults, real_time=False)
    run.until_number(250)
    run.close()
    lost, back = [(kind, text) for kind, text in run.texts if kind in ("camera lost", "camera back")]
    assert (lost[0], back[0]) == ("camera lost", "camera back")
    pairs = enumerate(itertools.pairwise(run.numbers))
    longest, index = max((later - earlier, index) for index, (earlier, later) in pairs)
    passed_ns = run.frames[index + 1].time_ns - run.frames[index].time_ns
    # the gap in the numbers is the gap in time, to half a frame
    assert longest == round(passed_ns * 1e-9 * RATE_HZ)
    assert longest >= 100
    assert "without frames" in back[1]
    assert run.stream.losses == FrameLosses(while_unplugged=longest - 1)


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


def test_a_stream_ends_at_a_camera_that_counts_in_another_unit() -> None:
    def eight_times_as_fast(number: int) -> Frame:
        device_ns = round(1e9 * number / RATE_HZ) + 100 * 10**9
        return Frame(np.zeros((2, 2), np.uint8), number, device_ns, device_ns // 8)

    stream = scripted(Driver(eight_times_as_fast))
    until(lambda: stream.end_reason)
    stream.close()
    assert "times as fast as the computer" in str(stream.failure)


@pytest.mark.parametrize(
    ("awake_s", "with_sleep_s", "said"),
    [(12.75, 12.75, ""), (0.02, 600.02, "slept for 600 s, in which its clock")],
)
def test_after_a_sleep_no_time_is_believed_but_after_a_standstill(
    awake_s: float, with_sleep_s: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept_ns = 7 * 10**9 + round((with_sleep_s - awake_s) * 1e9)
    monkeypatch.setattr(frame_stream, "read_sleep_ns", lambda: slept_ns)
    with pytest.raises(DeviceError, match=said) if said else nullcontext():
        raise_if_slept(7 * 10**9)


def test_the_clocks_agree_while_nothing_sleeps() -> None:
    assert abs(read_sleep_ns() - read_sleep_ns()) < 10**9
