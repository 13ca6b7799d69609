"""Slow changes: the uncertainty of a slope whose noise wanders, and steps and kicks as they happen."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.errors import DataError
from processing.noise_models import robust_scatter
from processing.units import seconds

Array = NDArray[np.float64]

PARTS: Final = 64
"""Into which a record is divided; what is faster than these counts as white."""
FEWEST_PARTS: Final = 8
"""Parts beyond the number of coefficients."""
_SIZES: Final = np.logspace(-1.5, 4.0, 12)
"""Variances of what wanders over that of the white noise, after a line was taken off."""
_OCTAVES: Final = 7
_MEMORIES: Final = (1 / 32, 1 / 8)
"""Times in which a slope forgets what it was, in the record's length; more it shows of none."""
_WHITE: Final = 0.6
_SOON_FORGETS: Final = 0.2
"""Probabilities, before anything is seen, that noise is white, and that it forgets within a part."""


def part_means(values: Array) -> Array:
    """Means of consecutive equal parts of values (n,) or (n, k), along the first axis."""
    count = min(PARTS, len(values))
    edges = np.linspace(0, len(values), count + 1).round().astype(int)
    sums = np.add.reduceat(values, edges[:-1], axis=0)
    lengths = np.diff(edges)
    return np.asarray(sums / (lengths if values.ndim == 1 else lengths[:, None]))


def u_of_wandering(design: Array, residual: Array) -> float:
    """Standard uncertainty of the first coefficient of a linear fit to evenly spaced means.

    Parameters
    ----------
    design : (m, k)
        Means of the fit's columns over the parts; more parts than columns by 8 at least.
    residual : (m,)
        What the fit, of equal weights, left of them.

    Raises
    ------
    DataError
        Too few parts.
    """
    count, columns = design.shape
    dof = count - columns
    if dof < FEWEST_PARTS:
        raise DataError(
            f"slope: {count} means for {columns} coefficients; {columns + FEWEST_PARTS} are needed"
        )
    whole, _ = np.linalg.qr(design, mode="complete")
    outside = whole[:, columns:]
    left = outside.T @ residual
    to_slope = np.linalg.pinv(design)[0]
    logs, variances = [], []
    for probability, covariance in _models(count, outside):
        inner = np.linalg.cholesky(outside.T @ covariance @ outside)
        white = np.linalg.solve(inner, left)
        scale = float(white @ white) / dof
        if scale <= 0.0:
            return 0.0
        likelihood = -float(np.log(np.diag(inner)).sum()) - 0.5 * dof * np.log(scale)
        logs.append(np.log(probability) + likelihood)
        variances.append(scale * float(to_slope @ covariance @ to_slope) * dof / (dof - 2))
    weights = np.exp(np.array(logs) - max(logs))
    return float(np.sqrt(weights @ np.array(variances) / weights.sum()))


def _models(count: int, outside: Array) -> Iterator[tuple[float, Array]]:
    """Probabilities, before anything is seen, and covariances of the means (m, m)."""
    white = np.eye(count)
    yield _WHITE, white
    soon, lasting = _kinds(count)
    for kinds, probability in ((soon, _SOON_FORGETS), (lasting, 1.0 - _WHITE - _SOON_FORGETS)):
        for kind in kinds:
            size = float(np.trace(outside.T @ kind @ outside)) / outside.shape[1]
            for ratio in _SIZES:
                yield probability / (len(kinds) * len(_SIZES)), white + ratio / size * kind


