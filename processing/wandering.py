"""Standard uncertainty of a straight line's slope where the noise about it wanders.

The scatter about a line shows little of what a slow wander does to its slope, which takes most of it in. What
it shows is weighed: white noise alone, or with noise that forgets soon, with 1/f noise, with a random walk,
or with a slope that varies about its mean, each in many sizes. Each is as probable as what the line has left
makes it (restricted likelihood), and says what variance the slope has. The uncertainty is the root of the
mean over all: noise that forgets soon is claimed up to twice too uncertain, a wander that white noise hides
is not. A slope that varies more slowly than a record lasts is not seen in it.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.errors import DataError

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
