"""The controller, operated in a thread: commands as futures, heartbeat, reconnection.

The serial line never delays frames: the threads that handle frames only read the latest snapshot, and no lock
is held while this thread waits for the device.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeVar

from processing.errors import DeviceError
from rig.control.controller import Controller
from rig.control.device_thread import DeviceThread
from rig.control.light_permit import Interlock, LightPermit, LightRefused
from rig.control.protocol import (
    AmbientReading,
    CommandRefused,
    ControllerIdentity,
    ControllerReset,
    ControllerStatus,
    Latch,
    Trip,
)
from rig.control.safety_state import TripCause
from rig.control.serial_port import PortLost
from rig.control.settings import ControllerSettings

_REOPEN_INTERVAL_S = 0.5
_RETRY_INTERVAL_S = 0.02
_WATCHDOG_MARGIN = 0.1
"""Fraction of the watchdog's time by which a board without useful replies is given up earlier, and commanded
off: heartbeats whose replies are lost still feed its own watchdog."""
_NO_READING = AmbientReading()
_NO_SENSOR = -240
"""Error code of the board's own sensor of ambient conditions."""

T = TypeVar("T")

_TRIP_REASONS: dict[str, str] = {
    Trip.INTERLOCK: Interlock.CONTROLLER.opened_text,
    Trip.OUTPUT: "the controller's laser output did not follow what it was set to",
    Trip.POWER: "the controller was reset or had lost its power",
    Trip.WATCHDOG: "the controller received nothing from its program for too long",
}


class ControlState(StrEnum):
    """State of the connection to the controller."""

    OPENING = "opening"
    OPEN = "open"
    LOST = "lost"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class ControlSnapshot:
    """What is known of the controller now."""

    state: ControlState = ControlState.OPENING
    identity: ControllerIdentity | None = None
    status: ControllerStatus | None = None
    status_time_ns: int = 0
    """Host monotonic time at which `status` was received."""
    environment: AmbientReading = _NO_READING
    """Reading of the board's sensor; NaN before the first, and while the controller is lost."""
    last_error: str = ""


