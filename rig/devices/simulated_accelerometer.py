"""The accelerometer on the board of a simulated controller, which feels the ground of the simulated rig."""

import time
from typing import Protocol

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.witness import SimulatedWitness

_G = 9.80665
"""m/s2 of which the part's data sheet counts."""


class SimulatedRun(Protocol):
    """The simulated rig's runs, as its camera tells them."""

    @property
    def elapsed_s(self) -> float:
        """Since the run began; 0 before the first."""
        ...

    @property
    def run(self) -> int:
        """Its number."""
        ...


class SimulatedAccelerometer:
    """Samples as time passes: of the ground while a run is simulated, of stillness before the first.

    Its noise and delay are those of `simulation.witness`; rate and scale are the part's. Called in the
    board's thread.
    """

    def __init__(self, settings: SimulationSettings, rate_hz: float, per_g: int) -> None:
        truth = settings.witness.model_copy(update={"rate_hz": rate_hz, "counts_per_m_per_s2": per_g / _G})
        self._witness = SimulatedWitness(settings.model_copy(update={"witness": truth}))
        self._rate_hz, self._per_g = rate_hz, per_g
        self._rig: SimulatedRun | None = None
        self._still_from_s = time.monotonic()

    def beside(self, rig: SimulatedRun) -> None:
        """Which one it stands beside."""
        self._rig = rig

    def samples(self) -> list[tuple[int, int, int]]:
        """Those since the last call: along the slow swing, along the fast one, up."""
        rig = self._rig
        if rig is None or not rig.elapsed_s > 0:
            due = int((time.monotonic() - self._still_from_s) * self._rate_hz)
            self._still_from_s += due / self._rate_hz
            return [(0, 0, self._per_g)] * due
        counts = self._witness.until(rig.elapsed_s, rig.run).counts
        return [(round(along), round(across), self._per_g) for along, across in counts.tolist()]
