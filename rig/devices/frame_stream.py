"""The camera thread: reads frames from the preflight to the end of a run, and reconnects the camera."""

import logging
import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, FrameTimeout
from acquisition.frames.guard import CameraCounts, ReadMonitor, driver_errors, end_within
from acquisition.frames.losses import FrameLosses
from acquisition.frames.numbering import FrameLine
from acquisition.frames.queue import MAX_QUEUE_BYTES, BoundedQueue, Policy, taken_from
from acquisition.record.events import EventKind
from acquisition.record.topics import RecordedClockStep
from processing.errors import DeviceError, RigError, one_line_text
from processing.units import seconds
from rig.control import LightPermit, Stage
from rig.devices.clocks import wait_for_network_clock
from rig.instrument import setting_differences, with_read_back

_SLEPT_NS = 1_000_000_000
_MAX_CLOCK_READING_NS = 10_000_000
"""Largest time between the readings of two clocks; it is longer if the program was stopped there."""


class AwakeTime(NamedTuple):
    """Time without and with the computer's sleep; they are equal on systems that do not count sleep."""

    awake_ns: int
    with_sleep_ns: int


def read_awake() -> AwakeTime:
    """Read both clocks at the same moment."""
    clock = _clock_with_sleep()
    while True:
        before_ns = time.monotonic_ns()
        with_sleep_ns = before_ns if clock is None else time.clock_gettime_ns(clock)
        if time.monotonic_ns() - before_ns < _MAX_CLOCK_READING_NS:
            return AwakeTime(before_ns, with_sleep_ns)


def _clock_with_sleep() -> int | None:
    if sys.platform.startswith("linux"):
        return time.CLOCK_BOOTTIME
    # on macOS time.monotonic is another clock, which stands still while the computer sleeps
    return time.CLOCK_MONOTONIC if sys.platform == "darwin" else None


class SleepWatch:
    """Refuses frames of a computer that has slept since `begin`; `read` gives the two clocks."""

    def __init__(self, read: Callable[[], AwakeTime] = read_awake) -> None:
        self._read = read
        self.begin()

    def begin(self) -> None:
        """Compare with this moment from now on."""
        self._first = self._read()

    def raise_if_slept(self) -> None:
        """Raise DeviceError if the computer has slept since `begin`; called with every frame."""
        now = self._read()
        slept_ns = (now.with_sleep_ns - self._first.with_sleep_ns) - (now.awake_ns - self._first.awake_ns)
        if slept_ns > _SLEPT_NS:
            raise DeviceError(
                f"the computer slept for {seconds(slept_ns):.0f} s, in which its clock stood: times after it "
                "cannot be believed; keep it awake while it measures (systemd-inhibit rig run ..., lid open)"
            )


_log = logging.getLogger(__name__)
_LOOK_NS = 250_000_000
_WAIT_S = 0.05
_FEWEST, _MOST_ON_DEMAND = 8, 64
_FIRST_S = 0.5
"""Timeout of each attempt to read the first frame, after which a stop is noticed."""


