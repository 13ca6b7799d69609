"""Compiled kernel of the half-swing map; `half_swing` explains the principle and the units.

With the kinetic term (A^2/2) sin^2(theta) g(theta) of a quarter that belongs to a turning point at A,

    time of a quarter            tau(A) = integral_0^(pi/2) dtheta / (2 pi sqrt(g))    in units of T0
    energy at the zero crossing  E(A) = (A^2/2) g(pi/2)

The next amplitude A' solves E_arrive(A') = E_leave(A), and the half-cycle takes tau_leave(A) +
tau_arrive(A').

Derivatives are exact. Without drag, g is an explicit function of the parameters. With drag, g satisfies an
integral equation; its derivatives are obtained from the adjoint equation, so that their cost does not grow
with the number of parameters. A trial step of the solver may lead to a division by zero: as in numpy it
gives inf, and the solver rejects the step.
"""

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.quadrature import NODES
from processing.kernel import kernel

B, P, C, N, KAPPA, DRAG, RHO, A0 = range(8)
_TO_N, _TO_P1, _LOG = range(3)
"""Of an amplitude A: A^n, A^(p-1) and ln A, which cost more than what is made of them."""
MAP_PARAMETERS = 8
"""Number of parameters of the map: those of `ScaledContact`, then the first amplitude."""
_SOLVED = 1e-11
"""Last change of an adjoint, relative: derivatives need not be as good as the times themselves."""


@kernel
def _powers(q: Floats, a: float, out: Floats) -> None:
    out[_TO_N], out[_TO_P1], out[_LOG] = a ** q[N], a ** (q[P] - 1), np.log(a)


@kernel
def _times(rows: Floats, factor: Floats, out: Floats) -> None:
    """``out = sum_j rows_j factor_j``, four nodes at once, so that their sums run side by side."""
    for k in range(0, NODES, 4):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        for j in range(NODES):
            value = factor[j]
            first += rows[j, k] * value
            second += rows[j, k + 1] * value
            third += rows[j, k + 2] * value
            fourth += rows[j, k + 3] * value
        out[k], out[k + 1], out[k + 2], out[k + 3] = first, second, third, fourth


@kernel
def _shape(
    q: Floats,
    side: float,
    a: float,
    powers: Floats,
    constant: Floats,
    by_node: Floats,
    g: Floats,
    root: Floats,
    work: Floats,
) -> bool:
    """Compute g and sqrt(g) at the nodes of one quarter; False if the pendulum cannot pass (g <= 0).

    The kinetic energy gained since the turning point, divided by A^2 sin^2(theta)/2, is

        g = 1 - pi kappa A^n/(n+2) (1 - cos^(n+2))/sin^2
              + 2 kappa rho A^(n+1)/(n+3) (1 - cos^(n+3))/sin^2                    (Eq. 3)
              + side 2 [b A^(p-1)/(p+1) (1 - cos^(p+1))/sin^2 + (c/A)/(1 + cos)]    (Eq. 1)
              + side 2 drag/sin^2 integral_0^theta sin^2 sqrt(g) dtheta'

    with cos = cos(theta). `side` is -1 for the quarter after a turning point and +1 for the quarter that
    leads to it. With drag, g is found by iteration, starting from `work`, the integral divided by
    sin^2(theta) as found for the half-cycle before. `g`, `root` and `work` are overwritten.
    """
    elastic1 = -np.pi * q[KAPPA] * powers[_TO_N] / (q[N] + 2)
    elastic2 = 2 * q[KAPPA] * q[RHO] * a * powers[_TO_N] / (q[N] + 3)
    friction = side * 2 * q[B] * powers[_TO_P1] / (q[P] + 1)
    coulomb = side * 2 * q[C] / a
    drag = side * 2 * q[DRAG]
    start = np.empty(NODES)
    for k in range(NODES):
        start[k] = (
            1
            + elastic1 * constant[0, k]
            + elastic2 * constant[1, k]
            + friction * constant[2, k]
            + coulomb * constant[3, k]
        )
        if not start[k] > 0:
            return False
        g[k] = max(start[k] + drag * work[k], 0.1 * start[k])
        root[k] = np.sqrt(g[k])
    if drag == 0:
        return True
    for _ in range(200):
        change = 0.0
        _times(by_node, root, work)
        for k in range(NODES):
            value = start[k] + drag * work[k]
            if not value > 0:
                return False
            change = max(change, abs(value - g[k]))
            g[k] = value
            root[k] = np.sqrt(value)
        if change < 4e-16 * NODES:
            return True
    return False


