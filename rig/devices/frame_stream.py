"""The camera thread: reads frames from the preflight to the end of a run, and reconnects the camera."""

import logging
import math
import sys
import threading
import time

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, FrameTimeout
from acquisition.frames.guard import CameraCounts, ReadMonitor, driver_errors, end_within
from acquisition.frames.losses import FrameLosses
from acquisition.frames.numbering import FrameLine
from acquisition.frames.queue import MAX_QUEUE_BYTES, BoundedQueue, Policy, take_all
from acquisition.record.events import EventKind
from acquisition.record.topics import RecordedClockStep
from processing.errors import DeviceError, RigError, one_line_text
from processing.units import seconds
from rig.control import LightPermit, Stage
from rig.devices.clocks import wait_for_network_clock
from rig.instrument import setting_differences, with_read_back

_MIN_SLEEP_NS = 1_000_000_000
_MAX_CLOCK_READING_NS = 10_000_000
"""Largest time between the readings of two clocks; it is longer if the program was stopped there."""


def read_sleep_ns() -> int:
    """Time that the computer has slept since its start; 0 on systems that do not count sleep."""
    if sys.platform.startswith("linux"):
        clock = time.CLOCK_BOOTTIME
    elif sys.platform == "darwin":
        # time.monotonic is another clock there, which stands still while the computer sleeps
        clock = time.CLOCK_MONOTONIC
    else:
        return 0
    while True:
        awake_ns = time.monotonic_ns()
        with_sleep_ns = time.clock_gettime_ns(clock)
        if time.monotonic_ns() - awake_ns < _MAX_CLOCK_READING_NS:
            return with_sleep_ns - awake_ns


def raise_if_slept(earlier_ns: int) -> None:
    """Raise DeviceError if the computer has slept since `read_sleep_ns` returned `earlier_ns`."""
    slept_ns = read_sleep_ns() - earlier_ns
    if slept_ns > _MIN_SLEEP_NS:
        raise DeviceError(
            f"the computer slept for {seconds(slept_ns):.0f} s, in which its clock stood: times after it "
            "cannot be believed; keep it awake while it measures (systemd-inhibit rig run ..., lid open)"
        )


_log = logging.getLogger(__name__)
_LOSSES_INTERVAL_NS = 250_000_000
_POLL_INTERVAL_S = 0.05
_MIN_QUEUE_FRAMES, _MAX_FRAMES_ON_DEMAND = 8, 64
_FIRST_FRAME_TIMEOUT_S = 0.5
"""Timeout of each attempt to read the first frame, after which a stop is noticed."""
_REOPEN_INTERVAL_S, _RECONNECT_S = 0.25, 60.0
"""Interval of attempts to open a lost camera again, and time after which they end."""