class FrameStream:
    """Reads a camera in a thread into a bounded queue, reconnects it after unplugging, counts lost frames.

    With `policy` "wait" the camera waits while the queue is full, otherwise frames are dropped and counted,
    and a camera whose clock cannot be right is refused. `ended` is a text with the reason why the stream
    ended, `failure` the error that ended it. `permit` is notified of frames that arrive and are taken, on
    which the light of a laser depends. `time_shift_ns` is added to the camera's timestamps. `applied` are the
    settings read back from the camera, because a reconnected camera has lost other settings too.
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
        applied: CameraSettings | None = None,
    ) -> None:
        self._camera = camera
        self.permit = permit or LightPermit()
        self._settings = settings
        self._kept = settings if applied is None else with_read_back(settings, applied)
        self.policy: Policy = policy
        self._timeout_s = timeout_s
        self._reconnect_s = reconnect_s
        self._stop = threading.Event()
        self._closed = False
        # a full queue loses no frames on demand, and a short one keeps them in the processor's cache
        most = _MOST_ON_DEMAND if policy == "wait" else math.inf
        self._queue = BoundedQueue[Frame](most, policy, MAX_QUEUE_BYTES, fewest=_FEWEST)
        self._line = FrameLine(time_shift_ns, in_real_time=policy != "wait")
        self._counts = CameraCounts(lambda: camera.status)
        self._thread: threading.Thread | None = None
        self._begun = threading.Event()
        self._first: Frame | None = None
        self._events: deque[tuple[EventKind, str]] = deque()
        self._sleep = SleepWatch()
        self._steps: deque[RecordedClockStep] = deque()
        self._lost_before = self._at_last_look = FrameLosses()
        self._look_ns = 0
        self._hanging = ReadMonitor(timeout_s)
        self.ended = ""
        self.failure: Exception | None = None

    def start_camera(self) -> None:
        """Start the camera; `begin` waits for its first frame."""
        with driver_errors("camera", "start()"):
            self._camera.start()
        self._sleep.begin()

    def begin(self) -> Frame | None:
        """Wait for the first frame and start the thread; None if the source is empty.

        Raises FrameTimeout if no frame arrives within the timeout, DeviceError if the driver hangs.
        """
        # `close` waits for this thread, because a camera must not be closed while it is read
        self._thread = threading.Thread(target=self._acquire, name="camera", daemon=True)
        self._thread.start()
        while not (self._begun.wait(_WAIT_S) or self._stop.is_set()):
            self._raise_if_it_hangs(_WAIT_S)
        if self._first is None and self.failure is not None:
            raise self.failure
        return self._first

    def take(self, at_most: int, timeout_s: float) -> list[Frame]:
        """Up to `at_most` frames in order; empty after the timeout, and if drained."""
        self.permit.note_progress(Stage.PROCESSING)
        if remark := self._queue.remark():
            self._events.append((EventKind.BACKLOG, remark))
        frames = self._queue.take(at_most, timeout_s)
        try:
            self._raise_if_it_hangs(0.0 if frames else timeout_s)
        except DeviceError:
            self._queue.close()
        return frames

    def waits_on_purpose(self) -> None:
        """Note that camera and processing have not stalled, but wait for a fit, as frames on demand may."""
        for stage in (Stage.CAMERA, Stage.PROCESSING):
            self.permit.note_progress(stage)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of the camera since the last call, as (kind, text)."""
        taken = taken_from(self._events)
        if remark := self._counts.take_remark():
            taken.append((EventKind.WATCHER_FAILED, f"the camera's counts: {remark}"))
        return taken

    def take_clock_steps(self) -> list[RecordedClockStep]:
        """Steps of the camera's clock since the last call, which are subtracted from the frames' times."""
        return taken_from(self._steps)

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
        """Frames lost since the start, or since `count_losses_anew`, by cause."""
        return self._all_losses().since(self._lost_before)

    def count_losses_anew(self) -> None:
        """Make `losses` count only frames that are lost from now on."""
        self._lost_before = self._all_losses()

    def _all_losses(self) -> FrameLosses:
        return FrameLosses.from_status(
            self._counts.latest,
            unqueued=self._queue.dropped,
            while_unplugged=self._line.missing,
            wrong_time=self._line.rejected + self._line.waiting,
        )

    def __len__(self) -> int:
        return len(self._queue)

    def _raise_if_it_hangs(self, waited_s: float) -> None:
        # a source of frames on demand may take any time
        if (hangs := self._hanging.check(waited_s)) and self.policy != "wait":
            error = DeviceError(hangs)
            self._fail(error, hangs)
            raise error

    def _read(self) -> Frame | None:
        """The camera's next frame, after a reconnection if necessary; None at the end."""
        silent_s, opened_again = 0.0, False
        begun = self._begun.is_set()
        while not self._stop.is_set():
            # a source on demand may be slow; silence of a free-running camera is reported early
            on_demand = self.policy == "wait"
            patience_s = self._timeout_s if on_demand else self._line.patience_s(self._timeout_s)
            patience_s = min(patience_s if begun else _FIRST_S, self._timeout_s - silent_s)
            self._hanging.enter()
            try:
                read = self._camera.read(patience_s)
            except (FrameTimeout, CameraLost) as lost:
                if isinstance(lost, FrameTimeout):
                    lost = self._with_reasons(lost)
                    if begun and silent_s == 0.0 and patience_s < self._timeout_s:
                        self._events.append((EventKind.CAMERA_SILENT, str(lost)))
                    silent_s += patience_s
                    if silent_s < self._timeout_s - 1e-6:
                        continue
                # drivers notice an unplugged cable late or never, so a silent camera is opened again; if it
                # then stays silent, it was connected all the time
                if not begun or (isinstance(lost, FrameTimeout) and (on_demand or opened_again)):
                    raise lost from None
                opened_again = opened_again or isinstance(lost, FrameTimeout)
                self._events.append((EventKind.CAMERA_LOST, str(lost)))
                self._hanging.leave()
                self._reconnect(lost)
                self._line.restart()
                silent_s = 0.0
                continue
            if read is None:
                self.ended = self.ended or "the camera delivered its last frame"
            elif not on_demand:
                self._sleep.raise_if_slept()
            if silent_s and begun and read is not None:
                text = f"after more than {silent_s:.2f} s of silence"
                self._events.append((EventKind.CAMERA_SPEAKS, text))
            return read
        return None

    def _acquire(self) -> None:
        """Read, check, number, and hand over."""
        try:
            while (read := self._read()) is not None:
                passed = self._line.take(read)
                self.permit.frame_read(read.image)
                if read.host_time_ns >= self._look_ns:
                    self._look_ns = int(read.host_time_ns) + _LOOK_NS
                    self._at_last_look = self._all_losses()
                self._events.extend(passed.notes)
                self._steps.extend(passed.steps)
                for joined in passed.frames:
                    self._first = self._first or joined
                    self._queue.put(joined)
                    self._begun.set()
        except FrameTimeout as error:
            unused = self._all_losses().since(self._at_last_look)
            came = f"of those that came {unused.discarded_text}"
            why = came if unused.discarded else "the camera has stalled"
            self._fail(error, f"no frame for {self._timeout_s:g} s: {why}")
        except Exception as error:
            self._fail(error, self._error_text(error))
        finally:
            self._queue.close()
            self._begun.set()

    def _with_reasons(self, lost: FrameTimeout) -> FrameTimeout:
        """The error, with the number of frames that came and could not be used, not a trigger's fault."""
        unused = self._all_losses().since(self._at_last_look)
        if not unused.discarded:
            return lost
        name = str(lost).partition(": ")[0]
        return FrameTimeout(
            f"{name}: no usable frame; of those that came {unused.discarded_text}; use a lower rate or "
            "size, another port or cable; rig camera show lists what the camera reports"
        )

    def _reconnect(self, lost: FrameTimeout | CameraLost) -> None:
        deadline_s = time.monotonic() + self._reconnect_s
        before = self._counts.latest
        while not self._stop.is_set() and time.monotonic() < deadline_s:
            try:
                self._camera.close()
                self._camera.open()
                differences = self._configure_again()
                if self._settings.ptp:
                    wait_for_network_clock(self._camera, ended=self._stop)
                self._camera.start()
            except DeviceError:
                self._stop.wait(0.25)
            else:
                self._counts.go_on(before)
                if differences:
                    self._events.append((EventKind.CAMERA_BACK, f"with other settings: {differences}"))
                return
        raise CameraLost(f"{lost}; it could not be reopened within {self._reconnect_s:g} s")

    def _configure_again(self) -> str:
        """Set the requested settings and the camera's other ones; returns the differences after that."""
        try:
            now = self._camera.configure(self._kept)
        except DeviceError:
            # some settings can be read back but not set
            now = self._camera.configure(self._settings)
        return "; ".join(setting_differences(self._kept, now))

    @staticmethod
    def _error_text(error: Exception) -> str:
        text = one_line_text(error)
        return text if text.startswith("camera: ") else f"camera: {text}"

    def _fail(self, error: Exception, reason: str) -> None:
        if not isinstance(error, RigError):
            # the traceback tells the author of a driver where it failed
            _log.error("%s", reason, exc_info=error)
            error = DeviceError(reason)
        if self.failure is None:
            self.failure = error
            self.ended = reason
