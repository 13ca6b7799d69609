"""An instrument beside the simulated rig that feels the ground which drives it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.ground import ground_of
from acquisition.simulation.settings import SimulationSettings
from processing.errors import ConfigurationError

_KEY = 17
"""Of its random numbers, beside those of the ground."""


class SeismometerSamples(NamedTuple):
    """Times (n,) in s of the simulation, and counts (n, 2) along the slow and the fast swing."""

    time_s: NDArray[np.float64]
    counts: NDArray[np.float64]


class SimulatedSeismometer:
    """Samples at an even rate, of the ground a delay before, as counts, with white noise of its own.

    Raises ConfigurationError where no ground is simulated.
    """

    def __init__(self, settings: SimulationSettings) -> None:
        if settings.ground.model == "none":
            raise ConfigurationError(
                "a simulated witness feels the simulated ground: set simulation.ground.model"
            )
        self._settings = settings
        self._run = -1
        self._ground: Callable[[NDArray[np.float64]], list[NDArray[np.float64]]] | None = None
        self._noise = np.random.default_rng()
        self._next = 0

    def until(self, time_s: float, run: int) -> SeismometerSamples:
        """The samples since the last call, up to a time of a run; another run begins anew."""
        truth = self._settings.witness
        if run != self._run:
            self._begin(run)
        last = int(np.floor(time_s * truth.rate_hz))
        times = np.arange(self._next, last + 1) / truth.rate_hz
        self._next = max(self._next, last + 1)
        assert self._ground is not None
        felt = np.maximum(times - truth.delay_s, 0.0)
        size = truth.noise_m_per_s2_per_sqrt_hz * np.sqrt(0.5 * truth.rate_hz)
        values = np.column_stack(self._ground(felt)) + size * self._noise.standard_normal((len(times), 2))
        return SeismometerSamples(times, truth.counts_per_m_per_s2 * values)

    def _begin(self, run: int) -> None:
        found = ground_of(self._settings, run)
        assert found is not None
        series = found.acceleration_m_per_s2
        self._run, self._next = run, 0
        self._ground = lambda times: [one.at(times) for one in series]
        self._noise = np.random.default_rng([self._settings.seed, run, _KEY])
