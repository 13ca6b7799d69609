"""The laser of a session: switching it on in a safe order, its state, and the confirmation that it is off.

`LaserService` and `ControlService` (rig.control) switch the laser off at the end of their threads, also after
an error.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Any

from processing.errors import ConfigurationError, DeviceError
from processing.units import seconds
from rig.control import (
    LASERS,
    LONGEST_JOB_S,
    STALE_S,
    ControllerReset,
    ControllerSettings,
    ControllerStatus,
    ControlService,
    LaserReport,
    LaserService,
    LaserSettings,
    LaserState,
    Light,
    Trip,
)

_MAX_COMMAND_S = 5.0
_MAX_ANSWER_S = 5.0
STAYS_LIT = "it stays lit when this program is killed"
WIRING_REMEDY = (
    "wire its interlock through the controller's enable relay and set laser.interlock = 'controller'"
)


def through_controller(settings: LaserSettings) -> bool:
    """Whether the controller drives the laser, or its relay is in the laser's interlock.

    The board's watchdog then switches the laser off if this program is killed.
    """
    return settings.kind == "controller" or (settings.kind in LASERS and settings.interlock == "controller")


def light(settings: LaserSettings, control: ControlService | None, laser: LaserService | None) -> str:
    """Switch the laser on; returns what was done in words, empty if the laser was already on.

    Raises DeviceError if the laser refuses or does not answer, if an interlock is open, or if the laser's
    interlock is not wired through the controller as configured. `check_wiring` requires `control`.
    """
    if settings.kind == "none" or laser_report(settings, control, laser).on:
        return ""
    if settings.kind == "controller":
        assert control is not None
        if settings.power_w <= 0:
            raise ConfigurationError("laser.power_w = 0: set it to the wanted power in W")
        if settings.pulse_us:
            wait_for_command(
                control.submit(
                    lambda board: board.set_laser_pulse(settings.pulse_delay_us, settings.pulse_us)
                )
            )
        wait_for_command(control.set_laser_power_w(settings.power_w))
        wait_for_command(control.laser_on())
        pulse_text = f", {settings.pulse_us:g} µs in each exposure" if settings.pulse_us else ""
        return f"laser on, {settings.power_w * 1e3:g} mW{pulse_text}"
    if laser is None:
        return ""
    state = _wait_for_state(laser, lambda _: True)
    if settings.interlock == "controller":
        assert control is not None
        if state.interlock_closed and not _recent_status(control).laser_on:
            raise DeviceError(
                "laser.interlock = 'controller', but the laser's interlock is closed while the controller's "
                "relay is open: wire it through the relay, or set laser.interlock = 'own'"
            )
        # this closes only the relay, because the controller's own power setting is 0
        wait_for_command(control.laser_on())
        _wait_for_state(laser, lambda state: state.interlock_closed)
    if settings.power_w > 0:
        wait_for_command(laser.set_power_w(settings.power_w))
    if settings.current_a > 0:
        wait_for_command(laser.set_current_a(settings.current_a))
    wait_for_command(laser.enable(), LONGEST_JOB_S)
    return "laser on" if through_controller(settings) else f"laser on; {STAYS_LIT} (docs/controller.md)"


def laser_report(
    settings: LaserSettings, control: ControlService | None, laser: LaserService | None
) -> LaserReport:
    """The last known state, unknown if it is too old; never blocks."""
    if settings.kind == "controller":
        board = control.snapshot if control is not None else None
        if board is None or board.status is None:
            return LaserReport(Light.CONTROLLER_SILENT)
        status, state_age_s = board.status, age_s(board.status_time_ns)
        if state_age_s > STALE_S:
            return LaserReport(Light.UNKNOWN, age_s=state_age_s)
        if status.laser_on:
            return LaserReport(Light.ON, status.laser_power_w, age_s=state_age_s)
        disagrees = status.readback or status.light_seen or status.trip is Trip.OUTPUT
        return LaserReport(Light.DISAGREES if disagrees else Light.OFF, age_s=state_age_s)
    snapshot = laser.snapshot if laser is not None else None
    if snapshot is None or snapshot.state is None:
        return LaserReport(Light.SILENT)
    state, state_age_s = snapshot.state, age_s(snapshot.state_time_ns)
    if state_age_s > STALE_S:
        return LaserReport(Light.UNKNOWN, age_s=state_age_s)
    if state.on:
        return LaserReport(Light.ON, power_w=state.power_w, current_a=state.current_a, age_s=state_age_s)
    return LaserReport(Light.OFF if state.interlock_closed else Light.INTERLOCK_OPEN, age_s=state_age_s)


def age_s(report_ns: int) -> float:
    """Time since a report at a time of the host's monotonic clock; infinite for 0, which means never."""
    return seconds(time.monotonic_ns() - report_ns) if report_ns else math.inf


