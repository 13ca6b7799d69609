"""What shakes the pendulum besides its swing, of the last minutes of a run, as acceleration of the ground."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.deflections import Deflections
from processing.errors import DataError
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.swing import Swing, residual_spectrum
from rig.settings import PendulumSettings

_SWINGS_KEPT = 60
_SAMPLES_KEPT = 1 << 18
_AGAIN_AFTER = 5
"""Half-cycles after which the spectrum is worth another look."""
_BINS_A_DECADE = 30
_NOTHING: dict[str, list[Any]] = {"f": [], "left": [], "acceleration": [], "low": [], "high": []}


class GroundNow:
    """Keeps what a spectrum needs; `take` is called by the thread of the record, `parts` under the same lock.

    `spectrum` takes some ten milliseconds, and is called without it, by one thread at a time.
    """

    def __init__(self, pendulum: PendulumSettings | None) -> None:
        self._pendulum = pendulum
        self._blocks: deque[Deflections] = deque()
        self._samples = 0
        self._swings: deque[Swing] = deque(maxlen=_SWINGS_KEPT)
        self._of_last = -1
        self._found = _NOTHING

    def take(self, deflections: Deflections, swings: Sequence[Swing]) -> None:
        """Deflections of recorded frames, and the half-cycles that end with them."""
        self._swings.extend(swing for swing in swings if not swing.flags)
        if len(deflections):
            self._blocks.append(deflections)
            self._samples += len(deflections)
        from_ns = self._swings[0].turn_time_ns if self._swings else -1
        while self._blocks and (int(self._blocks[0].times_ns[-1]) < from_ns or self._samples > _SAMPLES_KEPT):
            self._samples -= len(self._blocks.popleft())

    def parts(self) -> tuple[list[Deflections], list[Swing]]:
        """What `spectrum` needs."""
        return list(self._blocks), list(self._swings)

    def spectrum(self, blocks: Sequence[Deflections], swings: Sequence[Swing]) -> dict[str, list[Any]]:
        """Root densities along the swing, without it; empty lists before there are twenty periods.

        `left` is of the deflection, as shown. Where the height of the mass centre is stated, `acceleration`
        is that of a base which alone would leave this, `low` and `high` are Peterson's models, in
        nm/s^2/sqrt(Hz).
        """
        if not blocks or not swings or swings[-1].index - self._of_last < _AGAIN_AFTER:
            return self._found
        self._of_last = swings[-1].index
        times_ns = np.concatenate([one.times_ns for one in blocks])
        try:
            found = residual_spectrum(times_ns, np.concatenate([one.y for one in blocks]), swings)
        except DataError:
            return self._found
        place = np.round(np.log10(found.frequency_hz) * _BINS_A_DECADE)
        begins = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
        count = np.diff(begins, append=len(place))
        frequency_hz = np.add.reduceat(found.frequency_hz, begins) / count
        density = np.sqrt(np.add.reduceat(found.density, begins) / count)
        shown = density / blocks[0].unit.shown_size
        told = {**_NOTHING, "f": _short(frequency_hz), "left": _short(shown)}
        pendulum = self._pendulum
        if pendulum is not None and pendulum.mass_centre_height_m:
            height_m = abs(pendulum.mass_centre_height_m)
            per_acceleration = height_m / (pendulum.gravity_m_per_s2 * pendulum.ball_radius_m)
            answer = per_acceleration * found.pendulum_hz**2 / (frequency_hz**2 - found.pendulum_hz**2)
            told["acceleration"] = _short(1e9 * density / answer)
            for name, model in (("low", nlnm_db), ("high", nhnm_db)):
                told[name] = _short(1e9 * density_of_db(model(frequency_hz)))
        self._found = told
        return told


def _short(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{one:.4g}") for one in values if math.isfinite(one)]