class ControlService(DeviceThread):
    """Operates a `Controller` from `start` to `close`, which puts every output into its safe state.

    Every command, and any call by `submit`, returns a future immediately. Its error is a DeviceError: the
    controller rejected the command or is not connected, or the command waited longer than its time limit and
    was not sent (`JobExpired`). If the connection is lost, the board's watchdog puts its outputs into their
    safe state. The service then opens the controller again, but does not switch the laser on by itself.

    While `permit` refuses the light, the laser is switched off. While it says that frames have stalled, no
    heartbeat is sent either, so that the board's watchdog makes everything safe even if that command is lost.
    """

    def __init__(
        self,
        controller: Controller,
        settings: ControllerSettings,
        environment_period_s: float | None = 1.0,
        permit: LightPermit | None = None,
    ) -> None:
        self._controller = controller
        self._settings = settings
        self._permit = permit or LightPermit()
        self._last_refusal = ""
        self._off_count = 0
        # `_off_count` when the board reported light that was asked for; -1: light counts as not asked for
        self._lit_at_off_count = -1
        self._environment_period_s = environment_period_s
        self._sensor_silent = False
        self._snapshot = ControlSnapshot()
        self._is_open = False
        self._known_latch: Latch | None = None
        self._was_reset = False
        self._interlock_closed: bool | None = None
        self._status_s = 0.0
        self._environment_due_s = 0.0
        super().__init__("rig-control")

    def wait_open(self, timeout_s: float = 5.0) -> ControllerIdentity:
        """Block until the controller has answered; raises DeviceError with the reason if it does not."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            snapshot = self._snapshot
            if snapshot.state is ControlState.OPEN and snapshot.identity is not None:
                return snapshot.identity
            time.sleep(0.005)
        raise DeviceError(
            self._snapshot.last_error or f"{self._controller.name} did not answer in {timeout_s:g} s"
        )

    @property
    def snapshot(self) -> ControlSnapshot:
        """Latest state; never blocks."""
        return self._snapshot

    def submit(
        self, call: Callable[[Controller], T], timeout_s: float = 2.0, urgent: bool = False
    ) -> "Future[T]":
        """Queue any call on the controller, such as ``lambda controller: controller.brake(True)``."""
        return self._queue(lambda: self._run_job(call), timeout_s, urgent)

    def laser_on(self) -> "Future[None]":
        """Switch the laser on, unless the interlock is open or `permit` refuses.

        A `laser_off` that is called later but carried out earlier makes it invalid.
        """
        off_count = self._off_count
        return self.submit(lambda controller: self._switch_on(controller, off_count))

    def laser_off(self) -> "Future[None]":
        """Switch the laser off, before all waiting commands; done once the board has replied with its state.

        It has no time limit. If it fails, it is repeated as long as the board reports that the laser is lit.
        """
        self._off_count += 1
        return self.submit(self._switch_off, math.inf, urgent=True)

    def set_laser_power_w(self, power_w: float) -> "Future[None]":
        """Set the laser's power within its limits."""
        return self.submit(lambda controller: controller.set_laser_power_w(power_w))

    def acknowledge(self) -> "Future[None]":
        """Clear the latch that the board reported last, which a person has acknowledged; no later one."""
        status = self._snapshot.status
        latch = None if status is None else status.latch
        return self.submit(lambda controller: self._clear_latch(controller, latch))

    # -- in the thread --------------------------------------------------------

    def _poll(self) -> float:
        try:
            if not self._is_open:
                self._open()
            self._obey_permit()
            self._read_status()
            self._keep_dark()
        except DeviceError as error:
            self._note_failure(error)
            # soon, because there may be time for a further attempt before the board is given up
            return min(self._settings.heartbeat_s, _RETRY_INTERVAL_S) if self._is_open else _REOPEN_INTERVAL_S
        return self._settings.heartbeat_s

    def _open(self) -> None:
        identity = self._controller.open()
        self._is_open = True
        self._lit_at_off_count = -1
        self._note_status(time.monotonic())
        self._snapshot = replace(self._snapshot, state=ControlState.OPEN, identity=identity, last_error="")
        self._report(f"{identity.serial} is connected, firmware {identity.firmware}")
        if (latch := self._controller.earlier_latch) is not None:
            self._permit.latch_found(TripCause(latch.cause), _TRIP_REASONS[latch.cause])
        elif self._was_reset:
            self._permit.trip(TripCause.POWER, _TRIP_REASONS[Trip.POWER])
        self._known_latch, self._was_reset = latch, False

    def _switch_on(self, controller: Controller, off_count: int) -> None:
        off_reason = "it was switched off meanwhile" if self._off_count != off_count else ""
        if refusal := self._permit.refusal_to_light or off_reason:
            raise LightRefused(f"{controller.name}: the laser stays off: {refusal}")
        # until the board has reported that it is lit, it counts as dark
        self._lit_at_off_count = -1
        controller.laser_on()
        self._read_status()
        self._lit_at_off_count = off_count

    def _switch_off(self, controller: Controller) -> None:
        controller.laser_off()
        self._read_status()

    def _clear_latch(self, controller: Controller, latch: Latch | None) -> None:
        if latch is not None:
            controller.acknowledge(latch.number)
        self._read_status()

    def _obey_permit(self) -> None:
        """Switch the laser off when the permit begins to refuse it."""
        refusal = self._permit.refusal
        if refusal and not self._last_refusal:
            self._controller.laser_off()
            self._report(f"laser off: {refusal}")
        # set last, so that a command that failed is repeated at the next poll
        self._last_refusal = refusal

    def _keep_dark(self) -> None:
        """Switch off a laser that is lit against the last command: a command or its reply was lost."""
        status = self._snapshot.status
        if status is not None and status.laser_on and self._lit_at_off_count != self._off_count:
            self._report("laser off: it is still lit, a command or its answer was lost")
            self._switch_off(self._controller)

    def _read_status(self) -> None:
        controller = self._controller
        status = controller.status() if self._permit.stalled else controller.heartbeat()
        now_s, now_ns = time.monotonic(), time.monotonic_ns()
        self._note_status(now_s)
        self._snapshot = replace(self._snapshot, status=status, status_time_ns=now_ns)
        events = controller.take_events()
        for event in events:
            self._report(f"{event.name} {event.detail}".rstrip())
        self._latch_trips(status, {event.detail for event in events if event.name == "TRIP"})
        if status.errors_waiting:
            code, text = controller.next_error()
            # a board without a sensor reports this error at each request
            if code != _NO_SENSOR or not self._sensor_silent:
                self._report(f"error {code}: {text}")
            self._sensor_silent = self._sensor_silent or code == _NO_SENSOR
        if self._environment_period_s is not None and now_s >= self._environment_due_s:
            self._environment_due_s = now_s + self._environment_period_s
            environment = controller.environment()
            self._sensor_silent = self._sensor_silent and math.isnan(environment.temperature_c)
            self._snapshot = replace(self._snapshot, environment=environment)

    def _note_status(self, now_s: float) -> None:
        """Note that the board has reported its state."""
        self._status_s = now_s
        self._controller.repeat_until(now_s + self._max_silence_s)

    @property
    def _max_silence_s(self) -> float:
        """Longest time for which the board's state may be unknown."""
        return (1.0 - _WATCHDOG_MARGIN) * self._settings.watchdog_s

    def _latch_trips(self, status: ControllerStatus, event_causes: set[str]) -> None:
        """Latch each trip once, whether the board sent an event about it or only its status shows it."""
        causes, latch = set(event_causes), status.latch
        if latch is not None and (self._known_latch is None or latch.number != self._known_latch.number):
            causes.add(latch.cause)
        is_first = self._interlock_closed is None
        if not status.interlock_closed and self._interlock_closed is not False:
            causes.add(Trip.INTERLOCK)
        self._known_latch, self._interlock_closed = latch, status.interlock_closed
        for cause in sorted(causes & _TRIP_REASONS.keys()):
            latch_cause = self._permit.latch_found if is_first else self._permit.trip
            latch_cause(TripCause(cause), _TRIP_REASONS[cause])

    def _run_job(self, call: Callable[[Controller], T]) -> T:
        if not self._is_open:
            raise PortLost(
                self._snapshot.last_error or f"{self._controller.name}: the controller is not open"
            )
        try:
            return call(self._controller)
        except DeviceError as error:
            self._note_failure(error)
            raise

    def _note_failure(self, error: DeviceError) -> None:
        """Decide whether the connection is lost; a rejected command or one missing reply does not mean that.

        A board that replies without reporting its state counts as silent.
        """
        silent_s = time.monotonic() - self._status_s
        lost = (
            not self._is_open
            or isinstance(error, PortLost | ControllerReset)
            or (silent_s >= self._max_silence_s and not isinstance(error, CommandRefused | LightRefused))
        )
        if not lost:
            self._report(str(error))
            return
        self._was_reset = self._was_reset or isinstance(error, ControllerReset)
        if self._is_open or str(error) != self._snapshot.last_error:
            self._report(str(error))
        self._is_open = False
        self._snapshot = replace(
            self._snapshot,
            state=ControlState.LOST,
            status=None,
            environment=_NO_READING,
            last_error=str(error),
        )
        self._controller.close()

    def _finish(self) -> None:
        self._controller.close()
        self._is_open = False
        self._snapshot = replace(self._snapshot, state=ControlState.CLOSED, status=None)
