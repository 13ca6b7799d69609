"""A run since its beginning in some thousand numbers: extremes of its way, swings, estimates, spectra."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.topics import RecordedFittedPoint
from processing.deflections import Deflections, joined
from processing.errors import DataError
from processing.estimate import Estimate
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.swing import Swing, residual_spectrum
from processing.units import ARCSEC_RAD, NS_PER_S, seconds
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


Array = NDArray[np.float64]
_MOST = 800
_TAKEN_TOGETHER = 128
_FIRST_WIDTH_S = 0.02
_SWINGS = 20_000
_SWING_POINTS = 800
_ESTIMATES = 400
_FEWEST_FOR_SPECTRUM = 64
_SPECTRUM_BINS = 160
_DIGITS = 5


class Extremes:
    """Smallest and largest of some values in intervals of time; their width doubles when they are too many.

    Nothing that stands out is lost, however long it takes.
    """

    def __init__(self, curves: int, most: int = _MOST) -> None:
        self._most = most
        self._width_s = _FIRST_WIDTH_S
        self._at = np.zeros(0, np.int64)
        self._low = np.zeros((curves, 0))
        self._high = np.zeros((curves, 0))

    def take(self, time_s: Array, values: Array) -> None:
        """More samples (curves, n) at times that grow; NaN is none."""
        if not len(time_s):
            return
        self._join(np.floor(time_s / self._width_s).astype(np.int64), values, values)
        while len(self._at) > self._most:
            self._width_s *= 2
            at, low, high = self._at // 2, self._low, self._high
            self._at, self._low, self._high = at[:0], low[:, :0], high[:, :0]
            self._join(at, low, high)

    def _join(self, at: NDArray[np.int64], low: Array, high: Array) -> None:
        held = len(self._at) - 1 if len(self._at) and self._at[-1] >= at[0] else len(self._at)
        at = np.concatenate((self._at[held:], at))
        low = np.concatenate((self._low[:, held:], low), axis=1)
        high = np.concatenate((self._high[:, held:], high), axis=1)
        begins = np.flatnonzero(np.diff(at, prepend=at[0] - 1))
        self._at = np.concatenate((self._at[:held], at[begins]))
        # fmin and fmax pass over NaN
        self._low = np.concatenate((self._low[:, :held], np.fmin.reduceat(low, begins, axis=1)), axis=1)
        self._high = np.concatenate((self._high[:, :held], np.fmax.reduceat(high, begins, axis=1)), axis=1)

    def curve(self, number: int) -> list[tuple[float, float | None]]:
        """The curve through the extremes, each pair at the middle of its interval."""
        middle = (self._at + 0.5) * self._width_s
        points = np.stack((self._low[number], self._high[number]), axis=1)
        # where the interval holds one sample both are the same
        twice = points[:, 0] != points[:, 1]
        found: list[tuple[float, float | None]] = []
        for time_s, (low, high), both in zip(middle.tolist(), points.tolist(), twice.tolist(), strict=True):
            found.append((round(time_s, 3), _rounded(low)))
            if both and math.isfinite(low):
                found.append((round(time_s, 3), _rounded(high)))
        return found


class RunHistory:
    """What is kept of one run; written by the thread of its record. The caller keeps threads apart."""

    def __init__(self) -> None:
        self._motion = Extremes(2)
        self._swings: deque[tuple[float, float, float, float]] = deque(maxlen=_SWINGS)
        self._start_ns = 0
        self._waiting: list[Deflections] = []
        self._waiting_samples = 0
        self._fitted: list[RecordedFittedPoint] = []
        self._estimates: dict[str, deque[tuple[float, float, float]]] = {}

    def motion(self, start_ns: int, deflections: Deflections) -> None:
        """Deflections of recorded frames."""
        self._start_ns = start_ns
        if len(deflections):
            self._waiting.append(deflections)
            self._waiting_samples += len(deflections)
            # blocks of two frames would take a tenth of what a frame may
            if self._waiting_samples >= _TAKEN_TOGETHER:
                self._take_motion()

    def _take_motion(self) -> None:
        if not self._waiting:
            return
        whole = joined(self._waiting, self._waiting[0].unit)
        self._waiting, self._waiting_samples = [], 0
        time_s = (whole.times_ns - self._start_ns) / NS_PER_S
        self._motion.take(time_s, np.stack((whole.shown_x, whole.shown_y)))

    def swing(self, start_ns: int, swing: Swing, shown_size: float) -> None:
        """A half-cycle without doubts."""
        self._start_ns = start_ns
        at_s = seconds(swing.turn_time_ns - start_ns)
        amplitude, u = swing.amplitude / shown_size, swing.u_amplitude / shown_size
        self._swings.append((at_s, amplitude, u, 2.0 * swing.half_period_s))

    def estimate(self, elapsed_s: float, key: str, one: Estimate) -> None:
        """What a new fit has told of a parameter."""
        if math.isfinite(one.value) and math.isfinite(one.standard_uncertainty):
            kept = self._estimates.setdefault(key, deque(maxlen=_ESTIMATES))
            kept.append((elapsed_s, one.value, one.standard_uncertainty))

    def fitted(self, points: Sequence[RecordedFittedPoint]) -> None:
        """Half-cycles beside their fit; those of an earlier fit are forgotten."""
        last_ns = points[-1].time_ns if points else None
        self._fitted = [one for one in (*self._fitted, *points) if last_ns in (None, one.time_ns)]

    def told(self) -> dict[str, Any]:
        """Everything as plain values, deflections and amplitudes as they are shown."""
        self._take_motion()
        swings = list(self._swings)[:: max(1, math.ceil(len(self._swings) / _SWING_POINTS))]
        return {
            "x": self._motion.curve(0),
            "y": self._motion.curve(1),
            "swings": [(round(t, 3), *map(_rounded, rest)) for t, *rest in swings],
            "estimates": {key: list(kept) for key, kept in self._estimates.items()},
            "fit": _drawn(self._fitted, self._start_ns),
        }


def _drawn(points: Sequence[RecordedFittedPoint], start_ns: int) -> dict[str, list[tuple[float, float]]]:
    """The fit's curves and what it leaves over as they are shown; empty before the first fit."""
    if not points:
        return {}
    at_s = [round(seconds(one.turn_time_ns - start_ns), 3) for one in points]
    curves = {
        "amplitude": [round(one.amplitude_rad / ARCSEC_RAD, _DIGITS) for one in points],
        "amplitude_residual": [round(one.amplitude_residual, 2) for one in points],
        "period": [one.period_s for one in points],
        "period_residual": [round(one.period_residual, 2) for one in points],
    }
    return {
        name: [one for one in zip(at_s, values, strict=True) if math.isfinite(one[1])]
        for name, values in curves.items()
    }