@kernel
def _energy(q: Floats, side: float, a: float, powers: Floats, root: Floats, across: Floats) -> float:
    """g at theta = pi/2: twice the kinetic energy at the zero crossing divided by A^2."""
    total = (
        1
        - np.pi * q[KAPPA] * powers[_TO_N] / (q[N] + 2)
        + 2 * q[KAPPA] * q[RHO] * a * powers[_TO_N] / (q[N] + 3)
        + side * 2 * (q[C] / a + q[B] * powers[_TO_P1] / (q[P] + 1))
    )
    if q[DRAG] != 0:
        work = 0.0
        for k in range(NODES):
            work += across[k] * root[k]
        total += side * 2 * q[DRAG] * work
    return float(total)


@kernel
def _adjoint(side_drag: float, source: Floats, root: Floats, travelled: Floats, out: Floats) -> None:
    """Solve the adjoint equation ``out = source + side drag diag(1/root) travelled^T out`` by iteration.

    Differentiating the integral equation g = f(q) + 2 side drag T sqrt(g) (T: `travelled`) gives
    dg = df + side drag T diag(1/sqrt(g)) dg, where df holds the explicit dependence on the parameters. For
    a result with the derivative ``source`` by g, the derivative by the parameters is therefore ``out . df``.
    """
    # one by one: for out[:] = source numba compiles the text of an error, which takes longer than the rest
    for k in range(NODES):
        out[k] = source[k]
    if side_drag == 0:
        return
    total = np.empty(NODES)
    for _ in range(200):
        change = 0.0
        scale = 0.0
        _times(travelled, out, total)
        for k in range(NODES):
            value = source[k] + side_drag * total[k] / root[k]
            change = max(change, abs(value - out[k]))
            scale = max(scale, abs(value))
            out[k] = value
        # the next change would be smaller by a drag of a half-swing, one in a hundred at most
        if change <= _SOLVED * scale:
            return


@kernel
def _gradient(
    q: Floats,
    side: float,
    a: float,
    powers: Floats,
    weight: Floats,
    constant: Floats,
    drag_work: Floats,
    out: Floats,
) -> None:
    """``sum_k weight_k dg_k/dq``, explicit derivatives only; the last one is by the amplitude of the quarter.

    The rows of `constant` are (1-cos^(n+2))/sin^2, (1-cos^(n+3))/sin^2, (1-cos^(p+1))/sin^2, 1/(1+cos), the
    derivatives of the first two by n and that of the third by p, at the nodes. `drag_work` is the drag's
    integral divided by sin^2. `out` (MAP_PARAMETERS,) is overwritten.
    """
    s = np.zeros(7)
    work = 0.0
    for k in range(len(weight)):
        for row in range(7):
            s[row] += weight[k] * constant[row, k]
        work += weight[k] * drag_work[k]
    log_a = powers[_LOG]
    n, p = q[N], q[P]
    first = -np.pi * powers[_TO_N] / (n + 2)
    by_rho = 2 * a * powers[_TO_N] / (n + 3)
    second = q[RHO] * by_rho
    third = side * 2 * powers[_TO_P1] / (p + 1)
    out[B] = third * s[2]
    out[P] = q[B] * third * ((log_a - 1 / (p + 1)) * s[2] + s[6])
    out[C] = side * 2 / a * s[3]
    out[N] = q[KAPPA] * (
        first * ((log_a - 1 / (n + 2)) * s[0] + s[4]) + second * ((log_a - 1 / (n + 3)) * s[1] + s[5])
    )
    out[KAPPA] = first * s[0] + second * s[1]
    out[DRAG] = side * 2 * work
    out[RHO] = q[KAPPA] * by_rho * s[1]
    out[A0] = (
        q[KAPPA] * (first * n * s[0] + second * (n + 1) * s[1])
        + q[B] * third * (p - 1) * s[2]
        - side * 2 * q[C] / a * s[3]
    ) / a


