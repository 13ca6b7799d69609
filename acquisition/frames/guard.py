"""Checks what a driver delivers and does, which may be somebody's own, before anything is made of it."""

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
from processing.errors import DeviceError, RigError, in_one_line
from processing.units import seconds

_log = logging.getLogger(__name__)

_TYPES: Final = (np.dtype(np.uint8), np.dtype(np.uint16))
_SEEN_ALONG: Final = 64
_MOST_BUFFERS: Final = 8
"""Images that are held: drivers that fill a ring of buffers have hardly more."""
_MOST: Final = 1 << 63
_ENDS_S: Final = 10.0
HANGS_S: Final = 10.0
"""Longer than it was asked to wait: a `read` that has not returned then is not waited for."""
_ELSEWHERE: Final = -1
_LATEST_NS: Final = 1_000_000_000
"""A frame that arrived later than so long from now has the time of another clock, that of the day."""
NO_TIME_NS: Final = 1 << 62
"""Later than any clock, 146 years; sums of times no longer fit."""
MOST_PPM: Final = 1000.0
"""A quartz is right within 100 ppm: a clock that runs otherwise counts in another unit than was believed."""
_STRETCH_NS: Final = 2_000_000_000
"""A delay of 2 ms, kept up from one stretch to the next, makes `MOST_PPM`."""
_FEWEST: Final = 60
_IN_A_ROW: Final = 3
_SPREAD: Final = 0.2
"""A wrong unit shows the same each time; a busy computer's delays do not within a fifth of themselves."""


class _LastImage(NamedTuple):
    """An image that was delivered, and some of its pixels as they were."""

    number: int
    image: NDArray[Any]
    pixels: NDArray[Any]