def spectrum(path: Sequence[Deflections]) -> dict[str, list[Any]]:
    """Root of the spectral density of the last seconds along both axes; empty before there are enough."""
    if not path:
        return {"f": [], "x": [], "y": []}
    time_s = np.concatenate([one.times_ns for one in path]) / NS_PER_S
    x, y = np.concatenate([one.shown_x for one in path]), np.concatenate([one.shown_y for one in path])
    good = np.isfinite(x) & np.isfinite(y)
    time_s, x, y = time_s[good], x[good], y[good]
    if len(time_s) < _FEWEST_FOR_SPECTRUM:
        return {"f": [], "x": [], "y": []}
    # here, because it takes half a second
    from scipy.signal import welch

    # a camera's interval hardly varies; what is missing is drawn straight over
    even_s = np.linspace(time_s[0], time_s[-1], len(time_s))
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    found = [
        welch(np.interp(even_s, time_s, one - np.mean(one)), rate_hz, nperseg=max(32, len(even_s) // 2))
        for one in (x, y)
    ]
    frequency_hz = found[0][0][1:]
    edges = np.unique(np.geomspace(1, len(frequency_hz) + 1, _SPECTRUM_BINS).astype(int) - 1)[:-1]
    count = np.diff(edges, append=len(frequency_hz))
    shown = [np.sqrt(np.add.reduceat(density[1:], edges) / count) for _, density in found]
    middle_hz = np.add.reduceat(frequency_hz, edges) / count
    return {
        "f": [float(f"{one:.4g}") for one in middle_hz],
        **{name: [float(f"{one:.4g}") for one in curve] for name, curve in zip("xy", shown, strict=True)},
    }


def _rounded(value: float) -> float | None:
    return round(value, _DIGITS) if math.isfinite(value) else None
