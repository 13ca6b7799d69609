"""What a driver delivers that no camera may: one clear line, whatever it is."""

import re
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus, Frame, FrameTimeout
from acquisition.frames.guard import (
    CameraCounts,
    ClockCheck,
    FrameChecks,
    ReadMonitor,
    check_info,
    driver_errors,
    end_within,
)
from processing.errors import DeviceError
from rig.devices import Devices, OpenCamera, find_exposure, frame_stream
from rig.devices.frame_stream import FrameStream
from rig.settings import validate_configuration
from tests.rig.devices.streams import Driver, frames_of


def frame(number: int = 0, ny: int = 12, nx: int = 10, **instead: Any) -> Frame:
    image = np.full((ny, nx), number, np.uint8)
    return Frame(image, number, device_time_ns=1000 * number, host_time_ns=1000 * number + 5)._replace(
        **instead
    )


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (frame(1).image, r"read\(\) returned ndarray; return a Frame"),
        (tuple(frame(1)), r"read\(\) returned tuple"),
        (frame(1, image=[[1, 2], [3, 4]]), "image of frame 1 is list; make it a numpy array"),
        (frame(1, image=np.ones((12, 10))), r"shape \(12, 10\) and type float64; \(ny, nx\)"),
        (frame(1, image=np.ones((12, 10, 3), np.uint8)), r"shape \(12, 10, 3\)"),
        (frame(1, image=np.ones((12, 10), ">u2" if np.little_endian else "<u2")), "order of bytes"),
        (frame(1, image=np.ones((12, 10), np.uint16)), "10 x 12 pixels of uint16, .* of uint8"),
        (frame(1, nx=8), "frame 1 has 8 x 12 pixels of uint8, those before had 10 x 12"),
        (frame(0), "frame 0 came after frame 0; number the frames upwards"),
        (frame(1, device_time_ns=1000.5), r"device_time_ns of a frame is 1000.5 \(float\)"),
        (frame(1, host_time_ns=None), r"host_time_ns of a frame is None \(NoneType\)"),
        (frame(1, sequence=np.uint64(1 << 63)), "sequence of a frame is .*9223372036854775808"),
    ],
)
def test_what_no_camera_may_deliver(second: object, said: str) -> None:
    delivered = FrameChecks()
    delivered.check(frame(0))
    with pytest.raises(DeviceError, match=said) as raised:
        delivered.check(second)
    assert "\n" not in str(raised.value)


def test_a_time_of_day_is_no_time_of_arrival() -> None:
    delivered = FrameChecks(in_real_time=True)
    with pytest.raises(DeviceError, match=r"host_time_ns of frame 0 is .* s from now; .*monotonic_ns"):
        delivered.check(frame(0, host_time_ns=time.time_ns()))
    delivered.check(frame(1, host_time_ns=time.monotonic_ns()))


@pytest.mark.parametrize(("buffers", "first"), [(1, 0), (1, 3), (2, 0), (4, 0)])
def test_a_ring_of_buffers_is_found_as_one_buffer_is(buffers: int, first: int) -> None:
    """Frames whose times are in doubt wait for others, and would be overwritten; also behind a gap."""
    delivered, ring = FrameChecks(), np.zeros((buffers, 480, 160), np.uint8)
    for number in range(buffers):
        ring[number] = 50 + number
        delivered.check(frame(first + number, image=ring[number]))
    ring[0] = 7
    with pytest.raises(
        DeviceError, match=rf"image of frame {first} has changed since it was delivered.*copy"
    ):
        delivered.check(frame(3 * first + buffers, image=ring[0]))


def test_numbers_of_numpy_become_plain_ones_and_the_same_image_may_come_again() -> None:
    delivered, still = FrameChecks(), np.zeros((480, 160), np.uint16)
    for number in range(3):
        times: Any = np.int32(number), np.uint64(number), np.int64(number)
        found = delivered.check(Frame(still, *times))
        assert [type(value) for value in found[1:]] == [int, int, int]
    delivered.restart()
    assert delivered.check(Frame(still, 0, -1, 3)).sequence == 0


def clock_at(rate: float, late_s: float = 0.0) -> list[Frame]:
    """15 s of frames with a clock at this rate, on a computer that lags for a while and catches up."""
    number = np.arange(1500)
    lag_s = late_s * np.interp(number, [100, 250, 300], [0, 1, 0])
    host_s = number / 100.0 + np.random.default_rng(1).exponential(1e-4, 1500) + lag_s
    times_ns = np.rint(1e9 * np.column_stack((rate * number / 100.0, host_s))).astype(np.int64).tolist()
    image = np.zeros((2, 2), np.uint8)
    return [Frame(image, i, device, host) for i, (device, host) in enumerate(times_ns)]


