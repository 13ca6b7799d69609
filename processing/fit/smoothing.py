"""Friedman's super-smoother: a curve through T(alpha) without a physical model (Fig. 14).

J. H. Friedman, "A variable span smoother", Stanford LCS technical report 5 (1984). Running lines are fitted
with three spans. At every point the span with the smallest smoothed cross-validation residuals is chosen,
and the choice itself is smoothed.
"""

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.kernel import kernel

SPANS = (0.05, 0.2, 0.5)
"""Friedman's three spans (tweeter, midrange, woofer) as fractions of the number of points."""
_FEWEST = 8


@kernel
def _running_lines(x: Floats, y: Floats, weight: Floats, span: float) -> tuple[Floats, Floats]:
    """Local straight lines through the nearest neighbours on either side, and the cross-validation residuals
    (of each point from the line fitted without it)."""
    count = len(x)
    half = max(int(0.5 * span * count + 0.5), 2)
    smooth = np.empty(count)
    left_out = np.empty(count)
    for i in range(count):
        # near an end the window keeps its size and extends to one side
        low = min(max(i - half, 0), max(count - 1 - 2 * half, 0))
        high = min(low + 2 * half, count - 1)
        total = mean_x = mean_y = 0.0
        for j in range(low, high + 1):
            total += weight[j]
            mean_x += weight[j] * x[j]
            mean_y += weight[j] * y[j]
        mean_x /= total
        mean_y /= total
        xx = xy = 0.0
        for j in range(low, high + 1):
            xx += weight[j] * (x[j] - mean_x) ** 2
            xy += weight[j] * (x[j] - mean_x) * (y[j] - mean_y)
        slope = xy / xx if xx > 0 else 0.0
        smooth[i] = mean_y + slope * (x[i] - mean_x)
        leverage = weight[i] * (1 / total + ((x[i] - mean_x) ** 2 / xx if xx > 0 else 0.0))
        left_out[i] = abs(y[i] - smooth[i]) / max(1 - leverage, 1e-3)
    return smooth, left_out


def super_smooth(x: Floats, y: Floats, u: Floats) -> Floats:
    """Smooth y over x, with the span chosen by cross-validation at every point.

    Parameters
    ----------
    x, y
        One length, at least eight points, x in any order; equal x are allowed.
    u
        Standard uncertainties of y; weights are 1/u^2.

    Returns
    -------
    The smooth at every x, in the order given.
    """
    if not len(x) == len(y) >= _FEWEST:
        raise DataError(
            f"{len(x)} and {len(y)} points: smoothing needs two equally long series of at least {_FEWEST}"
        )
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise DataError("smoothing needs finite values")
    if not (len(u) == len(x) and np.all(u > 0)):
        raise DataError("smoothing needs one positive uncertainty for every point")
    order = np.argsort(x, kind="stable")
    xs, ys, weight = x[order], y[order], (np.median(u) / u[order]) ** 2
    # The comparison of spans at one point does not depend on u there. For smoothing over points the residuals
    # have to be normalised.
    size = np.sqrt(weight)
    smooths, errors = [], []
    for span in SPANS:
        smooth, left_out = _running_lines(xs, ys, weight, span)
        smooths.append(smooth)
        errors.append(_running_lines(xs, left_out * size, np.ones(len(xs)), SPANS[1])[0])
    chosen = np.array(SPANS)[np.argmin(errors, axis=0)]
    chosen = np.clip(_running_lines(xs, chosen, np.ones(len(xs)), SPANS[1])[0], SPANS[0], SPANS[-1])
    below = chosen < SPANS[1]
    share = np.where(
        below, (chosen - SPANS[0]) / (SPANS[1] - SPANS[0]), (chosen - SPANS[1]) / (SPANS[2] - SPANS[1])
    )
    between = np.where(
        below,
        (1 - share) * smooths[0] + share * smooths[1],
        (1 - share) * smooths[1] + share * smooths[2],
    )
    out = np.empty(len(xs))
    out[order] = _running_lines(xs, between, weight, SPANS[0])[0]
    return out