@lru_cache(maxsize=8)
def _kinds(count: int) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Covariances of noise that forgets soon, of 1/f noise, of a random walk, and of a slope that forgets."""
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    flicker = np.asarray(sum(np.exp(-apart * 2.0**-octave) for octave in range(_OCTAVES)))
    total = np.tril(np.ones((count, count)))
    slopes = [total @ np.exp(-apart / (memory * count)) @ total.T for memory in _MEMORIES]
    return (np.exp(-apart),), (flicker, total @ total.T, *slopes)


_SIGNIFICANCE = 8.0
"""In white noise one of 1,100 values exceeds it by chance, since six values tell their scatter badly (5: one
of 150; simulated); of 20,000 turning points 3 exceed 5 and none exceeds 6, and real noise is not as white.
The least step that is reported is meant to lie above the noise."""
_HALF = 6
_KICK_HALF = 8
"""Turning points of a line: two for the line, six for its scatter."""
_MOST_MISSING = _KICK_HALF // 2
"""Half a line: over a longer gap both lines are extrapolated too far."""


@dataclass(frozen=True, slots=True)
class Step:
    """A change by `size` (unit of the values) that began at `time_ns`."""

    time_ns: int
    size: float


class StepWatch:
    """Compares the median of the last six values with that of the six before.

    Parameters
    ----------
    least
        Smaller steps are not reported (unit of the values).
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._values: deque[tuple[int, float]] = deque(maxlen=2 * _HALF)

    def take(self, time_ns: int, value: float) -> Step | None:
        """Take the next value; NaN is left out. Returns a step once, six values after it happened."""
        if not math.isfinite(value):
            return None
        self._values.append((time_ns, value))
        if len(self._values) < 2 * _HALF:
            return None
        values = np.array([found for _, found in self._values])
        before, after = values[:_HALF], values[_HALF:]
        size = float(np.median(after) - np.median(before))
        scatter = math.hypot(robust_scatter(before), robust_scatter(after))
        # a step within one half makes that half scatter; so one is seen only when it lies between them
        if abs(size) < max(self._least, _SIGNIFICANCE * scatter / math.sqrt(_HALF)):
            return None
        time_ns = self._values[_HALF][0]
        for _ in range(_HALF):
            self._values.popleft()
        return Step(time_ns, size)


class KickWatch:
    """Compares a straight line through eight turning points with one through the eight before.

    The curvature of a decay bends both alike, so that it cancels. A push while the pendulum is fast changes
    its amplitude, one at a turning point its phase; both count. The size of a push is the amplitude that it
    would have given at rest.

    Parameters
    ----------
    least
        Smaller pushes are not reported (unit of the amplitudes).
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._points: deque[tuple[int, int, float]] = deque(maxlen=2 * _KICK_HALF)

    def take(self, index: int, time_ns: int, amplitude: float) -> Step | None:
        """Take the next turning point; NaN is left out. Returns a push once, eight points after it.

        More than four that are missing in a row, by `index`, begin afresh.
        """
        if not math.isfinite(amplitude):
            return None
        if self._points and index - self._points[-1][0] > _MOST_MISSING + 1:
            self._points.clear()
        self._points.append((index, time_ns, amplitude))
        if len(self._points) < 2 * _KICK_HALF:
            return None
        first_ns = self._points[0][1]
        count = np.array([point[0] for point in self._points], dtype=np.float64)
        time_s = np.array([seconds(point[1] - first_ns) for point in self._points])
        sizes = np.array([point[2] for point in self._points])
        middle = 0.5 * (count[_KICK_HALF - 1] + count[_KICK_HALF])
        grown, u_grown = _jump(count, sizes, middle)
        late_s, u_late_s = _jump(count, time_s, middle)
        # half a period is the slope of the times
        rate = math.pi * (count[-1] - count[0]) / time_s[-1] * float(np.mean(sizes))
        size = math.hypot(grown, rate * late_s)
        if size < max(self._least, _SIGNIFICANCE * math.hypot(u_grown, rate * u_late_s)):
            return None
        time_ns = self._points[_KICK_HALF][1]
        for _ in range(_KICK_HALF):
            self._points.popleft()
        return Step(time_ns, size)


def _jump(at: Floats, values: Floats, middle: float) -> tuple[float, float]:
    """Jump at `middle` between the lines through both halves, and its standard uncertainty."""
    ends, squares, spread = [], 0.0, 0.0
    for half in (slice(None, _KICK_HALF), slice(_KICK_HALF, None)):
        x, y = at[half] - middle, values[half]
        centred = x - x.mean()
        slope = float(centred @ y) / float(centred @ centred)
        end = float(y.mean()) - slope * float(x.mean())
        ends.append(end)
        squares += float(np.sum((y - end - slope * x) ** 2))
        spread += 1.0 / _KICK_HALF + float(x.mean()) ** 2 / float(centred @ centred)
    return ends[1] - ends[0], math.sqrt(squares / (2 * _KICK_HALF - 4) * spread)
