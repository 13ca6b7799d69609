"""Switches the laser of a session on in a safe order, and reads its state.

The laser is turned off when `Devices` closes: `LaserService` and `ControlService` (rig.control)
switch it off at the end of their thread, also after an error.
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

_COMMAND_S = 5.0
_ANSWERS_WITHIN_S = 5.0
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
    """Switch the laser on; returns a text on what was done, empty if the laser was already on.

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
                control.submit(lambda c: c.set_laser_pulse(settings.pulse_delay_us, settings.pulse_us))
            )
        wait_for_command(control.set_laser_power_w(settings.power_w))
        wait_for_command(control.laser_on())
        pulsed = f", {settings.pulse_us:g} µs in each exposure" if settings.pulse_us else ""
        return f"laser on, {settings.power_w * 1e3:g} mW{pulsed}"
    if laser is None:
        return ""
    state = _wait(laser, lambda _: True)
    if settings.interlock == "controller":
        assert control is not None
        if state.interlock_closed and not _relay(control).laser_on:
            raise DeviceError(
                "laser.interlock = 'controller', but the laser's interlock is closed while the controller's "
                "relay is open: wire it through the relay, or set laser.interlock = 'own'"
            )
        # this closes only the relay, because the controller's own power setting is 0
        wait_for_command(control.laser_on())
        _wait(laser, lambda state: state.interlock_closed)
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
        heard = control.snapshot if control is not None else None
        if heard is None or heard.status is None:
            return LaserReport(Light.CONTROLLER_SILENT)
        status, old_s = heard.status, age_s(heard.status_time_ns)
        if old_s > STALE_S:
            return LaserReport(Light.UNKNOWN, age_s=old_s)
        if status.laser_on:
            return LaserReport(Light.ON, status.laser_power_w, age_s=old_s)
        at_odds = status.readback or status.light_seen or status.trip is Trip.OUTPUT
        return LaserReport(Light.DISAGREES if at_odds else Light.OFF, age_s=old_s)
    snapshot = laser.snapshot if laser is not None else None
    if snapshot is None or snapshot.state is None:
        return LaserReport(Light.SILENT)
    state, old_s = snapshot.state, age_s(snapshot.state_time_ns)
    if old_s > STALE_S:
        return LaserReport(Light.UNKNOWN, age_s=old_s)
    if state.on:
        return LaserReport(Light.ON, power_w=state.power_w, current_a=state.current_a, age_s=old_s)
    return LaserReport(Light.OFF if state.interlock_closed else Light.INTERLOCK_OPEN, age_s=old_s)


def age_s(heard_ns: int) -> float:
    """Time since a moment of the host's monotonic clock; infinite for 0, which means never."""
    return seconds(time.monotonic_ns() - heard_ns) if heard_ns else math.inf


def wait_for_command(command: "Future[Any]", patience_s: float = _COMMAND_S) -> None:
    """Wait until a command was carried out; raises its DeviceError, also if it takes too long."""
    try:
        command.result(patience_s)
    except TimeoutError:
        raise DeviceError(f"a command was not carried out within {patience_s:g} s") from None


def _wait(laser: LaserService, reached: Callable[[LaserState], bool]) -> LaserState:
    deadline_s = time.monotonic() + _ANSWERS_WITHIN_S
    while True:
        snapshot = laser.snapshot
        if snapshot.state is not None and reached(snapshot.state):
            return snapshot.state
        if time.monotonic() > deadline_s:
            if snapshot.state is not None:
                raise DeviceError(
                    "the laser's interlock stays open although the controller's relay is closed; "
                    "see its wiring, cover and key"
                )
            raise DeviceError(snapshot.last_error or f"the laser was silent for {_ANSWERS_WITHIN_S:g} s")
        time.sleep(0.02)


def _relay(control: ControlService) -> ControllerStatus:
    """The controller's status, once a recent one is available, which a test of the wiring needs."""
    deadline_s = time.monotonic() + _ANSWERS_WITHIN_S
    while True:
        now = control.snapshot
        if now.status is not None and age_s(now.status_time_ns) <= STALE_S:
            return now.status
        if time.monotonic() > deadline_s:
            raise DeviceError(
                f"the laser's interlock cannot be tested: {now.last_error or 'the controller was silent'}; "
                "see its cable, then start again"
            )
        time.sleep(0.02)


def check_wiring(laser: LaserSettings, controller: ControllerSettings) -> None:
    """Raise ConfigurationError if the laser is to be switched by a controller that is not configured."""
    if through_controller(laser) and controller.kind == "none":
        key = "kind" if laser.kind == "controller" else "interlock"
        instead = "laser.kind to none, and switch it by hand" if key == "kind" else "laser.interlock to own"
        raise ConfigurationError(
            f"laser.{key} = 'controller', but controller.kind = 'none': nothing switches the laser; set "
            f"controller.kind to serial or simulated, or {instead}"
        )


_ASK_AGAIN_S = 0.1
_LAST_WAIT_S = 0.2


def confirmed_dark(
    off: Callable[[], "Future[None]"], command: "Future[None]", end_s: float
) -> tuple[str, KeyboardInterrupt | None]:
    """Repeat the command until it is confirmed that the laser is off, or until `end_s`.

    Returns the reason why it is not confirmed (empty if it is), and a Ctrl-C, which does not end the wait.
    Late replies, and a port that is being opened again, are waited for. A controller without a session is
    dark.
    """
    interrupt: KeyboardInterrupt | None = None
    no_session = False
    while True:
        try:
            wait_for_command(command, max(end_s - time.monotonic(), _LAST_WAIT_S))
            return "", interrupt
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
            if time.monotonic() < end_s:
                continue
            why = "interrupted"
        except (DeviceError, CancelledError) as error:
            why = str(error) or "its thread has ended"
            no_session = no_session or isinstance(error, ControllerReset)
        if time.monotonic() > end_s - _ASK_AGAIN_S:
            return "" if no_session else why, interrupt
        try:
            time.sleep(_ASK_AGAIN_S)
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
        if command.done():
            command = off()
