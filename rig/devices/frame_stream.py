"""The camera thread: reads frames from the preflight to the end of a run, and reconnects the camera."""

import logging
import threading
import time

from acquisition.camera import Camera, CameraLost, CameraSettings, CameraStatus, FrameTimeout
from acquisition.frame import Frame
from acquisition.frame_losses import FrameLosses
from acquisition.frame_queue import FrameQueue, Policy
from acquisition.record.events import EventKind
from processing.errors import DeviceError, RigError
from processing.ticks import S_PER_NS, seconds
from rig.control import LightPermit, Stage
from rig.devices.frame_clock import FrameClock
from rig.devices.host_clock import ClockWatch, wait_for_network_clock

_log = logging.getLogger(__name__)
_QUEUE_BYTES = 256 * 1024 * 1024
_NAMED_AFTER_S = 0.35
_CLOCK_STEP_NS = 1_000_000_000
_SMOOTHING = 0.1


class FrameLine:
    """The one place where a frame gets the number and the time that hold from here on.

    `time_shift_ns` moves the camera's timestamps to the middle of the exposure. A camera that is opened again
    numbers its frames from 0, and its clock may have been reset. The frames after the gap get the numbers
    that follow from the time elapsed, so that missing frames are counted. A clock that was reset is shifted
    by a constant, so that it continues consistently with the host's clock; the shift is reported. `missing`
    is the number of frames missed while the camera was disconnected.
    """

    def __init__(self, time_shift_ns: int = 0) -> None:
        self._last: Frame | None = None
        self._interval_ns = 0.0
        self._offset = 0
        self._to_middle_ns = time_shift_ns
        self._continued_ns = 0
        self._reopened = False
        self.missing = 0

    def patience_s(self, without_s: float) -> float:
        """Time without a frame that is still normal: two frame times and a margin; `without_s` at the start.

        With this margin an interruption is reported within two frame times plus 0.5 s.
        """
        return 2 * S_PER_NS * self._interval_ns + _NAMED_AFTER_S if self._interval_ns else without_s

    def begin_again(self) -> None:
        """The camera was opened again: the next frame is its first."""
        self._reopened = self._last is not None

    def join(self, frame: Frame) -> tuple[Frame, str]:
        """The frame with its number and time in this line; a note with the first after a gap."""
        last, note = self._last, ""
        middle_ns = frame.device_time_ns
        if middle_ns >= 0:
            middle_ns = max(middle_ns + self._to_middle_ns, 0)
        if self._reopened and last is not None:
            note = self._find_offsets(frame.sequence, middle_ns, frame.host_time_ns, last)
            self._reopened = False
        if middle_ns >= 0:
            middle_ns += self._continued_ns
        if self._offset or middle_ns != frame.device_time_ns:
            frame = frame._replace(sequence=frame.sequence + self._offset, device_time_ns=middle_ns)
        if last is not None and not note:
            self._learn_interval(frame, last)
        self._last = frame
        return frame, note

    def _learn_interval(self, frame: Frame, last: Frame) -> None:
        steps, passed_ns = frame.sequence - last.sequence, frame.time_ns - last.time_ns
        if steps > 0 and passed_ns > 0:
            now_ns = passed_ns / steps
            self._interval_ns += (_SMOOTHING if self._interval_ns else 1.0) * (now_ns - self._interval_ns)

    def _find_offsets(self, number: int, middle_ns: int, host_ns: int, last: Frame) -> str:
        passed_ns = by_host_ns = host_ns - last.host_time_ns
        self._continued_ns = 0
        shifted = ""
        if middle_ns >= 0:
            passed_ns = middle_ns - last.device_time_ns
            # simulated time may pass more quickly than the host's, a clock that began again is behind it
            if passed_ns < by_host_ns - _CLOCK_STEP_NS or passed_ns <= 0:
                self._continued_ns, passed_ns = by_host_ns - passed_ns, by_host_ns
                shifted = f"; its clock began again, {self._continued_ns} ns are added to its times"
        missing = max(round(passed_ns / (self._interval_ns or passed_ns)) - 1, 0)
        self._offset = last.sequence + 1 + missing - number
        self.missing += missing
        passed = f"{seconds(passed_ns):.3f} s without frames, about {missing} of them"
        return f"opened again after {passed}{shifted}"


