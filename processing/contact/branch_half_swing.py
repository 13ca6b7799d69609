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
from functools import lru_cache
from math import exp, log
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact.branch import Array, Arrays, Branch
from processing.contact.law import HalfSwings

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_NODES = 24
_PER_TABLE, _TABLE_RATIO = 25, 4.0
"""Amplitudes of a table, evenly in the logarithm, and the ratio of the largest to the smallest."""
_STEP = 1e-5
"""Relative step of the numerical derivatives by the parameters."""


class _Nodes(NamedTuple):
    """Gauss-Legendre nodes of v with theta = pi v^3.

    The rows of `work_per_share` map sqrt(G) at the nodes to ``integral_0^theta sin^2 sqrt(G) dtheta'``
    divided by the share; only the root is interpolated, so that the digits stay near the reversal.
    """

    share: Array  # s / 2r
    sin2: Array
    weight: Array
    work_per_share: Array


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


def _half_swing(branch: Branch, amplitude: Array, held: Array, q: Arrays) -> tuple[Array, Array, Array]:
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


class _Table(NamedTuple):
    """A'/A and duration over ln A, and their derivatives by the parameters."""

    lowest: float
    ratio: Array  # polynomial coefficients, highest power first, one column an interval
    knots: Array
    values: "CubicSpline"
    """Of ln A: A'/A, duration, then the derivatives of each by the parameters."""


def _table(branch: Branch, names: Sequence[str], parameters: Array, highest: float) -> _Table:
    """Half-swings from amplitudes below `highest`."""
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
        return _Table(np.inf, np.empty((4, 0)), log_a, CubicSpline([0, 1], [[0], [0]]))
    first = len(usable) - int(np.argmin(usable[::-1])) if not usable.all() else 0
    values = CubicSpline(log_a[first:], rows[first:])
    lowest = exp(log_a[first]) if first else highest / _TABLE_RATIO
    return _Table(lowest, values.c[:, :, 0], values.x, values)


def _on_grid(log_a: Array, at: Array, values: Array) -> Array:
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


def branch_half_swings(
    branch: Branch, names: Sequence[str], parameters: Array, index: NDArray[np.int64]
) -> HalfSwings:
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
    count, last = len(own), int(index[-1])
    amplitudes: list[float] = [float(parameters[-1])]
    rows: list[Array] = []
    while len(amplitudes) <= last and amplitudes[-1] > 0:
        table = _table(branch, keys, own, amplitudes[-1])
        begun = len(amplitudes) - 1
        _walk(table, amplitudes, last)
        if len(amplitudes) == begun + 1:
            break
        log_a = np.log(amplitudes[begun:-1])
        here = table.values(log_a)
        slope = table.values(log_a, 1)[:, :2] / np.exp(log_a)[:, None]
        rows.append(np.column_stack([slope, here]))
    out = np.full((len(index), 2 * count + 4), np.nan)
    walked = np.concatenate(rows) if rows else np.empty((0, 2 * count + 4))
    a = np.array(amplitudes[: len(walked) + 1])
    # dA'/dA and, at fixed A, dA'/dq; likewise the duration
    by_a = walked[:, 2] + a[:-1] * walked[:, 0]
    by_q = a[:-1, None] * walked[:, 4 : 4 + count]
    product = np.concatenate([[1.0], np.cumprod(by_a)])
    summed = np.cumsum(by_q / product[1:, None], axis=0)
    gradient = product[:, None] * np.column_stack(
        [np.concatenate([np.zeros((1, count)), summed]), np.ones(len(a))]
    )
    by_time = walked[:, 1][:, None] * gradient[:-1]
    by_time[:, :count] += walked[:, 4 + count :]
    reached = index < len(a)
    at = index[reached]
    out = _filled(len(index), reached, a[at])
    time = np.concatenate([[0.0], np.cumsum(walked[:, 3])])
    time_gradient = np.concatenate([np.zeros((1, count + 1)), np.cumsum(by_time, axis=0)])
    return HalfSwings(
        out,
        _filled(len(index), reached, time[at]),
        _filled(len(index), reached, gradient[at]),
        _filled(len(index), reached, time_gradient[at]),
    )


def _filled(count: int, where: NDArray[np.bool_], values: Array) -> Array:
    out = np.full((count, *values.shape[1:]), np.nan)
    out[where] = values
    return out


def _walk(table: _Table, amplitudes: list[float], last: int) -> None:
    """Append amplitudes until the table or the wanted number ends."""
    c3, c2, c1, c0 = (row.tolist() for row in table.ratio)
    if not c0:
        return
    origin, step = float(table.knots[0]), float(table.knots[1] - table.knots[0])
    knots = table.knots.tolist()
    here = amplitudes[-1]
    while len(amplitudes) <= last and here >= table.lowest:
        log_a = log(here)
        k = min(max(int((log_a - origin) / step), 0), len(c0) - 1)
        d = log_a - knots[k]
        here *= ((c3[k] * d + c2[k]) * d + c1[k]) * d + c0[k]
        amplitudes.append(here)
