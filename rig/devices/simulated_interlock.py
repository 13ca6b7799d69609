"""The interlock of the simulated controller, which [faults] may open for a while."""

import time
from collections.abc import Callable

from acquisition.simulation.faults import FaultSettings


class SimulatedInterlock:
    """Closed, but for the stated time since the laser was first lit; `laser` passes its power in W on."""

    def __init__(
        self,
        faults: FaultSettings,
        laser: Callable[[float], None],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._faults, self._laser, self._clock_s = faults, laser, clock_s
        self._lit_s: float | None = None

    def laser(self, power_w: float) -> None:
        """The output of the laser."""
        if power_w > 0 and self._lit_s is None:
            self._lit_s = self._clock_s()
        self._laser(power_w)

    def closed(self) -> bool:
        """State of the loop."""
        at_s = self._faults.interlock_opens_at_s
        if at_s is None or self._lit_s is None:
            return True
        return not 0 <= self._clock_s() - self._lit_s - at_s < self._faults.interlock_open_for_s
