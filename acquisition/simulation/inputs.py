"""Effect of a controller's outputs on the simulated rig: laser, magnet, starter, clamp, brake."""

import threading
from typing import NamedTuple


class RigState(NamedTuple):
    """State of a controller's outputs; `pulse_us` 0: the laser is not pulsed."""

    laser_w: float = 0.0
    pulse_delay_us: float = 0.0
    pulse_us: float = 0.0
    magnet: bool = False
    starter: bool = False
    clamp: bool = False
    brake: bool = False


class RigInputs:
    """Passes a controller's outputs to the simulated rig; methods return immediately, in any thread.

    Changes take effect with the next frames that are calculated, within 20 ms of simulated time. They are
    useful in real time only: on demand, simulated time passes faster than a controller can react.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = RigState()
        self._changes: list[RigState] = []

    def laser(self, power_w: float) -> None:
        """Optical power of the laser; 0 is off."""
        self._change(laser_w=power_w)

    def pulse(self, delay_us: float, width_us: float) -> None:
        """Light only for a time after the beginning of each exposure; width 0: all the time."""
        self._change(pulse_delay_us=delay_us, pulse_us=width_us)

    def magnet(self, on: bool) -> None:
        """On: holds the pendulum at the amplitude of the release; off: releases it."""
        self._change(magnet=on)

    def starter(self, on: bool) -> None:
        """On: pushes the pendulum with a constant moment, which shifts its rest position."""
        self._change(starter=on)

    def clamp(self, on: bool) -> None:
        """On: holds the pendulum at its rest position."""
        self._change(clamp=on)

    def brake(self, on: bool) -> None:
        """On: damps both modes."""
        self._change(brake=on)

    def begin(self) -> RigState:
        """State at the beginning of a run, including changes that were not yet taken."""
        with self._lock:
            self._changes.clear()
            return self._state

    def take(self) -> list[RigState]:
        """All states since the last call, in order."""
        with self._lock:
            changes, self._changes = self._changes, []
            return changes

    def _change(self, **changed: float | bool) -> None:
        with self._lock:
            self._state = self._state._replace(**changed)  # type: ignore[arg-type]
            self._changes.append(self._state)
