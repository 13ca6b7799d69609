"""Controller and laser of a rig, and the program's only way to light and to darken the laser."""

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

from acquisition.camera import Camera
from processing.errors import DeviceError, RigError
from rig.control import (
    NEEDS_REQUEST,
    STALE_S,
    ControlService,
    ControlState,
    Interlock,
    LaserReport,
    LaserService,
    LatchedTrip,
    Light,
    LightPermit,
    LightRefused,
    Loop,
    SafetyNow,
    SafetyState,
    Trip,
    TripCause,
    rig_state_path,
)
from rig.devices.audit import AuditEntry, AuditLog
from rig.devices.laser import (
    STAYS_LIT,
    age_s,
    check_wiring,
    confirmed_dark,
    laser_report,
    light,
    through_controller,
    wait_for_command,
)
from rig.settings import Configuration

_POLL_INTERVAL_S = 0.02
_MAX_BOARD_CONFIRM_S, _MAX_LASER_CONFIRM_S = 2.0, 5.0
"""Longest waits for a confirmation that the laser is off, which is commanded before."""
_MAX_DARK_FRAMES_S = 3.0
"""Longest search for frames that show that the laser is off."""
_MAX_REPORT_S = 3.0
"""Longest wait for the reports of the devices."""
LEFT_LIT = "a program that had lit the laser was killed, or could not say that it is off"
_SPOT_VISIBLE = "the laser was commanded off, but the camera still sees its spot"
SWITCHED_BY_HAND = "no laser is switched by this program: turn its key"
_SILENT_STATES = (Light.SILENT, Light.CONTROLLER_SILENT)


