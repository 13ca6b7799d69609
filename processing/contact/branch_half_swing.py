"""The half-swing map of a law that follows from the last reversal (`Branch`), by quadrature.

From a reversal at A the kinetic energy after the distance s is, over m g R and in units of the reference,

    v^2/2 = s [A - s/2 - L(s)],      L(s) = 1/s integral_0^s (resistance) ds'

so that the next reversal lies at s = 2 r with A - r = L(2r). With s = r (1 - cos theta), the factor

    G = v^2 / (r sin theta)^2 = 1 + 2 [L(2r) - L(s)] / (2r - s)

is smooth at both ends but for powers of s, which theta = pi v^3 smooths; the half-swing lasts
``integral dtheta / (2 pi sqrt(G))`` in units of T0. A linear drag adds ``drag r^2 integral sin^2 sqrt(G)
dtheta`` to the work, found by iteration.

Loss and duration are tabulated over the amplitude and interpolated; a decay is a walk through the table. The
amplitudes fall slowly, so that the moment at a reversal is a function of the amplitude, too: the steady one,
corrected by the moment that the branch before ends with.
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from math import exp, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.branch import Arrays, Branch
from processing.contact.law import HalfSwings
from processing.contact.tabulated_decay import SwingTable, walk

_NODES = 24
"""With so many, decays by smooth laws agree with an integration of their motion to 3e-7 (test_branches)."""
_PER_TABLE, _TABLE_RATIO = 25, 4.0
"""Amplitudes of a table, evenly in the logarithm, and the ratio of the largest to the smallest."""
_STEP = 1e-5
"""Relative step of the numerical derivatives by the parameters."""


class _Nodes(NamedTuple):
    """Gauss-Legendre nodes of v with theta = pi v^3.

    The rows of `work_per_share` map sqrt(G) at the nodes to ``integral_0^theta sin^2 sqrt(G) dtheta'``
    divided by the share; only the root is interpolated, so that the digits stay near the reversal.
    """

    share: Floats  # s / 2r
    sin2: Floats
    weight: Floats
    work_per_share: Floats


@lru_cache(maxsize=1)
def _nodes() -> _Nodes:
    x, w = np.polynomial.legendre.leggauss(_NODES)
    v, half = (x + 1) / 2, w / 2
    share = np.sin(np.pi / 2 * v**3) ** 2
    to_coefficients = (
        (2 * np.arange(_NODES) + 1)[:, None] / 2 * np.polynomial.legendre.legvander(x, _NODES - 1).T * w
    )
    inner = v[:, None] * v
    weights = v[:, None] * half * np.sin(np.pi * inner**3) ** 2 * 3 * np.pi * inner**2
    interpolated = np.polynomial.legendre.legvander(2 * inner - 1, _NODES - 1) @ to_coefficients
    return _Nodes(
        share,
        np.sin(np.pi * v**3) ** 2,
        3 * np.pi * v**2 * half,
        np.einsum("kj,kjm->km", weights, interpolated) / share[:, None],
    )


def _half_swing(branch: Branch, amplitude: Floats, held: Floats, q: Arrays) -> tuple[Floats, Floats, Floats]:
    """Next amplitude, duration (T0) and moment at the next reversal; NaN where the pendulum sticks.

    `amplitude` and `held` have the shape ``(sets, amplitudes)``, the parameters ``(sets, 1)``.
    """
    nodes = _nodes()
    drag, dry = q["drag"], q[branch.constant] if branch.constant else 0.0
    radius, lost = amplitude.copy(), np.zeros_like(amplitude)  # work of the drag over r^2
    wide = {key: value[..., None] for key, value in q.items()}
    with np.errstate(all="ignore"):
        for _ in range(60):
            for _ in range(50):
                way = 2 * radius
                mean = branch.mean_resistance(way, held, q)
                slope = 1 + (branch.resistance(way, held, q) - mean) / radius + 0.5 * drag * lost
                change = (amplitude - radius - mean - dry - 0.5 * drag * lost * radius) / slope
                radius += np.clip(change, -0.5 * radius, 0.5 * radius)
                if not np.any(np.abs(change) > 3e-16 * amplitude):
                    break
            way = 2 * radius[..., None]
            s = way * nodes.share
            at_end = branch.mean_resistance(way, held[..., None], wide)
            root = np.ones_like(s)
            over = at_end - branch.mean_resistance(s, held[..., None], wide)
            if not np.any(drag):
                root = np.sqrt(1 + 2 * over / (way - s))
                break
            for _ in range(60):
                whole = ((nodes.sin2 * root) @ nodes.weight)[..., None]
                by_drag = wide["drag"] * (0.25 * way) * (whole - root @ nodes.work_per_share.T)
                new = np.sqrt(1 + 2 * (over + by_drag) / (way - s))
                settled = not np.any(np.abs(new - root) > 1e-14)
                root = new
                if settled:
                    break
            before = lost
            lost = (nodes.sin2 * root) @ nodes.weight
            if not np.any(np.abs(lost - before) > 1e-14):
                break
        following = 2 * radius - amplitude
        stuck = ~(following > 0)
        following = np.where(stuck, np.nan, following)
        duration = (1 / root) @ nodes.weight / (2 * np.pi)
        return following, duration, branch.resistance(2 * radius, held, q)


# a search tries values whose quotients overflow; rows that are not finite are left out below
@np.errstate(all="ignore")
def _table(branch: Branch, names: Sequence[str], parameters: Floats, highest: float) -> SwingTable | None:
    """Half-swings from amplitudes below `highest`; None where the pendulum sticks."""
    from scipy.interpolate import CubicSpline  # here, because it would slow down every command

    log_a = log(highest) - log(_TABLE_RATIO) * np.linspace(1.03, -0.03, _PER_TABLE)
    count = len(parameters)
    sets = np.repeat(parameters[None, :], 2 * count + 1, axis=0)
    steps = _STEP * np.maximum(np.abs(parameters), 1e-3)
    for k in range(count):
        sets[1 + k, k] += steps[k]
        sets[1 + count + k, k] -= steps[k]
    q = {name: sets[:, [k]] for k, name in enumerate(names)}
    amplitude = np.repeat(np.exp(log_a)[None, :], len(sets), axis=0)
    steady = branch.at_reversal(amplitude, q)
    held = steady
    for again in (True, False):
        following, duration, next_held = _half_swing(branch, amplitude, held, q)
        if again:
            # the moment at the next reversal is linear in the one at this
            way = amplitude + following
            fading = (branch.resistance(way, 0.0 * held, q) - next_held) / held
            more = (next_held / branch.at_reversal(following, q) - 1) / (1 + fading)
            held = steady * (1 + _on_grid(log_a, np.log(following), more))
    ratio = following / amplitude
    by = [(one[1 : 1 + count] - one[1 + count :]) / (2 * steps[:, None]) for one in (ratio, duration)]
    rows = np.concatenate([ratio[:1], duration[:1], *by]).T
    usable = np.isfinite(rows).all(axis=1)
    if not usable[-4:].all():
        return None
    first = len(usable) - int(np.argmin(usable[::-1])) if not usable.all() else 0
    lowest = exp(log_a[first]) if first else highest / _TABLE_RATIO
    return SwingTable(lowest, CubicSpline(log_a[first:], rows[first:]))


def _on_grid(log_a: Floats, at: Floats, values: Floats) -> Floats:
    """Values given at other places, one row a parameter set, interpolated linearly; 0 where unknown."""
    out = np.zeros_like(values)
    for row in range(len(values)):
        known = np.isfinite(at[row]) & np.isfinite(values[row])
        if known.sum() > 1:
            x, y = at[row][known], values[row][known]
            out[row] = np.interp(log_a, x, y)
            beyond = log_a > x[-1]
            out[row][beyond] = y[-1] + (y[-1] - y[-2]) / (x[-1] - x[-2]) * (log_a[beyond] - x[-1])
    return out


def branch_half_swings(branch: Branch, names: Sequence[str], parameters: Floats, index: Ints) -> HalfSwings:
    """Turning points of a decay, as every law's `half_swing_map` returns them.

    Parameters
    ----------
    branch, names
        The law, and the keys of its parameters.
    parameters
        Values in that order, the linear drag, the reference in rad, and the first amplitude (reference).
    index
        Rising half-cycle numbers, the first 0.
    """
    keys = (*names, "drag", "reference")
    own = parameters[:-1]
    return walk(partial(_table, branch, keys, own), len(own), float(parameters[-1]), index)
