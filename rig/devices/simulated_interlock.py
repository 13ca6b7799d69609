"""The interlock of the simulated controller, which [faults] may open for a while."""

import time
from collections.abc import Callable


class SimulatedInterlock:
    """Closed, but for `open_for_s` from `opens_at_s` on (None: never), since the laser was first lit.

    `laser` passes the laser's power in W on.
    """

    def __init__(
        self,
        opens_at_s: float | None,
        open_for_s: float,
        laser: Callable[[float], None],
    ) -> None:
        self._opens_at_s, self._open_for_s = opens_at_s, open_for_s
        self._laser = laser
        self._lit_s: float | None = None

    def laser(self, power_w: float) -> None:
        """The output of the laser."""
        if power_w > 0 and self._lit_s is None:
            self._lit_s = time.monotonic()
        self._laser(power_w)

    def closed(self) -> bool:
        """State of the loop."""
        if self._opens_at_s is None or self._lit_s is None:
            return True
        return not 0 <= time.monotonic() - self._lit_s - self._opens_at_s < self._open_for_s