class LitDevices:
    """The devices that can light, opened by `Devices`.

    After a trip nothing is lit until a person has acknowledged it by its number and a person asks for light
    again. The trip belongs to the rig, not to a session: `SafetyState`.
    """

    def __init__(self, config: Configuration, folder: Path | None, task: str) -> None:
        check_wiring(config.laser, config.controller)
        self._config = config
        self.control: ControlService | None = None
        self.laser: LaserService | None = None
        self.state = SafetyState(rig_state_path(config.laser, config.controller), task)
        self._log = AuditLog(folder, config.session.operator, task)
        self._task = task
        self._light_lock = threading.Lock()
        self._was_lit = self._is_lit = self._is_contradicted = False
        self.lights_again = True
        """False once the session will not light the laser any more."""
        self.permit = LightPermit(state=self.state, on_trip=self._note_trip)

    def light(self, *, on_request: bool = False, in_run: bool = False) -> str:
        """Switch the laser on; returns what was done. Raises as `rig.devices.laser.light`.

        `on_request` states that a person asks for light now, which is required after a trip, also after an
        acknowledged one. A request `in_run` is valid only while the present run processes frames. From the
        call on frames must be read and taken, else the laser is switched off again (`LightPermit`). Raises
        LightRefused while a trip is not acknowledged. Nothing else in this program lights a laser.
        """
        self.obey_presses()
        if trip := self.permit.latched:
            self.audit(AuditEntry.REFUSED, trip.text)
            raise LightRefused(f"the laser stays off: {trip.text}; {self.remedy}")
        # before the wait for the lock: a trip during the wait then counts as later than the request
        if on_request:
            self.permit.request_light()
        # the later of a run and an order that light at the same time finds the laser lit
        with self._light_lock:
            return self._light_once(in_run)

    @property
    def remedy(self) -> str:
        """Instruction to a person on the latched trip; empty without one."""
        trip = self.permit.latched
        if trip is None:
            return ""
        if self._config.laser.kind == "none":
            return f"{SWITCHED_BY_HAND}, then start again"
        if self.state.path is None:
            return "it is a simulated laser: start again"
        return (
            f"check that nobody is in the beam path, then rig light acknowledge {self._config.command_words} "
            f"{trip.number}, or at the desk"
        )

    def _light_once(self, in_run: bool) -> str:
        kind = self._config.laser.kind
        if self.permit.needs_request:
            self.audit(AuditEntry.REFUSED, NEEDS_REQUEST)
            raise LightRefused(NEEDS_REQUEST)
        if reason := self.darkness():
            self.note_dark(reason)
            if self.state.path is not None or not through_controller(self._config.laser):
                # without a note in the rig's state a trip would be forgotten
                try:
                    self.state.note_light(True)
                except DeviceError as error:
                    self.audit(AuditEntry.REFUSED, str(error))
                    raise LightRefused(f"the laser stays off: {error}") from None
            # before it is lit, because a disk may hang
            self.audit(AuditEntry.LIT, f"asked for by {self._task}", laser=kind)
            self._log.wait()
            self._was_lit = self._is_lit = True
        if not in_run:
            self.permit.begin()
        try:
            return light(self._config.laser, self.control, self.laser)
        except DeviceError as error:
            self.audit(AuditEntry.REFUSED, str(error))
            if self.laser is not None and self.laser.snapshot.state is None:
                raise self._with_hint(error) from None
            raise

    def _with_hint(self, error: DeviceError) -> DeviceError:
        """The error of a device, with how a simulated camera runs without the device."""
        hint = self._config.rehearsal_hint
        return DeviceError(f"{error}; {hint}") if hint else error

    def darken(self, reason: str = "frames are not processed any more") -> None:
        """Switch the laser off before all waiting commands; never blocks."""
        # first, so that no command to light comes between
        self.permit.end()
        self._command_off()
        self.note_dark(reason)

    def light_off(self, who: str) -> str:
        """Switch the laser off at once, until acknowledged, by order of a person at the place `who`.

        No device is waited for; after the commands to the devices it may wait for the disk of the rig's
        state. A trip that is latched already stays as it is.
        """
        self._command_off()
        # the press may be noted beside the rig's state as well: it then counts once
        self.permit.look_for_presses()
        if self.permit.latched is None:
            self.permit.trip(TripCause.PERSON, f"LIGHT OFF was pressed at {who}")
        return "the laser is commanded off" if self._config.laser.kind != "none" else SWITCHED_BY_HAND

    def _find_earlier_trips(self) -> None:
        """Latch, before devices are opened, an earlier press and a light that was not confirmed off."""
        self.permit.look_for_presses()
        if not self.state.left_lit:
            return
        if self.permit.latched is None:
            self.permit.trip(TripCause.WATCHDOG, LEFT_LIT)
        with suppress(DeviceError):
            self.state.note_light(False)

    def obey_presses(self) -> None:
        """Switch off and latch a trip after a press of LIGHT OFF that is noted beside the rig's state."""
        if self.permit.look_for_presses():
            self._command_off()
        self.state.retry_write()

    def _command_off(self) -> None:
        """Command controller and laser off, before all waiting commands; never blocks."""
        if self.control is not None and self._config.laser.kind != "none":
            self.control.laser_off()
        if self.laser is not None:
            self.laser.off()

    def wait_for_reports(self) -> None:
        """Wait until the devices with light and interlock have answered, for at most 3 s."""
        deadline_s = time.monotonic() + _MAX_REPORT_S
        while time.monotonic() < deadline_s and self._silent_device():
            time.sleep(_POLL_INTERVAL_S)

    def acknowledge(self, number: int, who: str) -> str:
        """Clear the trip of this number, which a person at the place `who` acknowledges after a check.

        Returns what was done; lights nothing. Raises DeviceError for another number than the latched one, and
        while an interlock is open, because the person who closes it later may be in the beam path.
        """
        trip, interlock = self.permit.latched, self._open_interlock()
        if trip is None:
            raise DeviceError(f"trip {number} cannot be acknowledged: nothing is latched")
        if trip.number != number:
            raise DeviceError(f"trip {number} cannot be acknowledged: latched is {trip.text}")
        if interlock:
            raise DeviceError(f"{interlock.text} is still open: close it, then acknowledge trip {number}")
        if silent_device := self._silent_device():
            raise DeviceError(
                f"trip {number} cannot be acknowledged: {silent_device}, so its cause may still be present"
            )
        state = None if self.laser is None else self.laser.snapshot.state
        if state is not None and state.dark_reason:
            raise DeviceError(f"trip {number} cannot be acknowledged: {state.dark_reason}")
        if self.permit.spot.contradicts and self.permit.spot.age_s <= STALE_S:
            raise DeviceError(f"trip {number} cannot be acknowledged: {_SPOT_VISIBLE}")
        if self.control is not None:
            # the board has its own numbers, and refuses to clear a trip that it has not yet reported
            wait_for_command(self.control.acknowledge())
        self.state.acknowledge(number)
        self.audit(AuditEntry.ACKNOWLEDGE, trip.text, number=number, by=who)
        self._log.wait()
        return f"{trip.text}: acknowledged"

    def compare(self) -> None:
        """Latch a trip if the frames show light while the devices report that the laser is off."""
        laser, spot = self.laser_report(), self.permit.spot
        if laser is None or laser.light not in (Light.ON, Light.OFF, Light.INTERLOCK_OPEN):
            return
        spot.note_laser(laser.on)
        if not spot.contradicts:
            self._is_contradicted = False
        elif not self._is_contradicted:
            self._is_contradicted = True
            self.permit.trip(TripCause.OUTPUT, _SPOT_VISIBLE)

    def confirm_dark_by_frames(self, camera: Camera) -> None:
        """After `darken`, examine frames of a stopped camera until they show that the laser is off.

        After some seconds, and after an error of the camera, the frames confirm nothing.
        """
        spot = self.permit.spot
        deadline_s = time.monotonic() + _MAX_DARK_FRAMES_S + 2.0 * spot.exposure_s
        with suppress(RigError, OSError):
            camera.start()
            try:
                while time.monotonic() < deadline_s and not (spot.confirms or spot.contradicts):
                    if (frame := camera.read(_MAX_DARK_FRAMES_S)) is None:
                        return
                    spot.examine(frame.image)
                    self.compare()
            finally:
                camera.stop()

    def _note_trip(self, trip: LatchedTrip, now: bool) -> None:
        if now:
            self.audit(AuditEntry.TRIP, trip.why, cause=trip.cause, lit=trip.lit)
        self.audit(AuditEntry.LATCH, trip.why, number=trip.number, cause=trip.cause, lit=trip.lit)
        self.note_dark(trip.text)

    def note_dark(self, reason: str) -> None:
        """Note that the light is off; never blocks."""
        if self._is_lit:
            self._is_lit = False
            self.audit(AuditEntry.DARK, reason)

    def note_unexpected_dark(self, reason: str) -> None:
        """Note that a laser which should be lit is dark, and latch a trip, so that no later run lights it.

        A person who switched it off, at its panel or from another program, may be in the beam path. No trip
        is latched for a laser that does not answer, which may still be lit, and for one that a trip switched
        off, acknowledged or not.
        """
        if not self.confirmed_dark:
            if self._is_lit:
                self._is_lit = False
                self.audit(AuditEntry.UNKNOWN, reason)
            return
        if self.permit.expects_light and not self.permit.needs_request:
            self.permit.trip(TripCause.WATCHDOG, f"the laser went dark: {reason}")
        self.note_dark(reason)

    @property
    def confirmed_dark(self) -> bool:
        """Whether the device that switches the laser has recently reported that it is off. Never blocks."""
        laser = self.laser_report()
        return laser is not None and laser.light in (Light.OFF, Light.INTERLOCK_OPEN)

    @property
    def silence_consequence(self) -> str:
        """What happens to a laser whose device does not answer, in words."""
        if not through_controller(self._config.laser):
            return STAYS_LIT
        return (
            "the controller's own watchdog turns it off "
            f"{self._config.controller.watchdog_s:g} s after the last heartbeat"
        )

    def _open_interlock(self) -> Interlock | None:
        """The interlock that is open now; None if all are closed or unknown. Never blocks."""
        status = None if self.control is None else self.control.snapshot.status
        if status is not None and not status.interlock_closed:
            return Interlock.CONTROLLER
        state = None if self.laser is None else self.laser.snapshot.state
        own = self._config.laser.interlock == "own"
        return Interlock.LASER if own and state is not None and not state.interlock_closed else None

    def _silent_device(self) -> str:
        """The device that does not answer, in words, so that its interlock is unknown. Never blocks."""
        if self.control is not None and self.control.snapshot.status is None:
            return Light.CONTROLLER_SILENT
        if self.laser is not None and self.laser.snapshot.state is None:
            return f"the laser {Light.SILENT}"
        return ""

    def audit(self, kind: AuditEntry, reason: str, **details: object) -> None:
        """Add a change of the light, or an action of a person, to the audit log; never blocks."""
        self._log.append(kind, reason, **details)

    def _darken_at_end(self) -> tuple[str, KeyboardInterrupt | None]:
        """Switch the laser off; returns a text on what confirms it, or that nothing does, and a Ctrl-C."""
        switches: list[tuple[str, Callable[[], Future[None]], float]] = []
        if self.control is not None and through_controller(self._config.laser):
            switches.append(("controller", self.control.laser_off, _MAX_BOARD_CONFIRM_S))
        if self.laser is not None:
            switches.append(("laser", self.laser.off, _MAX_LASER_CONFIRM_S))
        commands = [(who, off, off(), max_wait_s) for who, off, max_wait_s in switches]
        self.darken("the devices are closed")
        start_s, interrupt = time.monotonic(), None
        for who, off, command, max_wait_s in commands:
            reason, interrupted = confirmed_dark(off, command, start_s + max_wait_s)
            interrupt = interrupt or interrupted
            if reason:
                doubt = f"the {who} does not confirm that it is off ({reason})"
                return f"THE LASER MAY BE LIT: {doubt}; go and check", interrupt
        self.compare()
        if (trip := self.permit.latched) is not None and trip.cause is TripCause.OUTPUT:
            return f"THE LASER MAY BE LIT: {trip.text}; go and look", interrupt
        with suppress(DeviceError):
            # if this fails, the next program finds the light noted as on, and latches a trip
            self.state.note_light(False)
        if not switches:
            return SWITCHED_BY_HAND, interrupt
        confirming = [who for who, _, _ in switches] + ["camera"] * self.permit.spot.confirms
        return f"laser off, confirmed by the {' and the '.join(confirming)}", interrupt

    def darkness(self) -> str:
        """The reason why the laser does not emit; empty if it emits, or if no laser is controlled."""
        laser = self.laser_report()
        if laser is None or laser.on:
            return ""
        if self.permit.refusal:
            return self.permit.refusal
        for service in (self.control, self.laser):
            if service is not None and service.failure is not None:
                return f"{service.name} has failed: {service.failure}"
        if self.control is not None:
            snapshot = self.control.snapshot
            if snapshot.status is None:
                return f"the controller is {snapshot.state}: {snapshot.last_error}".rstrip(": ")
            if interlock := self._open_interlock():
                return f"{interlock.text} is open"
            if snapshot.status.trip is not Trip.NONE:
                return f"the controller has tripped: {snapshot.status.trip}"
        return laser.text

    def reported_darkness(self) -> str:
        """The latched trip, or the reason of `darkness` by later reports, for which it waits up to 3 s.

        After a standstill of the computer, frames are dark before any device has reported that.
        """
        since_ns, deadline_s = time.monotonic_ns(), time.monotonic() + _MAX_REPORT_S
        while self._config.laser.kind != "none" and time.monotonic() < deadline_s:
            if (trip := self.permit.latched) is not None:
                return trip.text
            control = None if self.control is None else self.control.snapshot
            laser = None if self.laser is None else self.laser.snapshot
            times_ns = [control.status_time_ns] if control is not None and control.status is not None else []
            times_ns += [laser.state_time_ns] if laser is not None and laser.state is not None else []
            device_count = (control is not None) + (laser is not None)
            if len(times_ns) == device_count and all(time_ns > since_ns for time_ns in times_ns):
                break
            time.sleep(_POLL_INTERVAL_S)
        return self.darkness()

    def laser_report(self) -> LaserReport | None:
        """State of the laser; None if this program controls none. Never blocks."""
        if self._config.laser.kind == "none":
            return None
        return laser_report(self._config.laser, self.control, self.laser)

    def safety(self) -> SafetyNow:
        """The state of laser, controller and interlock, with the ages of their reports. Never blocks."""
        report, spot = self.laser_report(), self.permit.spot
        laser = report or LaserReport(Light.UNKNOWN)
        loops, connection, recent_status = [], None, None
        if self.control is not None:
            snapshot = self.control.snapshot
            connection, status, status_age_s = snapshot.state, snapshot.status, age_s(snapshot.status_time_ns)
            if status is not None:
                loops.append((status.interlock_closed, status_age_s))
            recent_status = status if connection is ControlState.OPEN and status_age_s <= STALE_S else None
        if self.laser is not None and self._config.laser.interlock == "own":
            state = self.laser.snapshot.state
            if state is not None:
                loops.append((state.interlock_closed, age_s(self.laser.snapshot.state_time_ns)))
        interlock = Loop.CLOSED
        interlock_age_s = max((loop_age_s for _, loop_age_s in loops), default=math.inf)
        open_age_s = min((loop_age_s for closed, loop_age_s in loops if not closed), default=math.inf)
        if open_age_s <= STALE_S:
            interlock, interlock_age_s = Loop.OPEN, open_age_s
        elif interlock_age_s > STALE_S:
            interlock = Loop.UNKNOWN
        return SafetyNow(
            trip=self.permit.latched,
            refusal=self.permit.refusal or self.state.problem,
            light=Light.DISAGREES if spot.contradicts else laser.light,
            # the age of a device's state is infinite while the device is silent
            light_age_s=math.inf if laser.light in _SILENT_STATES else laser.age_s,
            interlock=interlock,
            interlock_age_s=interlock_age_s,
            spot_visible=spot.visible if spot.age_s <= STALE_S else None,
            spot_age_s=spot.age_s,
            needs_request=self.permit.needs_request,
            laser=report,
            controller=connection,
            status=recent_status,
        )