class FrameStream:
    """Reads a camera in a thread into a bounded queue, reconnects it after unplugging, counts lost frames.

    With `policy` "wait" the camera waits while the queue is full, otherwise frames are dropped and counted,
    and a camera whose clock cannot be right is refused. `permit` is notified of frames that arrive and are
    taken, on which the light of a laser depends. `time_shift_ns` is added to the camera's timestamps.
    `applied` are the settings read back from the camera: a reconnected camera has lost all settings.
    """

    def __init__(
        self,
        camera: Camera,
        settings: CameraSettings,
        *,
        policy: Policy = "drop",
        timeout_s: float = 5.0,
        permit: LightPermit | None = None,
        time_shift_ns: int = 0,
        applied: CameraSettings | None = None,
    ) -> None:
        self._camera = camera
        self.permit = permit or LightPermit()
        self._settings = settings
        self._all_settings = settings if applied is None else with_read_back(settings, applied)
        self.policy: Policy = policy
        self._timeout_s = timeout_s
        self._stop = threading.Event()
        self._closed = False
        # a full queue loses no frames on demand, and a short one keeps them in the processor's cache
        max_frames = _MAX_FRAMES_ON_DEMAND if policy == "wait" else math.inf
        self._queue = BoundedQueue[Frame](max_frames, policy, MAX_QUEUE_BYTES, min_items=_MIN_QUEUE_FRAMES)
        self._line = FrameLine(time_shift_ns, in_real_time=policy != "wait")
        self._counts = CameraCounts(lambda: camera.status)
        self._thread: threading.Thread | None = None
        self._has_begun = threading.Event()
        self._first_frame: Frame | None = None
        self._events = self._line.events
        self._earlier_sleep_ns = read_sleep_ns()
        self._earlier_losses = self._last_losses = FrameLosses()
        self._losses_due_ns = 0
        self._silent_s, self._was_reopened = 0.0, False
        self._read_monitor = ReadMonitor(timeout_s)
        self.end_reason = ""
        """The reason why the stream ended; empty before."""
        self.failure: Exception | None = None
        """The error that ended the stream."""

    def start_camera(self) -> None:
        """Start the camera; `begin` waits for its first frame."""
        with driver_errors("camera", "start()"):
            self._camera.start()
        self._earlier_sleep_ns = read_sleep_ns()

    def begin(self) -> Frame | None:
        """Wait for the first frame and start the thread; None if the source is empty.

        Raises FrameTimeout if no frame arrives within the timeout, DeviceError if the driver hangs.
        """
        # `close` waits for this thread, because a camera must not be closed while it is read
        self._thread = threading.Thread(target=self._acquire, name="camera", daemon=True)
        self._thread.start()
        while not (self._has_begun.wait(_POLL_INTERVAL_S) or self._stop.is_set()):
            self._raise_if_hanging(_POLL_INTERVAL_S)
        if self._first_frame is None and self.failure is not None:
            raise self.failure
        return self._first_frame

    def take(self, max_frames: int, timeout_s: float) -> list[Frame]:
        """Up to `max_frames` frames in order; empty after the timeout, and if drained."""
        self.permit.note_progress(Stage.PROCESSING)
        if remark := self._queue.remark():
            self._events.append((EventKind.BACKLOG, remark))
        frames = self._queue.take(max_frames, timeout_s)
        try:
            self._raise_if_hanging(0.0 if frames else timeout_s)
        except DeviceError:
            self._queue.close()
        return frames

    def note_deliberate_wait(self) -> None:
        """Note that camera and processing wait for a fit, as frames on demand may, and have not stalled."""
        for stage in (Stage.CAMERA, Stage.PROCESSING):
            self.permit.note_progress(stage)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of the camera since the last call, as (kind, text)."""
        events = take_all(self._events)
        if remark := self._counts.take_remark():
            events.append((EventKind.WATCHER_FAILED, f"the camera's counts: {remark}"))
        return events

    def take_clock_steps(self) -> list[RecordedClockStep]:
        """Steps of the camera's clock since the last call, which are subtracted from the frames' times."""
        return take_all(self._line.steps)

    def request_stop(self) -> None:
        """End the stream; may be called from any thread."""
        self._stop.set()

    def close(self) -> None:
        """End the thread, once; the camera is stopped, not closed.

        A camera that cannot be stopped causes an event, not an error, because its frames so far are complete.
        """
        self._stop.set()
        if self._closed:
            return
        self._closed = True
        self._queue.close()
        if remark := end_within(self._camera.stop, "camera: stop()"):
            _log.warning("%s", remark)
            self._events.append((EventKind.CAMERA_STOP, remark))
        if self._thread is not None:
            self._thread.join(timeout=self._timeout_s + 1.0)

    @property
    def drained(self) -> bool:
        """True if the stream has ended and every frame has been taken."""
        return self._queue.drained

    @property
    def losses(self) -> FrameLosses:
        """Frames lost since the start, or since `restart_losses`, by cause."""
        return self._all_losses().since(self._earlier_losses)

    def restart_losses(self) -> None:
        """Make `losses` count only frames that are lost from now on."""
        self._earlier_losses = self._all_losses()

    def _all_losses(self) -> FrameLosses:
        return FrameLosses.from_status(
            self._counts.latest,
            unqueued=self._queue.dropped,
            while_unplugged=self._line.missing,
            wrong_time=self._line.rejected + self._line.waiting,
        )

    def __len__(self) -> int:
        return len(self._queue)

    def _raise_if_hanging(self, waited_s: float) -> None:
        # a source of frames on demand may take any time
        if (hangs := self._read_monitor.check(waited_s)) and self.policy != "wait":
            error = DeviceError(hangs)
            self._fail(error, hangs)
            raise error

    def _acquire(self) -> None:
        """Read, number, and hand over the camera's frames until its end, also where it was opened again."""
        try:
            while not self._stop.is_set():
                self._read_monitor.enter()
                try:
                    frame = self._camera.read(self._patience_s)
                except (FrameTimeout, CameraLost) as lost:
                    self._wait_or_reconnect(lost)
                    continue
                if frame is None:
                    self.end_reason = self.end_reason or "the camera delivered its last frame"
                    return
                if self.policy != "wait":
                    raise_if_slept(self._earlier_sleep_ns)
                if self._silent_s and self._has_begun.is_set():
                    text = f"after more than {self._silent_s:.2f} s of silence"
                    self._events.append((EventKind.CAMERA_SPEAKS, text))
                self._silent_s, self._was_reopened = 0.0, False
                numbered_frames = self._line.take(frame)
                self.permit.frame_read(frame.image)
                if frame.host_time_ns >= self._losses_due_ns:
                    self._losses_due_ns = int(frame.host_time_ns) + _LOSSES_INTERVAL_NS
                    self._last_losses = self._all_losses()
                for numbered_frame in numbered_frames:
                    self._first_frame = self._first_frame or numbered_frame
                    self._queue.put(numbered_frame)
                    self._has_begun.set()
        except FrameTimeout as error:
            losses = self._all_losses().since(self._last_losses)
            text = f"of those that came {losses.discarded_text}"
            why = text if losses.discarded else "the camera has stalled"
            self._fail(error, f"no frame for {self._timeout_s:g} s: {why}")
        except Exception as error:
            self._fail(error, f"camera: {one_line_text(error).removeprefix('camera: ')}")
        finally:
            self._queue.close()
            self._has_begun.set()

    @property
    def _patience_s(self) -> float:
        """Timeout of the next read: silence of a free-running camera is reported early."""
        # a source on demand may be slow
        on_demand = self.policy == "wait"
        usual_s = self._timeout_s if on_demand else self._line.patience_s(self._timeout_s)
        usual_s = usual_s if self._has_begun.is_set() else _FIRST_FRAME_TIMEOUT_S
        return min(usual_s, self._timeout_s - self._silent_s)

    def _wait_or_reconnect(self, lost: FrameTimeout | CameraLost) -> None:
        """Take account of a read without a frame; raises the error where no more frames can come."""
        has_begun = self._has_begun.is_set()
        if isinstance(lost, FrameTimeout):
            patience_s = self._patience_s
            lost = self._with_reasons(lost)
            if has_begun and self._silent_s == 0.0 and patience_s < self._timeout_s:
                self._events.append((EventKind.CAMERA_SILENT, str(lost)))
            self._silent_s += patience_s
            if self._silent_s < self._timeout_s - 1e-6:
                return
        # drivers notice an unplugged cable late or never, so a silent camera is opened again; if it then
        # stays silent, it was connected all the time
        is_timeout = isinstance(lost, FrameTimeout)
        if not has_begun or (is_timeout and (self.policy == "wait" or self._was_reopened)):
            raise lost from None
        self._was_reopened = self._was_reopened or is_timeout
        self._events.append((EventKind.CAMERA_LOST, str(lost)))
        self._read_monitor.leave()
        self._reconnect(lost)
        self._line.restart()
        self._silent_s = 0.0

    def _with_reasons(self, timeout: FrameTimeout) -> FrameTimeout:
        """The timeout, with the number of unusable frames that came: then the trigger is not at fault."""
        losses = self._all_losses().since(self._last_losses)
        if not losses.discarded:
            return timeout
        name = str(timeout).partition(": ")[0]
        return FrameTimeout(
            f"{name}: no usable frame; of those that came {losses.discarded_text}; use a lower rate or "
            "size, another port or cable; rig camera show lists what the camera reports"
        )

    def _reconnect(self, lost: FrameTimeout | CameraLost) -> None:
        deadline_s = time.monotonic() + _RECONNECT_S
        earlier_counts = self._counts.latest
        while not self._stop.is_set() and time.monotonic() < deadline_s:
            try:
                self._camera.close()
                self._camera.open()
                differences = self._configure_again()
                if self._settings.ptp:
                    wait_for_network_clock(self._camera, stop=self._stop)
                self._camera.start()
            except DeviceError:
                self._stop.wait(_REOPEN_INTERVAL_S)
            else:
                self._counts.go_on(earlier_counts)
                if differences:
                    self._events.append((EventKind.CAMERA_BACK, f"with other settings: {differences}"))
                return
        raise CameraLost(f"{lost}; it could not be reopened within {_RECONNECT_S:g} s")

    def _configure_again(self) -> str:
        """Set the requested settings and the camera's other ones; returns the differences after that."""
        try:
            applied = self._camera.configure(self._all_settings)
        except DeviceError:
            # some settings can be read back but not set
            applied = self._camera.configure(self._settings)
        return "; ".join(setting_differences(self._all_settings, applied))

    def _fail(self, error: Exception, reason: str) -> None:
        if not isinstance(error, RigError):
            # the traceback tells the author of a driver where it failed
            _log.error("%s", reason, exc_info=error)
            error = DeviceError(reason)
        if self.failure is None:
            self.failure = error
            self.end_reason = reason