@pytest.mark.parametrize(
    ("rate", "late_s", "refused"),
    [
        (8.0, 0.0, True),
        (1.002, 0.0, True),
        (0.5, 0.0, True),
        (1.0, 0.0, False),
        (1.0005, 0.0, False),
        (1.0, 0.4, False),
    ],
)
def test_a_clock_that_cannot_be_right_is_refused_and_a_computer_that_lags_is_not(
    rate: float, late_s: float, refused: bool
) -> None:
    watch = ClockCheck()
    with pytest.raises(DeviceError, match="times as fast as the computer's") if refused else nullcontext():
        for one in clock_at(rate, late_s):
            watch.see(one)


def test_the_stream_ends_with_what_was_wrong() -> None:
    driver = Driver(lambda number: frame(number, nx=10 if number < 20 else 9))
    stream = FrameStream(driver, CameraSettings(), policy="wait")  # type: ignore[arg-type]
    stream.start_camera()
    stream.begin()
    taken = 0
    while not stream.drained:
        taken += len(stream.take(64, 0.1))
    stream.close()
    assert taken == 20
    assert isinstance(stream.failure, DeviceError)
    assert "frame 20 has 9 x 12 pixels" in stream.end_reason


INFO = CameraInfo("own", "Example", "Own", "1", 10, 12, 255, has_clock=True)
ONE_BUFFER = np.zeros((12, 10), np.uint8)


def again(number: int) -> Frame:
    ONE_BUFFER[:] = number
    return frame(number, image=ONE_BUFFER)


def test_the_search_of_an_exposure_takes_no_such_frame() -> None:
    with pytest.raises(DeviceError, match="the image of frame 0 has changed since it was delivered"):
        find_exposure(Driver(again), INFO, CameraSettings(exposure_us=100.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("info", "said"),
    [
        (None, "returned NoneType; return a CameraInfo"),
        (replace(INFO, full_scale_dn=0), "full_scale_dn .* 0"),
    ],
)
def test_what_is_opened_says_what_it_is(info: object, said: str) -> None:
    assert check_info(INFO, "own") is INFO
    with pytest.raises(DeviceError, match=said):
        check_info(info, "own")


def test_counts_that_cannot_be_told_any_more_end_no_run() -> None:
    told: list[object] = [CameraStatus(delivered=3), None, None]
    counts = CameraCounts(lambda: told.pop(0))
    assert [counts.latest.delivered for _ in range(3)] == [3, 3, 3]
    assert "status is NoneType" in counts.take_remark()
    assert not counts.take_remark()


def test_a_camera_that_does_not_end_holds_nothing_up() -> None:
    let_go = Event()

    def failing() -> None:
        raise ValueError("no such\nhandle")

    assert not end_within(lambda: None, "own: close()")
    assert end_within(failing, "own: close()") == "own: close() failed: ValueError: no such handle"
    said = end_within(let_go.wait, "own: close()", timeout_s=0.01)
    let_go.set()
    assert said == "own: close() has not returned for 0.01 s, and is left to itself"


def test_what_a_driver_raises_is_one_line() -> None:
    with (
        pytest.raises(DeviceError, match=r"^own: start\(\) failed: KeyError: 'gain'$"),
        driver_errors("own", "start()"),
    ):
        raise KeyError("gain")


@pytest.mark.parametrize("count", [0, 6])
def test_a_read_that_never_returns_ends_the_stream(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(frame_stream, "ReadMonitor", partial(ReadMonitor, grace_s=0.2))
    let_go = Event()

    def make(number: int) -> object:
        if number >= count:
            let_go.wait(60.0)
            return None
        return frame(number)._replace(host_time_ns=time.monotonic_ns())

    stream = FrameStream(Driver(make), CameraSettings(), timeout_s=0.2)  # type: ignore[arg-type]
    stream.start_camera()
    taken = 0
    with suppress(DeviceError):
        stream.begin()
    while not stream.drained:
        taken += len(stream.take(64, 0.1))
    let_go.set()
    stream.close()
    assert taken == count
    assert re.search(r"read\(\) has not returned .* its driver hangs", stream.end_reason)
    assert isinstance(stream.failure, DeviceError)


def test_a_slow_camera_is_waited_for_two_frame_times_whoever_reads_it(tmp_path: Path) -> None:
    """A preflight called one of a frame in ten seconds stalled after five; a run would have taken it."""
    slow = Driver(frames_of(0, silences=99))
    camera = {"driver": "simulated", "frame_rate_hz": 0.1, "timeout_s": 5.0}
    config = validate_configuration({"camera": camera, "session": {"output": str(tmp_path)}}, "test")
    stream = Devices(config).stream(config, OpenCamera(slow, INFO, ()))  # type: ignore[arg-type]
    with pytest.raises(FrameTimeout, match="no frame"):
        stream.begin()
    assert sum(slow.asked_s) == pytest.approx(20.5)
