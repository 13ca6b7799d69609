"""Opens the devices of a session in a safe order, and closes them in reverse order."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple, Self

from acquisition.camera import Camera, CameraInfo, CameraSettings
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.frames.guard import check_applied_settings, check_info, driver_errors, end_within
from acquisition.record.events import EventKind
from acquisition.simulation.inputs import FaultSettings, RigInputs
from processing.errors import ConfigurationError, DeviceError
from rig.control import (
    AmbientSensor,
    Controller,
    ControlService,
    LaserService,
    make_laser,
    simulated_controller,
)
from rig.devices.clocks import wait_for_network_clock
from rig.devices.frame_stream import FrameStream
from rig.devices.ground_seismometer import GroundSeismometer, make_seismometer
from rig.devices.lit_devices import LitDevices
from rig.instrument import (
    camera_settings,
    check_full_scale,
    make_camera,
    pulse_faults,
    setting_differences,
    shift_to_light_ns,
)
from rig.settings import Configuration
from rig.terminal import say

_PRESS_CHECK_INTERVAL_S, _MAX_JOIN_S = 0.1, 1.0
"""Interval of checks for presses of LIGHT OFF, and longest wait for the end of the last check."""


class OpenCamera(NamedTuple):
    """A configured camera."""

    camera: Camera
    info: CameraInfo
    notes: tuple[str, ...]
    """Settings that differ from the requested ones, in words."""
    applied: CameraSettings = CameraSettings()
    """All settings as read back."""
    time_shift_ns: int = 0
    """Time that is added to the camera's timestamps."""


