"""Conformance suite of the camera drivers. A driver's test is a subclass of `CameraConformance`.

A subclass gives a fixture ``camera`` (closed, of a source that delivers at least
`FRAMES_NEEDED` frames after each start) and states what its source can do. What a driver cannot
do is skipped with the reason, never silently.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import ClassVar

import numpy as np
import pytest

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, FrameTimeout, PixelFormat
from processing.errors import DeviceError

FRAMES_NEEDED = 20
READ_TIMEOUT_S = 5.0
STOP_LIMIT_S = 1.0

Unplug = Callable[[], None]


class CameraConformance:
    """The suite. Class variables say what the source under test can do."""

    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8",)
    """Formats that `configure` must accept and deliver."""
    WRONG_FORMAT: ClassVar[PixelFormat | None] = None
    """A format that the camera must refuse by name, None where it takes all."""
    HAS_REGION: ClassVar[bool] = True
    """A region of interest can be cut."""
    APPLIES: ClassVar[dict[str, float]] = {}
    """Settings that must come back as asked."""
    SKIPS_WHEN_SLOW: ClassVar[bool] = False
    """A slow reader loses frames, counted; else every frame waits for the reader."""

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        """The camera under test, closed; the subclass overrides this."""
        raise NotImplementedError("the driver's test gives a fixture 'camera'")

    @pytest.fixture
    def blocked_camera(self) -> Iterator[Camera]:
        """A camera whose `read` waits for a frame for long, closed; skipped where there is no such."""
        pytest.skip("this source never keeps a reader waiting")

    @pytest.fixture
    def unplugged(self) -> Iterator[tuple[Camera, Unplug]]:
        """A camera, closed, and a function that unplugs it; skipped where there is no such."""
        pytest.skip("this source cannot be unplugged")

    # life cycle

    def test_frames_are_what_the_camera_says(self, camera: Camera) -> None:
        info = camera.open()
        assert info.driver
        assert min(info.width_px, info.height_px) > 0
        assert info.full_scale_dn >= 255
        camera.close()
        with _running(camera) as applied:
            frames = _take(camera, FRAMES_NEEDED)
        for frame in frames:
            assert isinstance(frame, Frame)
            assert frame.image.dtype in (np.uint8, np.uint16)
            assert frame.image.ndim == 2
            assert frame.image.shape == (applied.height_px, applied.width_px)

    def test_read_before_start_is_refused_and_after_stop_gives_none(self, camera: Camera) -> None:
        camera.open()
        with pytest.raises(DeviceError):
            camera.read(0.1)
        camera.close()
        with _running(camera):
            _take(camera, 2)
            camera.stop()
            assert camera.read(0.1) is None

    @pytest.mark.parametrize("method", ["start", "configure"])
    def test_nothing_works_before_open(self, camera: Camera, method: str) -> None:
        with pytest.raises(DeviceError):
            camera.start() if method == "start" else camera.configure(CameraSettings())

    @pytest.mark.parametrize("method", ["start", "configure"])
    def test_what_is_refused_while_running_leaves_it_running(self, camera: Camera, method: str) -> None:
        with _running(camera):
            with pytest.raises(DeviceError):
                camera.start() if method == "start" else camera.configure(CameraSettings())
            assert camera.read(READ_TIMEOUT_S) is not None

    def test_start_and_stop_fifty_times(self, camera: Camera) -> None:
        camera.open()
        camera.configure(CameraSettings())
        for _ in range(50):
            camera.start()
            first = _take(camera, 1)[0].sequence
            assert first == camera.status.dropped
            assert first == 0 or self.SKIPS_WHEN_SLOW
            camera.stop()
        camera.close()

    def test_stop_and_close_may_come_at_any_time_and_repeat(self, camera: Camera) -> None:
        _within_limit(camera.stop)
        _within_limit(camera.close)
        camera.open()
        _within_limit(camera.stop)
        camera.configure(CameraSettings())
        _within_limit(camera.stop)
        camera.start()
        _within_limit(camera.stop)
        _within_limit(camera.stop)
        _within_limit(camera.close)
        for _ in range(3):
            _within_limit(camera.close)
            camera.open()
            camera.configure(CameraSettings())
            camera.start()
            _take(camera, 2)
        _within_limit(camera.close)

    def test_stop_from_another_thread_while_frames_run(self, camera: Camera) -> None:
        with _running(camera):
            ended = threading.Event()
            reader = threading.Thread(target=_read_to_end, args=(camera, ended), daemon=True)
            reader.start()
            deadline_s = time.monotonic() + READ_TIMEOUT_S
            while not camera.status.delivered:
                assert time.monotonic() < deadline_s, "no frame was read"
                time.sleep(0.001)
            _within_limit(camera.stop)
            assert ended.wait(STOP_LIMIT_S), "read did not return None after stop"

    def test_stop_releases_a_waiting_read(self, blocked_camera: Camera) -> None:
        with _running(blocked_camera):
            ended = threading.Event()
            reader = threading.Thread(target=_read_to_end, args=(blocked_camera, ended), daemon=True)
            reader.start()
            time.sleep(0.2)
            _within_limit(blocked_camera.stop)
            assert ended.wait(STOP_LIMIT_S), "a waiting read did not return within a second of stop"

    def test_read_keeps_its_timeout(self, blocked_camera: Camera) -> None:
        with _running(blocked_camera):
            waited_s = _wait_of_timeout(blocked_camera, 0.2)
            assert 0.15 <= waited_s < 0.2 + STOP_LIMIT_S

    # frames

    def test_sequence_counts_from_zero_and_gaps_are_counted(self, camera: Camera) -> None:
        with _running(camera):
            numbers = [frame.sequence for frame in _take(camera, FRAMES_NEEDED)]
            status = camera.status
        assert numbers == sorted(set(numbers))
        assert numbers[0] == status.dropped - _gaps(numbers)
        assert status.delivered == FRAMES_NEEDED

    def test_times_rise(self, camera: Camera) -> None:
        info = camera.open()
        camera.configure(CameraSettings())
        camera.start()
        frames = _take(camera, FRAMES_NEEDED)
        camera.close()
        device = np.array([frame.device_time_ns for frame in frames])
        host = np.array([frame.host_time_ns for frame in frames])
        assert all(isinstance(frame.device_time_ns, int) for frame in frames)
        if info.has_clock:
            assert np.all(np.diff(device) > 0)
            assert device[0] >= 0
        else:
            assert np.all(device == -1)
        assert np.all(np.diff(host) >= 0)
        assert host[-1] <= time.monotonic_ns()

    def test_a_delivered_image_is_not_written_to_again(self, camera: Camera) -> None:
        with _running(camera):
            frames = _take(camera, FRAMES_NEEDED // 2)
            copies = [frame.image.copy() for frame in frames]
            _take(camera, FRAMES_NEEDED // 2)
        for frame, copy in zip(frames, copies, strict=True):
            assert np.array_equal(frame.image, copy)

    def test_a_slow_reader_loses_nothing_silently(self, camera: Camera) -> None:
        with _running(camera):
            first = _take(camera, 1)[0]
            time.sleep(0.5)
            later = _take(camera, FRAMES_NEEDED - 1)
            status = camera.status
        numbers = [first.sequence, *(frame.sequence for frame in later)]
        assert _gaps(numbers) == status.dropped
        if not self.SKIPS_WHEN_SLOW:
            assert status.dropped_by_host == 0

    # settings

    def test_settings_are_read_back(self, camera: Camera) -> None:
        if not self.APPLIES:
            pytest.skip("this source applies no settings")
        camera.open()
        applied = camera.configure(CameraSettings(**self.APPLIES))
        for name, wanted in self.APPLIES.items():
            assert getattr(applied, name) == pytest.approx(wanted, rel=0.02)
        camera.close()

    def test_region_of_interest_that_lies_on_the_sensor(self, camera: Camera) -> None:
        if not self.HAS_REGION:
            pytest.skip("this source has no region of interest")
        info = camera.open()
        asked = CameraSettings(
            width_px=info.width_px // 2,
            height_px=info.height_px // 2,
            offset_x_px=info.width_px // 4,
            offset_y_px=info.height_px // 4,
        )
        applied = camera.configure(asked)
        camera.start()
        image = _take(camera, 1)[0].image
        camera.stop()
        assert image.shape == (applied.height_px, applied.width_px)
        assert applied.width_px == asked.width_px
        assert applied.height_px == asked.height_px
        with pytest.raises(DeviceError, match=str(info.width_px)):
            camera.configure(CameraSettings(width_px=info.width_px, offset_x_px=8))
        camera.close()

    def test_pixel_formats(self, camera: Camera) -> None:
        camera.open()
        for pixel_format in self.PIXEL_FORMATS:
            applied = camera.configure(CameraSettings(pixel_format=pixel_format))
            assert applied.pixel_format == pixel_format
            camera.start()
            image = _take(camera, 1)[0].image
            camera.stop()
            bits = int(pixel_format.removeprefix("mono"))
            assert image.dtype == (np.uint8 if bits == 8 else np.uint16)
            assert int(image.max()) < 2**bits
        camera.close()

    def test_unsupported_format_is_refused_and_the_others_named(self, camera: Camera) -> None:
        if self.WRONG_FORMAT is None:
            pytest.skip("this source refuses no pixel format")
        camera.open()
        with pytest.raises(DeviceError, match=self.PIXEL_FORMATS[0]):
            camera.configure(CameraSettings(pixel_format=self.WRONG_FORMAT))
        camera.close()

    # loss

    def test_unplugging_is_noticed_and_survived(self, unplugged: tuple[Camera, Unplug]) -> None:
        camera, unplug = unplugged
        camera.open()
        camera.configure(CameraSettings())
        camera.start()
        _take(camera, 2)
        unplug()
        with pytest.raises(CameraLost):
            _read_for(camera, 10.0)
        _within_limit(camera.stop)
        _within_limit(camera.close)


@contextmanager
def _running(camera: Camera) -> Iterator[CameraSettings]:
    camera.open()
    applied = camera.configure(CameraSettings())
    camera.start()
    try:
        yield applied
    finally:
        camera.close()


def _take(camera: Camera, count: int) -> list[Frame]:
    frames = []
    while len(frames) < count:
        frame = camera.read(READ_TIMEOUT_S)
        assert frame is not None, f"the source ended after {len(frames)} of {count} frames"
        frames.append(frame)
    return frames


def _read_for(camera: Camera, duration_s: float) -> None:
    deadline_s = time.monotonic() + duration_s
    while time.monotonic() < deadline_s:
        with suppress(FrameTimeout):  # silence may come before the loss is certain
            camera.read(1.0)


def _wait_of_timeout(camera: Camera, timeout_s: float) -> float:
    """How long the first read that times out waits."""
    while True:
        begin_s = time.monotonic()
        try:
            camera.read(timeout_s)
        except FrameTimeout:
            return time.monotonic() - begin_s


def _read_to_end(camera: Camera, ended: threading.Event) -> None:
    while camera.read(30.0) is not None:
        pass
    ended.set()


def _within_limit(action: Callable[[], None]) -> None:
    begin_s = time.monotonic()
    action()
    assert time.monotonic() - begin_s < STOP_LIMIT_S


def _gaps(numbers: list[int]) -> int:
    """Frames missing within a series of numbers that rises."""
    return numbers[-1] - numbers[0] + 1 - len(numbers)
