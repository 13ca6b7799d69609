"""Base class of the drivers of real cameras: life cycle, and frames that the calling thread reads itself."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import ClassVar, Final, Generic, Protocol, TypeVar

from acquisition.camera import CameraLost, CameraSettings, CameraStatus, Frame, FrameTimeout
from acquisition.frames.losses import BlockNumbers
from processing.errors import DeviceError, RigError

_POLL_S: Final = 0.05
"""Longest wait for the camera, after which `read` checks for `stop`."""
_STOP_TIMEOUT_S: Final = 0.4
"""Longest wait of `stop` for a read that is under way."""


class CameraRun:
    """Frames of a camera from `start` to an end, which `stop` or an error brings once.

    Parameters
    ----------
    step
        Waits for the camera for at most this many seconds; returns the frame that was completed, if any.
    end
        Releases the run's resources; called when no `step` is under way or will follow.

    Attributes
    ----------
    delivered
        Number of frames that `read` has returned.
    """

    def __init__(self, step: Callable[[float], Frame | None], end: Callable[[], None]) -> None:
        self._step = step
        self._at_end = [end]
        self._in_use = threading.Lock()
        self._ending = threading.Lock()
        self._stopping = threading.Event()
        self._ended = False
        self._error: RigError | None = None
        self.delivered = 0

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame; None after `stop`.

        Raises TimeoutError if there was none in time. Any other error ends the run, and is raised again by
        every later call.
        """
        with self._in_use:
            deadline_s = time.monotonic() + timeout_s
            try:
                if self._error is not None:
                    raise self._error
                while not self._stopping.is_set():
                    left_s = max(deadline_s - time.monotonic(), 0.0)
                    frame = self._step(min(left_s, _POLL_S))
                    if self._stopping.is_set():
                        return None
                    if frame is not None:
                        self.delivered += 1
                        return frame
                    if not left_s:
                        raise TimeoutError
                return None
            except RigError as error:
                # a new error, because the traceback of this one keeps the camera's objects alive
                self._error = type(error)(str(error))
                self._stopping.set()
                raise
            finally:
                if self._stopping.is_set():
                    self._end()

    def request_stop(self) -> None:
        """Make a waiting `read` return, without waiting for it."""
        self._stopping.set()

    def stop(self, timeout_s: float) -> bool:
        """End the run as soon as a waiting `read` has returned; False if that takes longer."""
        self._stopping.set()
        if not self._in_use.acquire(timeout=timeout_s):
            return False
        try:
            self._end()
        finally:
            self._in_use.release()
        return True

    @property
    def stopped(self) -> bool:
        """Whether no more frames will come."""
        return self._stopping.is_set()

    def when_ended(self, action: Callable[[], None]) -> None:
        """Run `action` at the end of the run, or now if the run has ended already."""
        with self._ending:
            if not self._ended:
                self._at_end.append(action)
                return
        action()

    def _end(self) -> None:
        """Release the resources of the run; a second call does nothing."""
        with self._ending:
            actions, self._at_end = self._at_end, []
            self._ended = True
        for action in actions:
            action()


def check_range(name: str, key: str, value: float, low: float | None, high: float | None) -> None:
    """Raise DeviceError, which states the range, for a value outside it; None: no limit."""
    low, high = -math.inf if low is None else low, math.inf if high is None else high
    if not low <= value <= high:
        raise DeviceError(f"{name}: {key} = {value:g} is out of range; {low:g} to {high:g} are possible")


def check_end(name: str, key: str, start_px: int, length_px: int, sensor_px: int) -> None:
    """Raise DeviceError for a region whose `key`, its width or height, reaches beyond the sensor."""
    if start_px + length_px > sensor_px:
        raise DeviceError(
            f"{name}: {key} with its offset reaches {start_px + length_px}; the sensor has {sensor_px}. "
            "Ask for less, or set the offset, too"
        )


_Camera = TypeVar("_Camera")


