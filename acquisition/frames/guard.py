"""Checks of a camera driver, perhaps a user's own: its frames, its settings, its clock, its hanging calls."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus, Frame
from processing.errors import DeviceError, RigError, one_line_text
from processing.units import seconds

_log = logging.getLogger(__name__)

_TYPES: Final = (np.dtype(np.uint8), np.dtype(np.uint16))
_PIXELS_PER_AXIS: Final = 64
"""Approximate number of pixels that are compared along each axis."""
_MAX_BUFFERS: Final = 8
"""Images kept for comparison; a driver's ring of buffers rarely has more."""
_INT_END: Final = 1 << 63
"""End of the signed integers of 64 bits."""
_END_TIMEOUT_S: Final = 10.0
"""Longest wait for a `stop` or `close`."""
READ_GRACE_S: Final = 10.0
"""A `read` that exceeds its timeout by this much hangs, and is abandoned."""
_MAX_FUTURE_NS: Final = 1_000_000_000
"""A host time further in the future than this comes from another clock, such as UTC."""
NO_TIME_NS: Final = 1 << 62
"""Times beyond this (146 years) are invalid, because their sums overflow."""
MAX_DRIFT_PPM: Final = 1000.0
"""Largest drift of a clock. A quartz is right within 100 ppm; beyond this, the driver misreads its unit."""
_STRETCH_NS: Final = 2_000_000_000
"""Length of a stretch of frames: 2 ms more delay in the next one are a drift of `MAX_DRIFT_PPM`."""
_MIN_FRAMES: Final = 60
"""Fewest frames of a stretch."""
_AGREEING_STRETCHES: Final = 3
"""Consecutive stretches whose drifts must agree."""
_MAX_SPREAD: Final = 0.2
"""Largest relative spread of drifts that a wrong unit causes; the delays of a busy computer vary more."""


class _LastImage(NamedTuple):
    """A delivered image, and a copy of some of its pixels."""

    number: int
    image: NDArray[Any]
    pixels: NDArray[Any]


