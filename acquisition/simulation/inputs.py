"""Inputs of the simulated rig: faults at stated times ([faults]), and a controller's outputs."""

import threading
from typing import Final, NamedTuple

from pydantic import BaseModel, Field

MAX_REACTION_S: Final = 0.02
"""Simulated time within which a change of a controller's output takes effect."""


class FaultSettings(BaseModel, frozen=True, extra="forbid"):
    """Faults of the simulated rig; times are in seconds since the start of each run, None: never."""

    laser_fades_at_s: float | None = Field(default=None, ge=0)
    laser_fade_duration_s: float = Field(default=5.0, gt=0, description="at the lowest power for half of it")
    laser_fade_to: float = Field(default=0.0, ge=0, le=1, description="lowest power, relative")
    camera_unplugged_at_s: float | None = Field(default=None, ge=0)
    camera_replugged_at_s: float | None = Field(default=None, ge=0)
    frames_stalled_at_s: float | None = Field(default=None, ge=0, description="no frames from then on")
    frames_stalled_duration_s: float = Field(default=2.0, gt=0)
    clock_zero_at_s: float | None = Field(
        default=None, ge=0, description="one frame has the timestamp 0; only in real time"
    )
    clock_steps_at_s: float | None = Field(
        default=None, ge=0, description="the camera's clock steps; only in real time"
    )
    clock_step_s: float = Field(default=0.13, description="step of the camera's clock, positive forward")
    clock_bits: int | None = Field(
        default=None, ge=32, le=62, description="bits of the camera's counter of ns, which overflows to 0"
    )
    vibration_burst_at_s: float | None = Field(default=None, ge=0)
    vibration_burst_duration_s: float = Field(default=3.0, gt=0)
    vibration_burst_arcsec: float = Field(default=2.0, gt=0, description="largest amplitude, both axes")
    vibration_burst_hz: float = Field(default=17.0, gt=0)
    draught_at_s: float | None = Field(default=None, ge=0, description="a draught pushes both modes")
    draught_arcsec: float = Field(default=3.0, description="amplitude that the impulse gives at rest")
    interlock_opens_at_s: float | None = Field(
        default=None, ge=0, description="since the simulated controller first lit the laser"
    )
    interlock_open_for_s: float = Field(default=3.0, gt=0)


class ControllerOutputs(NamedTuple):
    """State of a controller's outputs."""

    laser_w: float = 0.0
    pulse_delay_us: float = 0.0
    pulse_us: float = 0.0
    """Length of the pulses of light; 0: the laser is not pulsed."""
    magnet: bool = False
    starter: bool = False
    clamp: bool = False
    brake: bool = False


class RigInputs:
    """Passes a controller's outputs to the simulated rig; methods return immediately, in any thread.

    Changes take effect with the next frames that are calculated, within `MAX_REACTION_S`. They are useful in
    real time only: on demand, simulated time passes faster than a controller can react.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._outputs = ControllerOutputs()
        self._changes: list[ControllerOutputs] = []

    def laser(self, power_w: float) -> None:
        """Optical power of the laser; 0 is off."""
        self._change(laser_w=power_w)

    def pulse(self, delay_us: float, width_us: float) -> None:
        """Pulse of light at a delay after the beginning of each exposure; width 0: light all the time."""
        self._change(pulse_delay_us=delay_us, pulse_us=width_us)

    def magnet(self, on: bool) -> None:
        """Switch the magnet, which holds the pendulum at the amplitude of the release; off releases it."""
        self._change(magnet=on)

    def starter(self, on: bool) -> None:
        """Switch the starter, which pushes with a constant moment, and so shifts the rest position."""
        self._change(starter=on)

    def clamp(self, on: bool) -> None:
        """Switch the clamp, which holds the pendulum at its rest position."""
        self._change(clamp=on)

    def brake(self, on: bool) -> None:
        """Switch the brake, which damps both modes."""
        self._change(brake=on)

    def start_run(self) -> ControllerOutputs:
        """The present outputs, for the start of a run; `take_changes` does not return earlier changes."""
        with self._lock:
            self._changes.clear()
            return self._outputs

    def take_changes(self) -> list[ControllerOutputs]:
        """The outputs after each change since the last call, in order."""
        with self._lock:
            changes, self._changes = self._changes, []
            return changes

    def _change(self, **values: float | bool) -> None:
        with self._lock:
            self._outputs = self._outputs._replace(**values)  # type: ignore[arg-type]
            self._changes.append(self._outputs)