class FrameStream:
    """Reads a camera in a thread into a bounded queue, reconnects it after unplugging, counts lost frames.

    With `policy` "wait" the camera waits while the queue is full, otherwise frames are dropped and
    counted, and a camera whose clock cannot be right is refused. `ended` is a text that says why the stream
    ended, `failure` the error that ended it. `permit` learns that frames arrive and are taken, on which the
    light of a laser depends. `time_shift_ns` is added to the camera's timestamps.
    """

    def __init__(
        self,
        camera: Camera,
        settings: CameraSettings,
        *,
        policy: Policy = "every",
        timeout_s: float = 5.0,
        reconnect_s: float = 60.0,
        permit: LightPermit | None = None,
        time_shift_ns: int = 0,
    ) -> None:
        self._camera = camera
        self.permit = permit or LightPermit()
        self._settings = settings
        self.policy: Policy = policy
        self._timeout_s = timeout_s
        self._reconnect_s = reconnect_s
        self._stop = threading.Event()
        self._counts_before = CameraStatus()
        self._queue: FrameQueue | None = None
        self._line = FrameLine(time_shift_ns)
        self._clock = ClockWatch()
        self._times = FrameClock()
        self._thread: threading.Thread | None = None
        self._events: list[tuple[EventKind, str]] = []
        self.ended = ""
        self.failure: Exception | None = None

    def start_camera(self) -> None:
        """Start the camera; `begin` waits for its first frame."""
        self._camera.start()

    def begin(self) -> Frame | None:
        """Wait for the first frame and start the thread; None if the source is empty.

        Raises FrameTimeout if no frame arrives within the timeout.
        """
        first = self._first_frame()
        if first is None:
            return None
        self.permit.frame_read(first.image)
        self._queue = FrameQueue(_capacity(first, self.policy), self.policy)
        self._queue.put(first)
        self._thread = threading.Thread(target=self._acquire, name="camera", daemon=True)
        self._thread.start()
        return first

    def take(self, at_most: int, timeout_s: float) -> list[Frame]:
        """Up to `at_most` frames in order; empty after the timeout, and if drained."""
        self.permit.moved(Stage.PROCESSING)
        return [] if self._queue is None else self._queue.take(at_most, timeout_s)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of the camera since the last call, as (kind, text)."""
        taken, self._events = self._events, []
        return taken

    def request_stop(self) -> None:
        """End the stream; may be called from any thread."""
        self._stop.set()

    def close(self) -> None:
        """End the thread; the camera is stopped, not closed. Its error is kept in `failure`."""
        self._stop.set()
        if self._queue is not None:
            self._queue.close()
        try:
            self._camera.stop()
        except Exception as error:
            self._fail(error, f"camera: {error}")
        if self._thread is not None:
            self._thread.join(timeout=self._timeout_s + 1.0)

    @property
    def drained(self) -> bool:
        """True if the stream has ended and every frame has been taken."""
        return self._queue is not None and self._queue.drained

    @property
    def losses(self) -> FrameLosses:
        """Frames lost since the start, by cause."""
        unqueued = 0 if self._queue is None else self._queue.dropped
        status = self._counts_before + self._camera.status
        return FrameLosses.of(
            status,
            unqueued=unqueued,
            while_unplugged=self._line.missing,
            wrong_time=self._times.rejected + self._times.waiting,
        )

    def __len__(self) -> int:
        return 0 if self._queue is None else len(self._queue)

    def _first_frame(self) -> Frame | None:
        waited_s = 0.0
        while not self._stop.is_set():
            step_s = min(self._timeout_s, 0.5)
            try:
                frame = self._camera.read(step_s)
                if frame is None:
                    return None
                for sure in self._sure(frame):
                    return self._line.join(sure)[0]
            except FrameTimeout:
                waited_s += step_s
                if waited_s >= self._timeout_s:
                    raise
        return None

    def _acquire(self) -> None:
        """Read and hand over, reconnect after an unplugging."""
        queue = self._queue
        assert queue is not None
        line = self._line
        silent_s = 0.0
        opened_again = False
        try:
            while not self._stop.is_set():
                # a source on demand may be slow; silence of a free-running camera is reported early
                patience_s = self._timeout_s if self.policy == "wait" else line.patience_s(self._timeout_s)
                patience_s = min(patience_s, self._timeout_s - silent_s)
                try:
                    frame = self._camera.read(patience_s)
                except (FrameTimeout, CameraLost) as lost:
                    if isinstance(lost, FrameTimeout):
                        if silent_s == 0.0 and patience_s < self._timeout_s:
                            self._events.append((EventKind.CAMERA_SILENT, str(lost)))
                        silent_s += patience_s
                        if silent_s < self._timeout_s - 1e-6:
                            continue
                        # drivers notice an unplugged cable after seconds, or never: one that can be opened
                        # again was there all the time if it stays silent
                        if self.policy == "wait" or opened_again:
                            raise
                        opened_again = True
                    self._events.append((EventKind.CAMERA_LOST, str(lost)))
                    self._reconnect(lost)
                    line.begin_again()
                    self._clock.begin_again()
                    self._times.begin_again()
                    silent_s = 0.0
                    continue
                if frame is None:
                    self.ended = self.ended or "the camera delivered its last frame"
                    break
                self.permit.frame_read(frame.image)
                if self.policy != "wait":
                    self._clock.see(frame)
                if silent_s:
                    self._events.append(
                        (EventKind.CAMERA_SPEAKS, f"after more than {silent_s:.2f} s of silence")
                    )
                    silent_s = 0.0
                opened_again = False
                for sure in self._sure(frame):
                    joined, note = line.join(sure)
                    if note:
                        self._events.append((EventKind.CAMERA_BACK, note))
                    queue.put(joined)
        except FrameTimeout as error:
            self._fail(error, f"no frame for {self._timeout_s:g} s: the camera has stalled")
        except Exception as error:
            self._fail(error, f"camera: {error}")
        finally:
            queue.close()

    def _sure(self, frame: Frame) -> list[Frame]:
        """The frames whose times are sure with this one; times of a source on demand are its own."""
        if self.policy == "wait":
            return [frame]
        frames, note = self._times.take(frame)
        if note:
            self._events.append((EventKind.CAMERA_CLOCK, note))
        return frames

    def _reconnect(self, lost: FrameTimeout | CameraLost) -> None:
        deadline_s = time.monotonic() + self._reconnect_s
        before = self._camera.status
        while not self._stop.is_set() and time.monotonic() < deadline_s:
            try:
                self._camera.close()
                self._camera.open()
                self._camera.configure(self._settings)
                if self._settings.ptp:
                    wait_for_network_clock(self._camera, ended=self._stop)
                self._camera.start()
            except DeviceError:
                self._stop.wait(0.25)
            else:
                # a driver that has noticed the loss counts on, any other begins again
                if self._camera.status.reconnects == before.reconnects:
                    self._counts_before += before
                return
        raise CameraLost(f"{lost}; it was not to be opened again within {self._reconnect_s:g} s")

    def _fail(self, error: Exception, reason: str) -> None:
        if self.failure is None:
            self.failure = error
            self.ended = reason
        if not isinstance(error, RigError):
            _log.error("%s", reason, exc_info=error)


def _capacity(frame: Frame, policy: Policy) -> int:
    """Length of the queue for a bounded amount of memory: at least a few frames, at most about 1000.

    Frames on demand are not lost while the queue is full; a short one keeps them in the processor's cache.
    """
    return max(8, min(64 if policy == "wait" else 1024, _QUEUE_BYTES // max(frame.image.nbytes, 1)))