class FrameChecks:
    """Checks frames of one camera: shape and type as the first, an image array of their own, rising numbers.

    Numbers are returned as plain integers, because those of numpy overflow, or compute in floating point.
    Only frames `in_real_time` are compared with the host's clock.
    """

    def __init__(self, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._form: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        self._sequence: int | None = None
        self._newest: deque[_LastImage] = deque(maxlen=_MAX_BUFFERS)

    def restart(self) -> None:
        """Accept numbers from 0 again, after a restart; shape and type of images must stay."""
        self._sequence = None
        self._newest.clear()

    def check(self, frame: object) -> Frame:
        """Check and return a frame; raises DeviceError, in one line, if invalid."""
        if not isinstance(frame, Frame):
            raise _refusal(f"read() returned {type(frame).__name__}", "return a Frame, or None at the end")
        image, *numbers = frame
        if self._in_real_time and isinstance(frame.device_time_ns, int) and frame.device_time_ns >= _INT_END:
            # an unsigned counter's "no value"; one wrong time is no reason to end a run
            numbers[1] = _INT_END - 1
            frame = frame._replace(device_time_ns=numbers[1])
        if set(map(type, numbers)) != {int} or not -_INT_END <= min(numbers) <= max(numbers) < _INT_END:
            numbers = list(map(_whole_number, Frame._fields[1:], numbers))
            frame = Frame(image, *numbers)
        number, _, host_time_ns = numbers
        ahead_ns = host_time_ns - time.monotonic_ns()
        if self._in_real_time and ahead_ns > _MAX_FUTURE_NS:
            raise _refusal(
                f"host_time_ns of frame {number} is {host_time_ns}, {seconds(ahead_ns):+.4g} s from now",
                "it is what time.monotonic_ns() says when the frame arrives",
            )
        if self._sequence is not None and number <= self._sequence:
            raise _refusal(
                f"frame {number} came after frame {self._sequence}",
                "number the frames upwards from 0 at start(); what comes again or too late is left out, "
                "and counted in status.wrong_id",
            )
        self._sequence = number
        if not isinstance(image, np.ndarray):
            raise _refusal(f"the image of frame {number} is {type(image).__name__}", "make it a numpy array")
        if image.ndim != 2 or image.dtype not in _TYPES or not image.size:
            raise _refusal(
                f"the image of frame {number} has shape {image.shape} and type {image.dtype}",
                "(ny, nx) of uint8 or uint16, in this computer's order of bytes, is needed",
            )
        form = (image.shape, image.dtype)
        self._form = self._form or form
        if form != self._form:
            (shape, dtype), (ny, nx) = self._form, image.shape
            raise _refusal(
                f"frame {number} has {nx} x {ny} pixels of {image.dtype}, those before had "
                f"{shape[1]} x {shape[0]} of {dtype}",
                "leave its settings alone while it runs, then measure again",
            )
        for earlier in self._newest:
            may_have_changed = earlier is self._newest[-1] or np.may_share_memory(earlier.image, image)
            if may_have_changed and not np.array_equal(_sampled_pixels(earlier.image), earlier.pixels):
                raise _refusal(
                    f"the image of frame {earlier.number} has changed since it was delivered",
                    "its driver fills the same buffers again and again; give each frame an image of its own: "
                    "image.copy()",
                )
        self._newest.append(_LastImage(number, image, _sampled_pixels(image).copy()))
        return frame


def check_info(info: object, driver: str) -> CameraInfo:
    """The CameraInfo of `open`; raises DeviceError for another type or value."""
    if not isinstance(info, CameraInfo):
        raise _refusal(f"open() of driver {driver!r} returned {type(info).__name__}", "return a CameraInfo")
    for name in ("width_px", "height_px", "full_scale_dn"):
        value: object = getattr(info, name)
        if not isinstance(value, int | np.integer) or value < 1:
            raise _refusal(f"{name} of driver {driver!r} is {value!r}", "state a whole number above 0")
    return info


def check_applied_settings(applied: object, driver: str) -> CameraSettings:
    """The settings of `configure`; DeviceError for another type."""
    if not isinstance(applied, CameraSettings):
        raise _refusal(
            f"configure() of driver {driver!r} returned {type(applied).__name__}",
            "return the CameraSettings that hold now",
        )
    return applied


@contextmanager
def driver_errors(camera: str, what: str) -> Iterator[None]:
    """Turn a driver's exception, unless a RigError, into a DeviceError of one line."""
    try:
        yield
    except RigError:
        raise
    except Exception as error:
        # the traceback tells the author of a driver where it failed
        _log.error("%s: %s failed", camera, what, exc_info=error)
        raise DeviceError(f"{camera}: {what} failed: {one_line_text(error)}") from error


def end_within(ending: Callable[[], object], name: str, timeout_s: float = _END_TIMEOUT_S) -> str:
    """Call `ending` (stop or close) and wait for at most `timeout_s`; returns the problem, or "".

    Measured data must not be lost because a driver hangs.
    """
    errors: list[Exception] = []

    def end() -> None:
        try:
            ending()
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=end, name=name, daemon=True)
    thread.start()
    thread.join(timeout_s)
    if thread.is_alive():
        return f"{name} has not returned for {timeout_s:g} s, and is left to itself"
    return f"{name} failed: {one_line_text(errors[0])}" if errors else ""


class CameraCounts:
    """The frame counts of a camera, or the last known ones if it can no longer report them.

    `take_remark` reports such a failure once; missing frames still show in the frame numbers.
    """

    def __init__(self, read_status: Callable[[], object]) -> None:
        self._read_status = read_status
        self._last = self._before_restart = CameraStatus()
        self._remark, self._failure_reported = "", False

    @property
    def latest(self) -> CameraStatus:
        """Latest known counts; never raises."""
        try:
            status = self._read_status()
            if not isinstance(status, CameraStatus):
                raise TypeError(f"status is {type(status).__name__}, no CameraStatus")
        except Exception as error:
            if not self._failure_reported:
                self._failure_reported = True
                self._remark = (
                    f"cannot be read any more: {one_line_text(error)}; frames that are missing are seen by "
                    "their numbers"
                )
        else:
            self._last = status
        return self._before_restart + self._last

    def go_on(self, at_loss: CameraStatus) -> None:
        """Take account of a restart after the camera was lost; `at_loss` are its counts at the loss.

        A driver that has noticed the loss continues its counts; any other begins again at 0.
        """
        if self.latest.reconnects == at_loss.reconnects:
            self._before_restart = at_loss

    def take_remark(self) -> str:
        """The warning since the last call; usually empty."""
        remark, self._remark = self._remark, ""
        return remark


