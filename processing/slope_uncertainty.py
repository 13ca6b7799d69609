"""Uncertainty of a slope in wandering noise, and detection of steps and kicks while they happen."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.noise_models import robust_scatter
from processing.units import seconds

PARTS: Final = 64
"""Number of parts of a record; noise that is faster than a part counts as white."""
FEWEST_PARTS: Final = 8
"""Fewest parts beyond the number of coefficients."""
_VARIANCE_RATIOS: Final = np.logspace(-1.5, 4.0, 12)
"""Variances of wandering noise that are tried, relative to white noise, after subtraction of a line."""
_OCTAVES: Final = 7
_CORRELATION_TIMES: Final = (1 / 32, 1 / 8)
"""Correlation times of a wandering slope, relative to the record's length; it cannot show longer ones."""
_P_WHITE: Final = 0.6
"""Prior probability that noise is white."""
_P_SHORT: Final = 0.2
"""Prior probability that the correlation time of noise is within a part."""


def part_means(values: Floats) -> Floats:
    """Means of consecutive equal parts of values (n,) or (n, k), along the first axis."""
    count = min(PARTS, len(values))
    edges = np.linspace(0, len(values), count + 1).round().astype(int)
    sums = np.add.reduceat(values, edges[:-1], axis=0)
    lengths = np.diff(edges)
    return np.asarray(sums / (lengths if values.ndim == 1 else lengths[:, None]))


def u_wandering_slope(design: Floats, residual: Floats) -> float:
    """Standard uncertainty of the first coefficient of a linear fit to evenly spaced means.

    Parameters
    ----------
    design : (m, k)
        Means of the fit's columns over the parts, with at least 8 parts more than columns.
    residual : (m,)
        Residuals of the means from the fit, which has equal weights.

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
    complement = np.linalg.qr(design, mode="complete")[0][:, columns:]
    projected = complement.T @ residual
    to_slope = np.linalg.pinv(design)[0]
    log_weights, variances = [], []
    for probability, covariance in _noise_models(count, complement):
        root = np.linalg.cholesky(complement.T @ covariance @ complement)
        white = np.linalg.solve(root, projected)
        scale = float(white @ white) / dof
        if scale <= 0.0:
            return 0.0
        log_likelihood = -float(np.log(np.diag(root)).sum()) - 0.5 * dof * np.log(scale)
        log_weights.append(np.log(probability) + log_likelihood)
        variances.append(scale * float(to_slope @ covariance @ to_slope) * dof / (dof - 2))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    return float(np.sqrt(weights @ np.array(variances) / weights.sum()))


def _noise_models(count: int, complement: Floats) -> Iterator[tuple[float, Floats]]:
    """Prior probabilities of noise models, and covariances (m, m) of the means by each."""
    white = np.eye(count)
    yield _P_WHITE, white
    short, lasting = _wandering_covariances(count)
    for covariances, probability in ((short, _P_SHORT), (lasting, 1.0 - _P_WHITE - _P_SHORT)):
        for covariance in covariances:
            size = float(np.trace(complement.T @ covariance @ complement)) / complement.shape[1]
            for ratio in _VARIANCE_RATIOS:
                share = probability / (len(covariances) * len(_VARIANCE_RATIOS))
                yield share, white + ratio / size * covariance


@lru_cache(maxsize=8)
def _wandering_covariances(count: int) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Covariances of wandering noise: of short correlation; of 1/f noise, a random walk, wandering slopes."""
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    flicker = np.asarray(sum(np.exp(-lag * 2.0**-octave) for octave in range(_OCTAVES)))
    integral = np.tril(np.ones((count, count)))
    slopes = [integral @ np.exp(-lag / (time * count)) @ integral.T for time in _CORRELATION_TIMES]
    return (np.exp(-lag),), (flicker, integral @ integral.T, *slopes)


_MIN_STEP_SIGNIFICANCE = 8.0
"""Least significance of a step. By chance one of 1,100 values of white noise exceeds it, since six values
show their scatter badly (one of 150 exceeds 5; simulated). Of 20,000 turning points 3 exceed 5 and none 6,
and real noise is not as white."""
_STEP_HALF = 6
"""Number of values on either side of a step."""
_KICK_HALF = 8
"""Turning points of a line on either side of a kick: two for the line, six for its scatter."""
_MAX_MISSING = _KICK_HALF // 2
"""Most turning points missing in a row, half a line: over a longer gap the extrapolation is too far."""