def only_camera(
    kind: str,
    cameras: Sequence[tuple[str, str, _Camera]],
    serial: str | None,
    setting: str = "camera.serial",
) -> _Camera:
    """The camera with this serial number, or for None the only one, of `cameras` (name, number, camera).

    Raises DeviceError, with a list of the cameras, if there is none, or if only `setting` could decide.
    """
    chosen = [camera for _, number, camera in cameras if serial in (None, number)]
    listed = "; ".join(name for name, _, _ in cameras)
    if not cameras:
        raise DeviceError(f"{kind}: no camera answers; check cable, power and network, then: rig doctor")
    if not chosen:
        raise DeviceError(f"{kind}: no camera has the serial number {serial!r}; there are: {listed}")
    if len(chosen) > 1:
        which = f"set {setting} to one of them" if serial is None else "unplug all but one"
        raise DeviceError(f"{kind}: several cameras: {listed}; {which}")
    return chosen[0]


class AppliesSettings(Protocol):
    """An open device."""

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None; return all as read back."""
        ...


_Opened = TypeVar("_Opened", bound=AppliesSettings)


class DeviceCamera(Generic[_Opened]):
    """Base of the drivers' cameras: settings, frames until a stop, counts that continue after a reconnection.

    A driver sets `_features`, the open device, `_run`, the run since `start`, and `_name`.
    """

    _HINT: ClassVar[str] = ""
    """Text appended to the library's messages."""
    _SILENT: ClassVar[str] = "is its trigger on?"
    """Question appended to the message that no frame came."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.RLock()
        self._features: _Opened | None = None
        self._run: CameraRun | None = None
        self._numbers = BlockNumbers(name, ())
        self._past_counts = CameraStatus()
        self._was_lost = False

    def _library_error(self) -> type[Exception]:
        """Class of the library's exceptions."""
        return DeviceError

    def _is_gone(self) -> bool:
        """Whether the library says that the camera is no longer connected."""
        return False

    def configure(self, settings: CameraSettings) -> CameraSettings:
        with self._lock, self._translate_errors():
            device = self._open_device()
            self._must_be_idle("stop it before settings are changed")
            return device.apply(settings)

    def read(self, timeout_s: float) -> Frame | None:
        run = self._run
        if run is None:
            raise DeviceError(f"{self._name}: is not started; call start before read")
        try:
            with self._translate_errors():
                return run.read(timeout_s)
        except TimeoutError:
            raise FrameTimeout(f"{self._name}: no frame within {timeout_s:g} s; {self._SILENT}") from None

    def stop(self) -> None:
        if self._run is not None:
            self._run.stop(_STOP_TIMEOUT_S)

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        run = self._run
        return self._past_counts if run is None else self._past_counts + self._numbers.status(run.delivered)

    def _begin(self, counters: tuple[int, ...] = (), *, has_clock: bool = False) -> BlockNumbers:
        """Begin to count frames from 0, or continue after a loss of the camera; see `BlockNumbers`."""
        self._past_counts = self.status + CameraStatus(reconnects=1) if self._was_lost else CameraStatus()
        self._run, self._was_lost = None, False
        self._numbers = BlockNumbers(self._name, counters, has_clock=has_clock)
        return self._numbers

    def _when_idle(self, action: Callable[[], None]) -> None:
        """Run an action that must not happen during a read: now, or at the end of the run."""
        if self._run is None:
            action()
        else:
            self._run.when_ended(action)

    def _open_device(self) -> _Opened:
        if self._features is None:
            raise DeviceError(f"{self._name}: is not open; call open first")
        return self._features

    def _must_be_idle(self, remedy: str = "stop it first") -> None:
        if self._run is not None and not self._run.stopped:
            raise DeviceError(f"{self._name}: is running; {remedy}")

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        """Convert the library's errors into DeviceError, or CameraLost if the camera is unplugged."""
        try:
            yield
        except DeviceError as error:
            self._was_lost = self._was_lost or isinstance(error, CameraLost)
            raise
        except TimeoutError:
            raise
        except Exception as error:
            if not isinstance(error, self._library_error()):
                raise
            text = " ".join(str(getattr(error, "message", error)).split())
            if self._is_gone():
                self._was_lost = True
                raise CameraLost(f"{self._name}: is no longer connected; plug it in again ({text})") from None
            raise DeviceError(f"{self._name}: {text}{self._HINT}") from None