@contextmanager
def _press_watch(devices: LitDevices) -> Iterator[None]:
    """Context in which presses of LIGHT OFF are looked for, by programs that cannot send an order here."""
    # a thread of its own, so that a hanging disk delays no command to a device
    stop = threading.Event()

    def check() -> None:
        while not stop.wait(_PRESS_CHECK_INTERVAL_S):
            devices.obey_presses()

    thread = threading.Thread(target=check, name="presses", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        # the thread must not write once the next program has the state; a hanging disk must not block the end
        thread.join(_MAX_JOIN_S)
        devices.permit.stop_press_checks()


class Devices(LitDevices):
    """Controller, sensor and laser of one session, and the camera of each run; a context manager.

    The configured devices are opened in the order controller, sensor, laser, camera, and closed in reverse
    order, also after an error; closing turns the laser off. Laser and controller stay on between the runs of
    a series. `task` is the purpose for which they are opened. Changes of the light and actions of people are
    added to the audit log in `folder`, if given. Raises DeviceError where another program has the rig.
    """

    def __init__(self, config: Configuration, folder: Path | None = None, task: str = "this program") -> None:
        super().__init__(config, folder, task)
        self._folder = folder
        self._closing = ExitStack()
        self._inputs: RigInputs | None = None
        self.sensor: AmbientSensor | None = None
        self.seismometer: GroundSeismometer | None = None
        if config.controller.kind == "simulated":
            if not config.simulated or config.on_demand:
                raise ConfigurationError(
                    "controller.kind = 'simulated' moves the simulated rig in real time: "
                    "set camera.driver = 'simulated' and simulation.real_time = true"
                )
            self._inputs = RigInputs()

    def __enter__(self) -> Self:
        try:
            self._open()
        except BaseException:
            self._closing.close()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        interrupt: KeyboardInterrupt | None = None
        try:
            if self._was_lit:
                confirmation, interrupt = self._darken_at_end()
                # the terminal may have been closed, which must not block the end
                with suppress(OSError):
                    say(confirmation)
                    if self.permit.latched is not None:
                        say(f"{self.permit.latched.text}: {self.remedy}")
        finally:
            self._closing.close()
            self._log.wait()
        if interrupt is not None:
            raise interrupt

    def _open(self) -> None:
        config = self._config
        self._closing.enter_context(self.state)
        if self._folder is not None:
            self.state.note_folder(self._folder)
        self._find_earlier_trips()
        if self.state.path is not None:
            self._closing.enter_context(_press_watch(self))
        if config.controller.kind != "none":
            sensor = config.environment_sensor
            period_s = sensor.period_s if sensor.kind == "controller" else None
            self.control = self._closing.enter_context(
                ControlService(self.make_controller(), config.controller, period_s, self.permit)
            )
            try:
                self.control.wait_open()
            except DeviceError as error:
                raise self._with_hint(error) from None
        if config.environment_sensor.kind == "serial":
            self.sensor = self._closing.enter_context(AmbientSensor(config.environment_sensor))
        if (seismometer := make_seismometer(config)) is not None:
            self.seismometer = self._closing.enter_context(seismometer)
        if (laser := make_laser(config.laser)) is not None:
            is_own = config.laser.interlock == "own"
            service = LaserService(laser, permit=self.permit, has_own_interlock=is_own)
            self.laser = self._closing.enter_context(service)

    @contextmanager
    def camera(self, config: Configuration) -> Iterator[OpenCamera]:
        """Context manager: the camera of one run, opened and configured."""
        camera: Camera
        if self._inputs is not None:
            camera = SimulatedCamera(config.simulation, config.faults, self._inputs)
        else:
            camera = make_camera(config)
        name = f"camera.driver = {config.camera.driver!r}"
        try:
            with driver_errors(name, "open()"):
                info = check_info(camera.open(), config.camera.driver)
            if self.seismometer is not None:
                self.seismometer.relate_to(camera)
            requested = camera_settings(config)
            with driver_errors(name, "configure()"):
                applied = check_applied_settings(camera.configure(requested), config.camera.driver)
            check_full_scale(config, info, applied)
            if requested.ptp:
                wait_for_network_clock(camera)
            self.permit.spot.exposure_s = 1e-6 * (applied.exposure_us or 0.0)
            notes = (*setting_differences(requested, applied), *pulse_faults(config, info, applied))
            yield OpenCamera(camera, info, notes, applied, shift_to_light_ns(config, info, applied))
        finally:
            if self._was_lit and not self.permit.expects_light and not config.on_demand:
                self.confirm_dark_by_frames(camera)
            if remark := end_within(camera.close, f"{name}: close()"):
                # the terminal may have been closed, which must not block the end
                with suppress(OSError):
                    say(remark)

    def stream(self, config: Configuration, camera: OpenCamera) -> FrameStream:
        """Stream of the camera's frames as configured, which the light's permit watches."""
        return FrameStream(
            camera.camera,
            camera_settings(config),
            # sources on demand wait and lose no frame, which a real camera cannot
            policy="wait" if config.on_demand else "drop",
            timeout_s=config.camera.patience_s,
            permit=self.permit,
            time_shift_ns=camera.time_shift_ns,
            applied=camera.applied,
        )

    def make_controller(self) -> Controller:
        """Make the configured controller without opening it; a simulated one acts on the simulated rig."""
        config = self._config
        limit_w = config.laser.max_power_w
        if config.controller.kind == "serial":
            return Controller(config.controller, limit_w)
        inputs = self._inputs or RigInputs()
        if config.laser.kind != "controller":
            # a laser that this program does not control is always on
            inputs.laser(config.simulation.optics.laser_w)
        set_power = inputs.laser if config.laser.kind == "controller" else lambda _: None
        laser, is_closed = _simulated_interlock(config.faults, set_power)
        return simulated_controller(config.controller, limit_w, inputs, laser, is_closed)

    def required_control(self, task: str) -> ControlService:
        """The controller; raises ConfigurationError, which names the task, without one."""
        if self.control is None:
            raise ConfigurationError(f"{task} needs a controller: set controller.kind to serial or simulated")
        return self.control

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of the devices since the last call, as (kind, text); never blocks."""
        sensors = (EventKind.SENSOR, self.sensor), (EventKind.SENSOR, self.seismometer)
        devices = (EventKind.CONTROLLER, self.control), (EventKind.LASER, self.laser), *sensors
        return [(kind, text) for kind, device in devices if device for text in device.take_events()]

    def environment(self) -> tuple[float, float, float]:
        """Temperature in °C, humidity in % and pressure in Pa, as last measured by sensor or controller.

        NaN for quantities that are not measured. Values stated by the user are not readings and have no time;
        they are stored in the record's metadata only.
        """
        if self.sensor is not None:
            air = self.sensor.latest
        elif self.control is not None and self._config.environment_sensor.kind == "controller":
            air = self.control.snapshot.environment
        else:
            return math.nan, math.nan, math.nan
        return air.temperature_c, air.humidity_percent, air.pressure_pa


def _simulated_interlock(
    faults: FaultSettings, set_power: Callable[[float], None]
) -> tuple[Callable[[float], None], Callable[[], bool]]:
    """What sets the laser's power in W, and whether the interlock is closed, which opens after it was lit."""
    lit_s, opens_at_s, open_for_s = math.inf, faults.interlock_opens_at_s, faults.interlock_open_for_s

    def laser(power_w: float) -> None:
        nonlocal lit_s
        if power_w > 0:
            lit_s = min(lit_s, time.monotonic())
        set_power(power_w)

    def is_closed() -> bool:
        opens_s = math.inf if opens_at_s is None else lit_s + opens_at_s
        return not 0 <= time.monotonic() - opens_s < open_for_s

    return laser, is_closed