@dataclass(frozen=True, slots=True)
class Step:
    """Change by `size` (unit of the values) that began at `time_ns`."""

    time_ns: int
    size: float


class StepWatch:
    """Detector of steps, which compares the median of the last six values with that of the six before.

    Parameters
    ----------
    min_size
        Smallest step that is reported (unit of the values); it should be above the noise.
    """

    def __init__(self, min_size: float) -> None:
        self._min_size = min_size
        self._values: deque[tuple[int, float]] = deque(maxlen=2 * _STEP_HALF)

    def take(self, time_ns: int, value: float) -> Step | None:
        """Add the next value; NaN is left out. Returns a step once, six values after it happened."""
        if not math.isfinite(value):
            return None
        self._values.append((time_ns, value))
        if len(self._values) < 2 * _STEP_HALF:
            return None
        values = np.array([recorded for _, recorded in self._values])
        earlier, later = values[:_STEP_HALF], values[_STEP_HALF:]
        size = float(np.median(later) - np.median(earlier))
        scatter = math.hypot(robust_scatter(earlier), robust_scatter(later))
        # a step within one half makes that half scatter, so that it is found only between the halves
        if abs(size) < max(self._min_size, _MIN_STEP_SIGNIFICANCE * scatter / math.sqrt(_STEP_HALF)):
            return None
        time_ns = self._values[_STEP_HALF][0]
        for _ in range(_STEP_HALF):
            self._values.popleft()
        return Step(time_ns, size)


class KickWatch:
    """Detector of kicks, which compares lines through eight turning points and through the eight before.

    The curvature of a decay is the same in both lines, so that it cancels. A push while the pendulum is fast
    changes its amplitude, one at a turning point its phase; both count. The size of a push is the amplitude
    that it would have given to a pendulum at rest.

    Parameters
    ----------
    min_size
        Smallest push that is reported (unit of the amplitudes).
    """

    def __init__(self, min_size: float) -> None:
        self._min_size = min_size
        self._points: deque[tuple[int, int, float]] = deque(maxlen=2 * _KICK_HALF)

    def take(self, index: int, time_ns: int, amplitude: float) -> Step | None:
        """Add the next turning point; NaN is left out. Returns a push once, eight points after it.

        After more than four missing turning points in a row, by `index`, the detector starts again.
        """
        if not math.isfinite(amplitude):
            return None
        if self._points and index - self._points[-1][0] > _MAX_MISSING + 1:
            self._points.clear()
        self._points.append((index, time_ns, amplitude))
        if len(self._points) < 2 * _KICK_HALF:
            return None
        first_ns = self._points[0][1]
        numbers = np.array([number for number, _, _ in self._points], dtype=np.float64)
        time_s = np.array([seconds(turn_ns - first_ns) for _, turn_ns, _ in self._points])
        amplitudes = np.array([recorded for _, _, recorded in self._points])
        middle = 0.5 * (numbers[_KICK_HALF - 1] + numbers[_KICK_HALF])
        growth, u_growth = _jump(numbers, amplitudes, middle)
        delay_s, u_delay_s = _jump(numbers, time_s, middle)
        # half a period is the slope of the times
        speed = math.pi * (numbers[-1] - numbers[0]) / time_s[-1] * float(np.mean(amplitudes))
        size = math.hypot(growth, speed * delay_s)
        if size < max(self._min_size, _MIN_STEP_SIGNIFICANCE * math.hypot(u_growth, speed * u_delay_s)):
            return None
        time_ns = self._points[_KICK_HALF][1]
        for _ in range(_KICK_HALF):
            self._points.popleft()
        return Step(time_ns, size)


def _jump(numbers: Floats, values: Floats, middle: float) -> tuple[float, float]:
    """Jump at `middle` between the lines through both halves, and its standard uncertainty."""
    ends, squares, spread = [], 0.0, 0.0
    for half in (slice(None, _KICK_HALF), slice(_KICK_HALF, None)):
        x, y = numbers[half] - middle, values[half]
        centred = x - x.mean()
        slope = float(centred @ y) / float(centred @ centred)
        end = float(y.mean()) - slope * float(x.mean())
        ends.append(end)
        squares += float(np.sum((y - end - slope * x) ** 2))
        spread += 1.0 / _KICK_HALF + float(x.mean()) ** 2 / float(centred @ centred)
    return ends[1] - ends[0], math.sqrt(squares / (2 * _KICK_HALF - 4) * spread)