class CheckedFrames:
    """Frames of one camera: each of the form of the first, with an image of its own and a number that rises.

    Numbers come out as plain integers: those of numpy overflow, or compute in floating point. Frames that are
    not `in_real_time` have a clock of their own.
    """

    def __init__(self, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._form: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        self._sequence: int | None = None
        self._newest: deque[_LastImage] = deque(maxlen=_MOST_BUFFERS)

    def begin_again(self) -> None:
        """The camera was started again: numbers begin anew. The form of its images stays what it was."""
        self._sequence = None
        self._newest.clear()

    def checked(self, frame: object) -> Frame:
        """The frame; raises DeviceError, in one line, for what no camera may deliver."""
        if not isinstance(frame, Frame):
            raise _refusal(f"read() returned {type(frame).__name__}", "return a Frame, or None at the end")
        image, *numbers = frame
        if self._in_real_time and isinstance(frame.device_time_ns, int) and frame.device_time_ns >= _MOST:
            # of a counter without a sign that shows nothing: one wrong time is no reason to end a run
            numbers[1] = _MOST - 1
            frame = frame._replace(device_time_ns=numbers[1])
        if set(map(type, numbers)) != {int} or not -_MOST <= min(numbers) <= max(numbers) < _MOST:
            numbers = [_whole(name, one) for name, one in zip(Frame._fields[1:], numbers, strict=True)]
            frame = Frame(image, *numbers)
        number, _, host_time_ns = numbers
        since_ns = host_time_ns - time.monotonic_ns()
        if self._in_real_time and since_ns > _LATEST_NS:
            raise _refusal(
                f"host_time_ns of frame {number} is {host_time_ns}, {seconds(since_ns):+.4g} s from now",
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
            (shape, kind), (ny, nx) = self._form, image.shape
            raise _refusal(
                f"frame {number} has {nx} x {ny} pixels of {image.dtype}, those before had "
                f"{shape[1]} x {shape[0]} of {kind}",
                "leave its settings alone while it runs, then measure again",
            )
        for before in self._newest:
            may_have_changed = before is self._newest[-1] or np.may_share_memory(before.image, image)
            if may_have_changed and not np.array_equal(_some(before.image), before.pixels):
                raise _refusal(
                    f"the image of frame {before.number} has changed since it was delivered",
                    "its driver fills the same buffers again and again; give each frame an image of its own: "
                    "image.copy()",
                )
        self._newest.append(_LastImage(number, image, _some(image).copy()))
        return frame


def checked_info(info: object, driver: str) -> CameraInfo:
    """What `open` returned; raises DeviceError where it is none, or cannot be true."""
    if not isinstance(info, CameraInfo):
        raise _refusal(f"open() of driver {driver!r} returned {type(info).__name__}", "return a CameraInfo")
    for name in ("width_px", "height_px", "full_scale_dn"):
        value: object = getattr(info, name)
        if not isinstance(value, int | np.integer) or value < 1:
            raise _refusal(f"{name} of driver {driver!r} is {value!r}", "state a whole number above 0")
    return info


def checked_settings(applied: object, driver: str) -> CameraSettings:
    """What `configure` returned; raises DeviceError where it is none."""
    if not isinstance(applied, CameraSettings):
        raise _refusal(
            f"configure() of driver {driver!r} returned {type(applied).__name__}",
            "return the CameraSettings that hold now",
        )
    return applied


@contextmanager
def asking(camera: str, what: str) -> Iterator[None]:
    """What a driver raises, which may be somebody's own, becomes a DeviceError of one line."""
    try:
        yield
    except RigError:
        raise
    except Exception as error:
        # the author of a driver wants to see where it failed
        _log.error("%s: %s failed", camera, what, exc_info=error)
        raise DeviceError(f"{camera}: {what} failed: {in_one_line(error)}") from error


def ended(ending: Callable[[], object], name: str, patience_s: float = _ENDS_S) -> str:
    """Call what stops or closes a camera, and wait no longer than that; returns what speaks against it.

    What is measured is measured: it must not be lost to a driver that cannot end.
    """
    raised: list[Exception] = []

    def end() -> None:
        try:
            ending()
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=end, name=name, daemon=True)
    thread.start()
    thread.join(patience_s)
    if thread.is_alive():
        return f"{name} has not returned for {patience_s:g} s, and is left to itself"
    return f"{name} failed: {in_one_line(raised[0])}" if raised else ""


class Counts:
    """The counts of a camera; of one that cannot tell them any more, those that it told last.

    `take_remark` says so, once: frames that are missing are seen by their numbers all the same.
    """

    def __init__(self, ask: Callable[[], object]) -> None:
        self._ask = ask
        self._last = self._before = CameraStatus()
        self._remark, self._has_said = "", False

    @property
    def now(self) -> CameraStatus:
        """Never raises."""
        try:
            found = self._ask()
            if not isinstance(found, CameraStatus):
                raise TypeError(f"status is {type(found).__name__}, no CameraStatus")
        except Exception as error:
            if not self._has_said:
                self._has_said = True
                self._remark = (
                    f"cannot be read any more: {in_one_line(error)}; frames that are missing are seen by "
                    "their numbers"
                )
            return self._before + self._last
        self._last = found
        return self._before + found

    def go_on(self, before: CameraStatus) -> None:
        """The camera was lost, when it had told the counts `before`, and started again: a driver that has
        noticed the loss counts on, any other begins again.
        """
        if self.now.reconnects == before.reconnects:
            self._before = before

    def take_remark(self) -> str:
        """What is to be said since the last call; usually nothing."""
        remark, self._remark = self._remark, ""
        return remark


class HangingRead:
    """Notices a `read` that does not return: told by the thread that reads, asked by the one that waits.

    It counts the waits of the latter, not a clock: while the program stands still nobody waits.
    """

    def __init__(self, asked_s: float, hangs_s: float = HANGS_S) -> None:
        self._asked_s, self._longest_s = asked_s, asked_s + hangs_s
        self._reads = 0
        self._now = self._then = _ELSEWHERE
        self._waited_s = 0.0

    def begins(self) -> None:
        """A `read` begins."""
        self._reads += 1
        self._now = self._reads

    def is_elsewhere(self) -> None:
        """The thread does something that has a limit of its own."""
        self._now = _ELSEWHERE

    def after(self, waited_s: float) -> str:
        """What is to be said after so long without a frame; 0 with one."""
        same = self._now == self._then and self._now != _ELSEWHERE
        self._waited_s = self._waited_s + waited_s if same and waited_s else 0.0
        self._then = self._now
        if self._waited_s < self._longest_s:
            return ""
        return (
            f"camera: read() has not returned for {self._waited_s:.0f} s; it was asked to wait for "
            f"{self._asked_s:g} s at most: its driver hangs"
        )


class ClockWatch:
    """Compares the clocks over the first seconds of frames, whatever the driver.

    A wrong unit shows in any stretch of frames, each time as much. Of each stretch the frame counts that came
    soonest after its time: those that a busy computer takes late say nothing. What still looks like a wrong
    unit is refused if three in a row show the same.
    """

    def __init__(self) -> None:
        self._found: list[float] = []
        self._done = False
        self.begin_again()

    def begin_again(self) -> None:
        """The camera was opened again: the stretch begins again."""
        self._soonest: list[tuple[int, int]] = []
        self._since_ns, self._count = -1, 0

    def see(self, frame: Frame) -> None:
        """Take the next frame into account; raises DeviceError if the clock cannot be right."""
        if self._done or not 0 <= frame.device_time_ns < NO_TIME_NS:
            return
        host_ns, late_ns = frame.host_time_ns, frame.host_time_ns - frame.device_time_ns
        if not self._count:
            self._since_ns = host_ns
            self._soonest = [*self._soonest[-1:], (late_ns, host_ns)]
        self._soonest[-1] = min(self._soonest[-1], (late_ns, host_ns))
        self._count += 1
        if host_ns - self._since_ns < _STRETCH_NS or self._count < _FEWEST:
            return
        self._count = 0
        if len(self._soonest) > 1:
            self._compare()

    def _compare(self) -> None:
        (late_before_ns, before_ns), (late_ns, host_ns) = self._soonest
        drift_ppm = 1e6 * (late_before_ns - late_ns) / max(host_ns - before_ns, 1)
        if abs(drift_ppm) <= MOST_PPM:
            self._done = True
            return
        self._found = [*self._found, drift_ppm][-_IN_A_ROW:]
        mean = sum(self._found) / len(self._found)
        same = all(abs(drift - mean) < _SPREAD * abs(mean) for drift in self._found)
        if len(self._found) == _IN_A_ROW and same:
            raise DeviceError(
                f"{as_fast(mean)}, at most {MOST_PPM:g} ppm are possible: its times cannot be used; "
                "the driver misreads its unit, or the computer's clock was set: see rig doctor"
            )


def as_fast(drift_ppm: float) -> str:
    """The rate of the camera's clock in words."""
    return f"the camera's clock runs {1.0 + 1e-6 * drift_ppm:.6g} times as fast as the computer's"


def _whole(name: str, value: object) -> int:
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and -_MOST <= value < _MOST:
        return int(value)
    raise _refusal(
        f"{name} of a frame is {value!r} ({type(value).__name__})", "whole numbers of 64 bits are needed"
    )


def _some(image: NDArray[Any]) -> NDArray[Any]:
    """Some thousand of the pixels, from everywhere; nothing is copied."""
    ny, nx = image.shape
    return image[:: max(ny // _SEEN_ALONG, 1) | 1, :: max(nx // _SEEN_ALONG, 1) | 1]


def _refusal(what: str, remedy: str) -> DeviceError:
    return DeviceError(f"camera: {what}; {remedy}")
