"""Checks what a driver delivers, which may be somebody's own, before anything is made of it."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus
from acquisition.frame import Frame
from processing.errors import DeviceError, RigError, in_one_line
from processing.ticks import seconds

_log = logging.getLogger(__name__)

_TYPES: Final = (np.dtype(np.uint8), np.dtype(np.uint16))
_SEEN_ALONG: Final = 64
_MOST_BUFFERS: Final = 8
"""Images that are held: drivers that fill a ring of buffers have hardly more."""
_NUMBERS: Final = ("sequence", "device_time_ns", "host_time_ns")
_MOST: Final = 1 << 63
_ENDS_S: Final = 10.0
_LATEST_NS: Final = 1_000_000_000
"""A frame that arrived later than so long from now has the time of another clock, that of the day."""


class _Seen(NamedTuple):
    """An image that was delivered, and some of its pixels as they were."""

    number: int
    image: NDArray[Any]
    pixels: NDArray[Any]


class Delivered:
    """Frames of one camera: each of the form of the first, with an image of its own and a number that rises.

    Numbers come out as plain integers: those of numpy overflow, or compute in floating point. Frames that are
    not `in_real_time` have a clock of their own.
    """

    def __init__(self, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._form: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        self._sequence: int | None = None
        self._newest: deque[_Seen] = deque(maxlen=_MOST_BUFFERS)

    def begin_again(self) -> None:
        """The camera was started again: numbers begin anew. The form of its images stays what it was."""
        self._sequence = None
        self._newest.clear()

    def checked(self, frame: object) -> Frame:
        """The frame; raises DeviceError, in one line, for what no camera may deliver."""
        if not isinstance(frame, Frame):
            raise _refusal(f"read() returned {type(frame).__name__}", "return a Frame, or None at the end")
        plain = [self._whole(name, getattr(frame, name)) for name in _NUMBERS]
        number = plain[0]
        since_ns = plain[2] - time.monotonic_ns()
        if self._in_real_time and since_ns > _LATEST_NS:
            raise _refusal(
                f"host_time_ns of frame {number} is {plain[2]}, {seconds(since_ns):+.4g} s from now",
                "it is what time.monotonic_ns() says when the frame arrives",
            )
        if self._sequence is not None and number <= self._sequence:
            raise _refusal(
                f"frame {number} came after frame {self._sequence}",
                "number the frames upwards from 0 at start(); what comes again or too late is left out, "
                "and counted in status.wrong_id",
            )
        self._sequence = number
        self._check_image(frame.image, number)
        return frame if all(map(_is_plain, frame[1:])) else Frame(frame.image, *plain)

    def _whole(self, name: str, value: object) -> int:
        if isinstance(value, int | np.integer) and not isinstance(value, bool):
            whole = int(value)
            if -_MOST <= whole < _MOST:
                return whole
        raise _refusal(
            f"{name} of a frame is {value!r} ({type(value).__name__})",
            "whole numbers of 64 bits are needed",
        )

    def _check_image(self, image: object, number: int) -> None:
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
        self._newest.append(_Seen(number, image, _some(image).copy()))


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
        # whoever writes a driver wants to see where it failed
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
        self._last = CameraStatus()
        self._remark, self._has_said = "", False

    @property
    def now(self) -> CameraStatus:
        """Never raises, whoever asks."""
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
            return self._last
        self._last = found
        return found

    def take_remark(self) -> str:
        """What is to be said since the last call; usually nothing."""
        remark, self._remark = self._remark, ""
        return remark


def _is_plain(value: object) -> bool:
    return type(value) is int


def _some(image: NDArray[Any]) -> NDArray[Any]:
    """Some thousand of the pixels, from everywhere; nothing is copied."""
    down, across = (max(size // _SEEN_ALONG, 1) | 1 for size in image.shape)
    return image[::down, ::across]


def _refusal(what: str, remedy: str) -> DeviceError:
    return DeviceError(f"camera: {what}; {remedy}")