@kernel
def _quarter(
    q: Floats,
    side: float,
    a: float,
    powers: Floats,
    nodes_weight: Floats,
    across: Floats,
    constant: Floats,
    at_zero: Floats,
    travelled: Floats,
    by_node: Floats,
    g: Floats,
    root: Floats,
    time_gradient: Floats,
    energy_gradient: Floats,
) -> float:
    """Time of one quarter in units of T0, ``integral dtheta/(2 pi sqrt(g))``.

    Also writes its gradient and that of the energy ``a^2 g(pi/2)/2`` at the zero crossing, by the parameters
    and (index A0) by the amplitude `a` of the quarter.
    """
    source = np.empty(NODES)
    adjoint = np.empty(NODES)
    drag_work = np.empty(NODES)
    time = 0.0
    # derivative of the integrand by g: d g^(-1/2)/dg = -g^(-3/2)/2
    for k in range(NODES):
        time += nodes_weight[k] / root[k]
        source[k] = -0.5 * nodes_weight[k] / (g[k] * root[k])
    side_drag = side * q[DRAG]
    _times(by_node, root, drag_work)
    _adjoint(side_drag, source, root, travelled, adjoint)
    _gradient(q, side, a, powers, adjoint, constant, drag_work, time_gradient)

    work = np.empty(1)
    work[0] = 0.0
    for k in range(NODES):
        work[0] += across[k] * root[k]
        source[k] = side_drag * across[k] / root[k]
    unit = np.ones(1)
    _gradient(q, side, a, powers, unit, at_zero, work, energy_gradient)
    if side_drag != 0:
        # the energy at the zero crossing also depends on g along the way, through the work of the drag
        _adjoint(side_drag, source, root, travelled, adjoint)
        through = np.empty(MAP_PARAMETERS)
        _gradient(q, side, a, powers, adjoint, constant, drag_work, through)
        for i in range(MAP_PARAMETERS):
            energy_gradient[i] += through[i]
    g_zero = _energy(q, side, a, powers, root, across)
    for i in range(MAP_PARAMETERS):
        time_gradient[i] /= 2 * np.pi
        energy_gradient[i] *= 0.5 * a * a
    energy_gradient[A0] += a * g_zero
    return time / (2 * np.pi)


