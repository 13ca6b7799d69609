"""A laser with a port of its own, operated in a thread: commands as futures, state, reconnection."""

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import TypeVar

from processing.errors import DeviceError
from rig.control.device_thread import DeviceThread
from rig.control.lasers.serial_laser import ON_WITHIN_S, LaserState, SerialLaser
from rig.control.light_permit import Interlock, LightPermit, LightRefused
from rig.control.safety_state import TripCause
from rig.control.serial_port import PortLost, ReplyTimeout

_REOPEN_INTERVAL_S = 1.0
_POLL_INTERVAL_S = 0.5
LONGEST_JOB_S = 2.0 * ON_WITHIN_S
"""Longest time of one command: switching on, with the delay of the safety class, and repeated queries."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class LaserSnapshot:
    """What is known of the laser now."""

    state: LaserState | None = None
    """Latest state; None while the laser does not answer."""
    state_time_ns: int = 0
    """Host monotonic time at which `state` was read."""
    last_error: str = ""


class LaserService(DeviceThread):
    """Operates a laser from `start` to `close`; commands return futures, as in `ControlService`.

    If the connection is lost, the laser is opened again; `SerialLaser.open` switches it off. While `permit`
    refuses the light, the laser is switched off. `has_own_interlock` is False for a laser whose interlock is
    the controller's relay, which opens whenever the controller switches the light off.
    """

    def __init__(
        self,
        laser: SerialLaser,
        permit: LightPermit | None = None,
        *,
        has_own_interlock: bool = True,
    ) -> None:
        self._laser = laser
        self._permit = permit or LightPermit()
        self._has_own_interlock = has_own_interlock
        self._last_refusal = ""
        self._last_dark_reason = ""
        self._light_requested = False
        self._off_count = 0
        self._is_open = False
        self._snapshot = LaserSnapshot()
        super().__init__("rig-laser", LONGEST_JOB_S)

    @property
    def snapshot(self) -> LaserSnapshot:
        """Latest state; never blocks."""
        return self._snapshot

    def enable(self) -> "Future[None]":
        """Switch the laser on, unless the interlock is open or `permit` refuses; may take several seconds.

        A call of `off` before the laser emits makes it invalid.
        """
        off_count = self._off_count
        return self._submit(lambda laser: self._switch_on(laser, off_count))

    def off(self) -> "Future[None]":
        """Switch the laser off, before all waiting commands; it has no time limit.

        Waiting calls of `enable` become invalid.
        """
        self._off_count += 1
        return self._submit(self._switch_off, math.inf, urgent=True)

    def set_power_w(self, power_w: float) -> "Future[None]":
        """Set the optical power."""
        return self._submit(lambda laser: laser.set_power_w(power_w))

    def set_current_a(self, current_a: float) -> "Future[None]":
        """Set the diode current."""
        return self._submit(lambda laser: laser.set_current_a(current_a))

    def _submit(
        self, call: Callable[[SerialLaser], T], timeout_s: float = 5.0, urgent: bool = False
    ) -> "Future[T]":
        return self._queue(lambda: self._run_job(call), timeout_s, urgent)

    def _poll(self) -> float:
        try:
            if not self._is_open:
                identity = self._laser.open()
                self._is_open = True
                self._snapshot = replace(self._snapshot, last_error="")
                self._report(f"{identity.text} open, dark")
            self._obey_permit()
            self._read()
        except DeviceError as error:
            self._lose(error)
            return _REOPEN_INTERVAL_S
        return _POLL_INTERVAL_S

    def _switch_on(self, laser: SerialLaser, off_count: int) -> None:
        def off_reason() -> str:
            return "it was switched off meanwhile" if self._off_count != off_count else ""

        # a laser that may be lit already is switched off by this thread, which then waits for no disk
        refusal = self._permit.refusal if self._light_requested else self._permit.refusal_to_light
        if reason := refusal or off_reason():
            raise LightRefused(f"the laser stays off: {reason}")
        self._light_requested = True
        try:
            # from memory: a disk that hangs must not hold up what could switch the laser off again
            laser.enable(lambda: self._permit.refusal or off_reason())
        except BaseException:
            # the caller learns that the laser is dark, so later light counts as not requested
            self._light_requested = False
            raise

    def _switch_off(self, laser: SerialLaser) -> None:
        self._light_requested = False
        laser.off()

    def _obey_permit(self) -> None:
        """Switch the laser off when the permit begins to refuse it."""
        refusal = self._permit.refusal
        if refusal and not self._last_refusal:
            self._switch_off(self._laser)
            self._report(f"laser off: {refusal}")
        # set last, so that a command that failed is repeated at the next turn
        self._last_refusal = refusal

    def _read(self) -> None:
        previous, state = self._snapshot.state, self._laser.state()
        if state.on and not self._light_requested and not state.dark_reason:
            state = replace(state, dark_reason="it is lit, but not by this program: check its panel and key")
        self._snapshot = replace(self._snapshot, state=state, state_time_ns=time.monotonic_ns())
        if state.dark_reason:
            try:
                self._switch_off(self._laser)
            finally:
                if state.dark_reason != self._last_dark_reason:
                    self._last_dark_reason = state.dark_reason
                    self._report(f"laser off: {state.dark_reason}")
                    self._permit.trip(TripCause.OUTPUT, state.dark_reason)
        self._last_dark_reason = state.dark_reason
        if (previous is None or previous.interlock_closed) and not state.interlock_closed:
            if previous is not None:
                self._report("interlock opened")
            if self._has_own_interlock:
                latch = self._permit.latch_found if previous is None else self._permit.trip
                latch(TripCause.INTERLOCK, Interlock.LASER.opened_text)
        if state.fault and (previous is None or previous.fault != state.fault):
            self._report(state.fault)

    def _run_job(self, call: Callable[[SerialLaser], T]) -> T:
        if not self._is_open:
            raise PortLost(self._snapshot.last_error or "the laser is not open")
        try:
            result = call(self._laser)
            self._read()
        except (PortLost, ReplyTimeout) as error:
            self._lose(error)
            raise
        return result

    def _lose(self, error: DeviceError) -> None:
        if str(error) != self._snapshot.last_error:
            self._report(str(error))
        was_open, self._is_open, self._light_requested = self._is_open, False, False
        self._snapshot = replace(self._snapshot, state=None, last_error=str(error))
        self._laser.close()
        if was_open:
            # its interlock may open and close meanwhile, unnoticed by this program
            self._permit.trip(TripCause.WATCHDOG, f"the laser was lost: {error}")

    def _finish(self) -> None:
        self._laser.close()
        self._is_open = False
        self._snapshot = replace(self._snapshot, state=None)
