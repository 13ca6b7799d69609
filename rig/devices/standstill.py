"""Notices that all of the program stood still: stopped by Ctrl-Z, without a processor, asleep.

Frames that came meanwhile are lost, and no camera, disk or cable is at fault. Clocks go on while a program is
stopped, so that what comes after it has its right time. While a computer sleeps its clock stands, and frames
are timed by it: then no time that follows can be believed.
"""

import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from processing.errors import DeviceError
from processing.units import seconds

_EVERY_S = 0.25
_STOOD_NS = 2_000_000_000
"""A busy computer lets a thread wait for less."""
_SLEPT_NS = 1_000_000_000
_APART_NS = 10_000_000
"""Between the readings of two clocks; more, if the program was stopped there."""


class Awake(NamedTuple):
    """Time while the computer was awake, and with its sleep; the same where the system counts none."""

    awake_ns: int
    with_sleep_ns: int


def read_awake() -> Awake:
    """Both at the same moment."""
    clock = _clock_with_sleep()
    while True:
        before_ns = time.monotonic_ns()
        with_sleep_ns = before_ns if clock is None else time.clock_gettime_ns(clock)
        if time.monotonic_ns() - before_ns < _APART_NS:
            return Awake(before_ns, with_sleep_ns)


def _clock_with_sleep() -> int | None:
    if sys.platform.startswith("linux"):
        return time.CLOCK_BOOTTIME
    # there time.monotonic is another clock, which stands while the computer sleeps
    return time.CLOCK_MONOTONIC if sys.platform == "darwin" else None


class Standstill:
    """Wakes a few times a second from `begin` to `end`, and tells by how much too late it was woken."""

    def __init__(self, told: Callable[[str], None], read: Callable[[], Awake] = read_awake) -> None:
        self._told, self._read = told, read
        self._ended = threading.Event()
        self._last = self._first = read()

    def begin(self) -> None:
        """Look, in a thread, until `end`."""
        self._last = self._first = self._read()
        threading.Thread(target=self._look_on, name="standstill", daemon=True).start()

    def end(self) -> None:
        """The thread ends soon."""
        self._ended.set()

    def look(self) -> None:
        """To be called every quarter of a second."""
        before, self._last = self._last, self._read()
        late_ns = self._last.awake_ns - before.awake_ns - round(_EVERY_S * 1e9)
        if late_ns > _STOOD_NS:
            self._told(
                f"the program stood still for {seconds(late_ns):.1f} s (Ctrl-Z, or a busy computer); "
                "frames that came meanwhile may be missing, times are right"
            )

    def raise_if_slept(self) -> None:
        """Raises DeviceError where the computer has slept since `begin`; to be asked with every frame."""
        now = self._read()
        slept_ns = (now.with_sleep_ns - self._first.with_sleep_ns) - (now.awake_ns - self._first.awake_ns)
        if slept_ns > _SLEPT_NS:
            raise DeviceError(
                f"the computer slept for {seconds(slept_ns):.0f} s, in which its clock stood: times after it "
                "cannot be believed; keep it awake while it measures (systemd-inhibit rig run ..., lid open)"
            )

    def _look_on(self) -> None:
        while not self._ended.wait(_EVERY_S):
            self.look()
