"""Quadrature nodes for a quarter of a swing, without the singularities at both ends.

The substitution ``phi = A cos(theta)`` removes the square-root singularity at the turning point. The
fractional powers of |phi| leave another one at the zero crossing, which ``pi/2 - theta = (pi/2) v**3``
smooths. A Gauss-Legendre rule in v then converges quickly for every exponent.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats

NODES = 20
"""Number of nodes; the error is below 1e-12 of a half period for any exponent above zero."""


class QuarterNodes(NamedTuple):
    """Nodes from the turning point (theta = 0) to the zero crossing (theta = pi/2).

    `weight` are the weights for integration over theta. The matrix `travelled` (NODES, NODES) maps values f
    at the nodes to ``integral_0^theta_k sin^2 f dtheta' / sin^2 theta_k``, the work of a moment proportional
    to the speed; dividing by sin^2 avoids 0/0 at the turning point.
    """

    weight: Floats
    cos: Floats
    log_cos: Floats
    sin2: Floats
    travelled: Floats


@lru_cache(maxsize=1)
def quarter_nodes() -> QuarterNodes:
    """The nodes; computed once and cached."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    v = (x[::-1] + 1.0) / 2.0  # falling v: rising theta
    w = w[::-1] / 2.0
    past_zero = np.pi / 2 * v**3
    weight = 1.5 * np.pi * v**2 * w
    cos = np.sin(past_zero)
    sin2 = np.cos(past_zero) ** 2
    # The integral from v_k to 1 of a polynomial through the nodes, by its Legendre coefficients.
    legendre = np.polynomial.legendre.legvander(2 * v - 1, NODES)
    to_coefficients = ((2 * np.arange(NODES) + 1)[:, None] * legendre[:, :NODES].T) * w
    integral = np.empty((NODES, NODES))
    integral[:, 0] = 1.0 - v
    for k in range(1, NODES):
        # integral_x^1 P_k = (P_{k-1}(x) - P_{k+1}(x)) / (2 k + 1); half of it, for dv = dx/2
        integral[:, k] = (legendre[:, k - 1] - legendre[:, k + 1]) / (2 * (2 * k + 1))
    travelled = (integral @ to_coefficients) * (1.5 * np.pi * v**2 * sin2) / sin2[:, None]
    return QuarterNodes(weight, cos, np.log(cos), sin2, travelled)
