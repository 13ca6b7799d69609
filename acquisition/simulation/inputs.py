"""What a controller does to the simulated rig: laser, magnet, starter, clamp, brake."""

import threading
from typing import NamedTuple


class RigState(NamedTuple):
    """How the outputs of a controller stand."""

    laser_w: float = 0.0
    magnet: bool = False
    starter: bool = False
    clamp: bool = False
    brake: bool = False


class RigInputs:
    """Hands a controller's outputs to the simulated rig; every method returns at once, from any thread.

    Changes are felt with the next frames that are planned, within 20 ms of simulated time. They
    make sense in real time; on demand, simulated time runs faster than any controller.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = RigState()
        self._changes: list[RigState] = []

    def laser(self, power_w: float) -> None:
        """Optical power of the laser; 0: dark."""
        self._change(laser_w=power_w)

    def magnet(self, on: bool) -> None:
        """On: holds the pendulum at the amplitude of the release; off: lets it go."""
        self._change(magnet=on)

    def starter(self, on: bool) -> None:
        """On: pushes the pendulum, as if its rest position lay aside."""
        self._change(starter=on)

    def clamp(self, on: bool) -> None:
        """On: holds the pendulum at its rest position."""
        self._change(clamp=on)

    def brake(self, on: bool) -> None:
        """On: damps both modes."""
        self._change(brake=on)

    def begin(self) -> RigState:
        """State for a new run; changes not yet taken are in it."""
        with self._lock:
            self._changes.clear()
            return self._state

    def take(self) -> list[RigState]:
        """States gone through since the last call, in order."""
        with self._lock:
            changes, self._changes = self._changes, []
            return changes

    def _change(self, **changed: float | bool) -> None:
        with self._lock:
            self._state = self._state._replace(**changed)  # type: ignore[arg-type]
            self._changes.append(self._state)