@kernel
def half_swing_map(
    q: Floats, index: Ints, weight: Floats, cos: Floats, log_cos: Floats, sin2: Floats, travelled: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Turning points at the given indices; the map is applied to every half-cycle between them.

    Parameters
    ----------
    q
        The seven fields of `ScaledContact`, then the first amplitude in units of the reference.
    index
        Rising half-cycle numbers, the first 0.
    weight, cos, log_cos, sin2, travelled
        Quadrature nodes (see `quadrature.QuarterNodes`).

    Returns
    -------
    amplitude, time
        In units of the reference and of T0; NaN after the pendulum has stopped, or the map cannot go on.
    amplitude_gradient, time_gradient
        Shape ``(len(index), MAP_PARAMETERS)``, derivatives by q.
    """
    count = len(index)
    amplitude = np.full(count, np.nan)
    time = np.full(count, np.nan)
    amplitude_gradient = np.full((count, MAP_PARAMETERS), np.nan)
    time_gradient = np.full((count, MAP_PARAMETERS), np.nan)
    n, p = q[N], q[P]
    if n <= -1.5 or p <= -0.9:
        return amplitude, time, amplitude_gradient, time_gradient
    # functions of theta and the exponents only, the same for all half-cycles; expm1 keeps the digits of 1 -
    # cos^n near the turning point
    constant = np.empty((7, NODES))
    across = np.empty(NODES)
    for k in range(NODES):
        e1, e2, e3 = (n + 2) * log_cos[k], (n + 3) * log_cos[k], (p + 1) * log_cos[k]
        constant[0, k] = -np.expm1(e1) / sin2[k]
        constant[1, k] = -np.expm1(e2) / sin2[k]
        constant[2, k] = -np.expm1(e3) / sin2[k]
        constant[3, k] = 1 / (1 + cos[k])
        constant[4, k] = -log_cos[k] * np.exp(e1) / sin2[k]
        constant[5, k] = -log_cos[k] * np.exp(e2) / sin2[k]
        constant[6, k] = -log_cos[k] * np.exp(e3) / sin2[k]
        across[k] = weight[k] * sin2[k]
    by_node = np.empty((NODES, NODES))
    for k in range(NODES):
        for j in range(NODES):
            by_node[j, k] = travelled[k, j]
    at_zero = np.zeros((7, 1))
    at_zero[:4] = 1.0

    g, root, powers = np.empty(NODES), np.empty(NODES), np.empty(3)
    work_leave, work_arrive = np.zeros(NODES), np.zeros(NODES)
    time_leave, time_arrive = np.empty(MAP_PARAMETERS), np.empty(MAP_PARAMETERS)
    energy_leave, energy_arrive = np.empty(MAP_PARAMETERS), np.empty(MAP_PARAMETERS)
    a_gradient, t_gradient = np.zeros(MAP_PARAMETERS), np.zeros(MAP_PARAMETERS)
    a_gradient[A0] = 1.0
    a, t, ratio, following_ratio = q[A0], 0.0, 1.0, 1.0
    if not a > 0:
        return amplitude, time, amplitude_gradient, time_gradient
    wanted = 0
    step = 0
    while True:
        if index[wanted] == step:
            amplitude[wanted] = a
            time[wanted] = t
            # one by one, as above
            for k in range(MAP_PARAMETERS):
                amplitude_gradient[wanted, k] = a_gradient[k]
                time_gradient[wanted, k] = t_gradient[k]
            wanted += 1
            if wanted == count:
                return amplitude, time, amplitude_gradient, time_gradient
        _powers(q, a, powers)
        if not _shape(q, -1.0, a, powers, constant, by_node, g, root, work_leave):
            return amplitude, time, amplitude_gradient, time_gradient
        energy = 0.5 * a * a * _energy(q, -1.0, a, powers, root, across)
        if not energy > 0:
            return amplitude, time, amplitude_gradient, time_gradient
        t_leave = _quarter(
            q, -1.0, a, powers, weight, across, constant, at_zero, travelled, by_node, g, root,
            time_leave, energy_leave,
        )  # fmt: skip
        # solve E_arrive(A') = E_leave(A) for A' by Newton's method, started from the last two ratios
        following = a * following_ratio
        found = False
        for _ in range(60):
            _powers(q, following, powers)
            if q[DRAG] != 0 and not _shape(
                q, 1.0, following, powers, constant, by_node, g, root, work_arrive
            ):
                following *= 1.1
                continue
            g_zero = _energy(q, 1.0, following, powers, root, across)
            # dE/dA without the small change of the drag's integral: the convergence is quadratic without
            # drag, and linear with a small factor (drag times nonlinearity) with it
            slope = following * (
                g_zero
                + 0.5
                * (
                    -np.pi * q[KAPPA] * n * powers[_TO_N] / (n + 2)
                    + 2 * q[KAPPA] * q[RHO] * (n + 1) * following * powers[_TO_N] / (n + 3)
                    + 2 * q[B] * (p - 1) * powers[_TO_P1] / (p + 1)
                    - 2 * q[C] / following
                )
            )
            correction = (0.5 * following * following * g_zero - energy) / slope
            if not abs(correction) < 0.9 * following:
                correction = 0.5 * following if correction > 0 else -0.5 * following
            following -= correction
            if abs(correction) < 4e-15 * following:
                found = True
                break
        if not (found and following < 2 * a):
            return amplitude, time, amplitude_gradient, time_gradient
        # with a drag the shape is that of the last step, which hardly moved
        if q[DRAG] == 0 and not _shape(q, 1.0, following, powers, constant, by_node, g, root, work_arrive):
            return amplitude, time, amplitude_gradient, time_gradient
        t_arrive = _quarter(
            q, 1.0, following, powers, weight, across, constant, at_zero, travelled, by_node, g, root,
            time_arrive, energy_arrive,
        )  # fmt: skip
        # Chain rule. From E_arrive(A', q) = E_leave(A, q):
        #     dA'/dq = [dE_leave/dq - dE_arrive/dq + (dE_leave/dA) dA/dq] / (dE_arrive/dA')
        # A0 is no explicit parameter of a quarter; its entry holds the derivative by the quarter's amplitude.
        before = a_gradient.copy()
        for i in range(MAP_PARAMETERS):
            direct = 0.0 if i == A0 else energy_leave[i] - energy_arrive[i]
            a_gradient[i] = (direct + energy_leave[A0] * before[i]) / energy_arrive[A0]
            explicit = 0.0 if i == A0 else time_leave[i] + time_arrive[i]
            t_gradient[i] += explicit + time_leave[A0] * before[i] + time_arrive[A0] * a_gradient[i]
        following_ratio = (following / a) ** 2 / ratio
        ratio = following / a
        a = following
        t += t_leave + t_arrive
        step += 1