def wait_for_command(command: "Future[Any]", timeout_s: float = _MAX_COMMAND_S) -> None:
    """Wait until a command was carried out; raises its DeviceError, also if it takes too long."""
    try:
        command.result(timeout_s)
    except TimeoutError:
        raise DeviceError(f"a command was not carried out within {timeout_s:g} s") from None


def _wait_for_state(laser: LaserService, condition: Callable[[LaserState], bool]) -> LaserState:
    deadline_s = time.monotonic() + _MAX_ANSWER_S
    while True:
        snapshot = laser.snapshot
        if snapshot.state is not None and condition(snapshot.state):
            return snapshot.state
        if time.monotonic() > deadline_s:
            if snapshot.state is not None:
                raise DeviceError(
                    "the laser's interlock stays open although the controller's relay is closed; "
                    "see its wiring, cover and key"
                )
            raise DeviceError(snapshot.last_error or f"the laser was silent for {_MAX_ANSWER_S:g} s")
        time.sleep(0.02)


def _recent_status(control: ControlService) -> ControllerStatus:
    """The controller's status, once a recent one is available; the test of the wiring needs that."""
    deadline_s = time.monotonic() + _MAX_ANSWER_S
    while True:
        snapshot = control.snapshot
        if snapshot.status is not None and age_s(snapshot.status_time_ns) <= STALE_S:
            return snapshot.status
        if time.monotonic() > deadline_s:
            reason = snapshot.last_error or "the controller was silent"
            raise DeviceError(
                f"the laser's interlock cannot be tested: {reason}; see its cable, then start again"
            )
        time.sleep(0.02)


def check_wiring(laser: LaserSettings, controller: ControllerSettings) -> None:
    """Raise ConfigurationError if the laser is to be switched by a controller that is not configured."""
    if through_controller(laser) and controller.kind == "none":
        key, alternative = "kind", "laser.kind to none, and switch it by hand"
        if laser.kind != "controller":
            key, alternative = "interlock", "laser.interlock to own"
        raise ConfigurationError(
            f"laser.{key} = 'controller', but controller.kind = 'none': nothing switches the laser; set "
            f"controller.kind to serial or simulated, or {alternative}"
        )


_REPEAT_INTERVAL_S = 0.1
_MIN_WAIT_S = 0.2
"""Shortest wait for a command, also for the last one."""


def confirmed_dark(
    off: Callable[[], "Future[None]"], command: "Future[None]", deadline_s: float
) -> tuple[str, KeyboardInterrupt | None]:
    """Repeat the command until it is confirmed that the laser is off, or until `deadline_s`.

    Returns the reason why it is not confirmed (empty if it is), and a Ctrl-C, which does not end the wait.
    The time allows for late replies, and for a port that is being opened again. A controller without a
    session is dark.
    """
    interrupt: KeyboardInterrupt | None = None
    no_session = False
    while True:
        try:
            wait_for_command(command, max(deadline_s - time.monotonic(), _MIN_WAIT_S))
            return "", interrupt
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
            if time.monotonic() < deadline_s:
                continue
            reason = "interrupted"
        except (DeviceError, CancelledError) as error:
            reason = str(error) or "its thread has ended"
            no_session = no_session or isinstance(error, ControllerReset)
        if time.monotonic() > deadline_s - _REPEAT_INTERVAL_S:
            return "" if no_session else reason, interrupt
        try:
            time.sleep(_REPEAT_INTERVAL_S)
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
        if command.done():
            command = off()
