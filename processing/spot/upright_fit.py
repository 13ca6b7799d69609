"""Fit of an upright, clean spot: a few passes of the quick scoring."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.general_fit import background_variance, cholesky, inverse_diagonal, solve, window_of
from processing.spot.prefetch import prefetch_window
from processing.spot.spot import Image
from processing.spot.upright_score import SMALLEST_SIGMA_PX, information, profile, score

Floats = NDArray[np.float64]

UNKNOWNS = 6
_PASSES = 10
_LARGEST_TABLE = 2048
_GATE = 25.0
_VECTOR = 32
_MOST_OUTLIERS = 8
_LARGEST_SCATTER = 1.3
_REACH = 4.5
_LEFT_OVER = 0.03
"""Part of a standard uncertainty that may be left when the passes stop: it adds 0.05 % to the scatter."""


@njit(cache=True, nogil=True, error_model="numpy")
def fit_upright(
    image: Image,
    p: Floats,
    rough: bool,
    zero_variance: float,
    inverse_gain: float,
    uneven: float,
    full_scale: float,
    tables: NDArray[np.float32],
    matrix: Floats,
    factor: Floats,
) -> tuple[bool, float, int, int, float]:
    """Scoring from a good start: done, chi2, pixels, outliers, evidence of a tilt in standard deviations.

    From a `rough` start the first passes read some of the rows only. Not done where the model saturates,
    more than single pixels stand out, or it does not settle: the general fit's cases.
    """
    ny, nx = image.shape
    gradient = np.empty(7)
    step = np.empty(UNKNOWNS)
    informed = False
    fetched = False
    opened = rough
    gate = _GATE
    if rough:
        # half the amplitude on a dark pixel is no poor start but a hot pixel
        floor = background_variance(p, zero_variance, inverse_gain)
        gate = max(4.0 * _GATE, 0.25 * p[0] * p[0] / floor)
    for _ in range(_PASSES):
        floor = background_variance(p, zero_variance, inverse_gain)
        if p[0] + p[5] + 3.0 * math.sqrt(floor + p[0] * (inverse_gain + p[0] * uneven)) >= full_scale:
            return False, 0.0, 0, 0, 0.0
        x0, y0, x1, y1 = window_of(p, nx, ny, _REACH)
        wx, wy = x1 - x0, y1 - y0
        # whole vectors: a remainder of pixels done one by one would cost more than the wider row
        wider = (wx + _VECTOR - 1) // _VECTOR * _VECTOR
        left = x0 - (wider - wx) // 2
        if left >= 0 and left + wider <= nx:
            x0, wx = left, wider
        if min(p[3], p[4]) < SMALLEST_SIGMA_PX or max(wx, wy) > _LARGEST_TABLE or min(wx, wy) < 4:
            return False, 0.0, 0, 0, 0.0
        if not fetched:
            prefetch_window(image, x0, y0, wx, wy)
            fetched = True
        profile(tables[0:3], x0, wx, p[1], p[3])
        profile(tables[3:6], y0, wy, p[2], p[4])
        row_step = max(1, int(0.7 * p[4])) if rough else 1
        chi2, kept = score(
            image, x0, y0, wx, wy, row_step, tables, p[0], p[5], floor, inverse_gain, uneven, gate, gradient
        )
        outliers = wx * wy - int(kept)
        many = outliers > _MOST_OUTLIERS + 0.002 * wx * wy
        if many and not opened:
            # the spot has moved further than expected: what the gate keeps would hardly tell where to
            opened = True
            gate = math.inf
            continue
        if not informed:
            # sums over a grid as fine as sigma are exact, but not those that an edge cuts off
            step_x = max(1, int(p[3])) if x0 > 0 and x0 + wx < nx else 1
            step_y = max(1, int(p[4])) if y0 > 0 and y0 + wy < ny else 1
            information(wx, wy, tables, p[0], floor, inverse_gain, uneven, step_x, step_y, matrix)
            if not cholesky(matrix, UNKNOWNS, factor):
                return False, 0.0, 0, 0, 0.0
            informed = True
        solve(factor, UNKNOWNS, gradient, step)
        largest = 0.5 if rough else 0.2
        if (
            abs(step[3]) > largest * p[3]
            or abs(step[4]) > largest * p[4]
            or abs(step[0]) > 1.5 * largest * p[0]
        ):
            return False, 0.0, 0, 0, 0.0
        if abs(step[1]) > p[3] or abs(step[2]) > p[4]:
            return False, 0.0, 0, 0, 0.0
        # what is left after a step is its product with the steps of the others, in units of sigma
        sigma = min(p[3], p[4])
        others = abs(step[1]) + abs(step[2]) + abs(step[3]) + abs(step[4]) + sigma * abs(step[0]) / p[0]
        u_x = math.sqrt(inverse_diagonal(factor, UNKNOWNS, 1))
        u_y = math.sqrt(inverse_diagonal(factor, UNKNOWNS, 2))
        small = (
            abs(step[1]) * others < _LEFT_OVER * u_x * sigma
            and abs(step[2]) * others < _LEFT_OVER * u_y * sigma
        )
        changed = max(abs(step[0]) / p[0], abs(step[3]) / p[3], abs(step[4]) / p[4]) > 0.03
        for k in range(UNKNOWNS):
            p[k] += step[k]
        scatter = chi2 / max(kept, 1.0)
        settled = gate <= _GATE * _LARGEST_SCATTER
        # what the step takes with it; a long one may take less
        expected = chi2
        if others < 0.5 * sigma:
            for k in range(UNKNOWNS):
                expected -= gradient[k] * step[k]
        gate = _GATE * max(1.0, expected / max(kept, 1.0))
        if changed:
            informed = False
        elif rough:
            rough = False
        elif small and settled:
            if many or scatter > _LARGEST_SCATTER:
                return False, 0.0, 0, 0, 0.0
            # the last step takes this much with it
            for k in range(UNKNOWNS):
                chi2 -= gradient[k] * step[k]
            return True, chi2, int(kept), outliers, gradient[6] / math.sqrt(max(matrix[6, 6], 1e-300))
    return False, 0.0, 0, 0, 0.0