class ReadMonitor:
    """Detects a `read` that does not return.

    The reading thread calls `enter` and `leave`, the waiting thread `check`. Waits are added up, because a
    clock would also run while the program is suspended.
    """

    def __init__(self, timeout_s: float, grace_s: float = READ_GRACE_S) -> None:
        self._timeout_s, self._limit_s = timeout_s, timeout_s + grace_s
        self._read: object | None = None
        self._read_at_last_check: object | None = None
        self._waited_s = 0.0

    def enter(self) -> None:
        """Note that a `read` begins."""
        self._read = object()

    def leave(self) -> None:
        """Note that the thread is in another call, which has its own limit."""
        self._read = None

    def check(self, waited_s: float) -> str:
        """Add a wait (0: a frame came); returns a message if the `read` hangs, else ""."""
        # the reading thread may change it meanwhile
        read = self._read
        is_same_read = read is not None and read is self._read_at_last_check
        self._waited_s = self._waited_s + waited_s if is_same_read and waited_s else 0.0
        self._read_at_last_check = read
        if self._waited_s < self._limit_s:
            return ""
        return (
            f"camera: read() has not returned for {self._waited_s:.0f} s; it was asked to wait for "
            f"{self._timeout_s:g} s at most: its driver hangs"
        )


class ClockCheck:
    """Compares the camera's clock with the computer's over the first seconds of frames.

    A wrong unit shows as the same drift in every stretch of frames. Each stretch is represented by its
    frame of smallest delay, since a busy computer takes others late. A drift above `MAX_DRIFT_PPM` is refused
    if three consecutive stretches agree on it.
    """

    def __init__(self) -> None:
        self._drifts_ppm: list[float] = []
        self._done = False
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch, after the camera was reopened."""
        self._stretch: list[tuple[int, int]] = []
        self._last_minimum: tuple[int, int] | None = None

    def see(self, frame: Frame) -> None:
        """Take the next frame into account; raises DeviceError if the clock cannot be right."""
        if self._done or not 0 <= frame.device_time_ns < NO_TIME_NS:
            return
        stretch, host_ns = self._stretch, frame.host_time_ns
        stretch.append((host_ns - frame.device_time_ns, host_ns))
        if host_ns - stretch[0][1] < _STRETCH_NS or len(stretch) < _MIN_FRAMES:
            return
        previous, self._last_minimum, self._stretch = self._last_minimum, min(stretch), []
        if previous is not None:
            self._compare(*previous, *self._last_minimum)

    def _compare(self, delay1_ns: int, host1_ns: int, delay2_ns: int, host2_ns: int) -> None:
        """Compare the smallest delays of two stretches, at these times of the computer's clock."""
        drift_ppm = 1e6 * (delay1_ns - delay2_ns) / max(host2_ns - host1_ns, 1)
        if abs(drift_ppm) <= MAX_DRIFT_PPM:
            self._done = True
            return
        self._drifts_ppm = [*self._drifts_ppm, drift_ppm][-_AGREEING_STRETCHES:]
        mean_ppm = sum(self._drifts_ppm) / len(self._drifts_ppm)
        agree = all(abs(drift - mean_ppm) < _MAX_SPREAD * abs(mean_ppm) for drift in self._drifts_ppm)
        if len(self._drifts_ppm) == _AGREEING_STRETCHES and agree:
            raise DeviceError(
                f"{clock_rate_text(mean_ppm)}, at most {MAX_DRIFT_PPM:g} ppm are possible: its times cannot "
                "be used; the driver misreads its unit, or the computer's clock was set: see rig doctor"
            )


def clock_rate_text(drift_ppm: float) -> str:
    """The rate of the camera's clock in words."""
    return f"the camera's clock runs {1.0 + 1e-6 * drift_ppm:.6g} times as fast as the computer's"


def _whole_number(name: str, value: object) -> int:
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and -_INT_END <= value < _INT_END:
        return int(value)
    raise _refusal(
        f"{name} of a frame is {value!r} ({type(value).__name__})", "whole numbers of 64 bits are needed"
    )


def _sampled_pixels(image: NDArray[Any]) -> NDArray[Any]:
    """View of some thousand pixels, spread over the image."""
    ny, nx = image.shape
    return image[:: max(ny // _PIXELS_PER_AXIS, 1) | 1, :: max(nx // _PIXELS_PER_AXIS, 1) | 1]


def _refusal(what: str, remedy: str) -> DeviceError:
    return DeviceError(f"camera: {what}; {remedy}")
