"""Free swings of any law by quadrature, their harmonics, and the drag that air is expected to have.

In units of the weight's moment and of 1/w0, ``phi'' = -phi + m`` with the moment m of contact and air. From
the turning point at A downwards ``v^2/2 = (A^2 - phi^2)/2 - W`` with the work W done against m, and the next
turning point is where the kinetic energy vanishes. The substitution ``phi = middle + half cos(theta)``
between both makes ``dt = half sin(theta) dtheta / v``, which has no singularity. W is integrated from the
nearer end, so that v keeps its digits at both. The moment of the air depends on the speed, which is found
with the next turning point by iteration.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from processing.ambient import Air
from processing.arrays import Complexes, Floats
from processing.contact.law import DRAG, Law, PendulumOnBall, weight_moment
from processing.errors import DataError
from processing.kernel import kernel
from processing.swing import PIECE_HALF_CYCLES, HarmonicTerms

BOUNDARY_LAYER_DRAG = "boundary_layer_drag"
"""Key of a drag that grows with the 3/2 power of the speed, in s^1.5: ``-m g R drag |phi'|^0.5 phi'``."""
_NODES = 256
"""Nodes of a half-cycle; with this number the third harmonic is right within 1e-4 of itself."""
_MAX_ITERATIONS, _TOLERANCE = 30, 1e-10
"""Most iterations of the next amplitude and of the air's work, and the relative change of the amplitude at
which they end: each reduces the change by the ratio of moment to weight, mostly below 1 %."""
_AMPLITUDES, _HIGHEST_RATIO = 8, 1.02
"""Number of amplitudes at which a law is computed, and the highest of them over the highest of the data."""
_SAMPLES = 256
"""Samples of a swing of `PIECE_HALF_CYCLES` from which its harmonics are computed."""
_PERIOD_RATIO = 5.0
"""Slow over fast period of the paper's pendulum, and so length over width of its bar."""


@kernel
def _move(
    phi: Floats,
    moment: Floats,
    drag: float,
    boundary_layer: float,
    whole: Floats,
    part: Floats,
    begin: Floats,
    end: Floats,
    speed: Floats,
) -> float:
    """Replace speeds (n, nodes) and last amplitudes `end` (n, 1) of half-swings by what the moments leave;
    return the largest relative change of `end`, infinite where a pendulum is held."""
    work = np.empty(len(whole))
    largest = 0.0
    for i in range(len(phi)):
        half, total = 0.5 * (begin[i, 0] + end[i, 0]), 0.0
        for k in range(len(whole)):
            v = speed[i, k]
            here = half * (moment[i, k] + (drag + boundary_layer * sqrt(v)) * v)
            work[k] = total + here * part[k]
            total += here * whole[k]
        left = begin[i, 0] ** 2 - 2 * total
        if not left > 0:
            return np.inf
        for k in range(len(whole)):
            # from the nearer end
            if 2 * k < len(whole):
                square = (begin[i, 0] - phi[i, k]) * (begin[i, 0] + phi[i, k]) - 2 * work[k]
            else:
                square = (end[i, 0] + phi[i, k]) * (end[i, 0] - phi[i, k]) + 2 * (total - work[k])
            if not square > 0:
                return np.inf
            speed[i, k] = sqrt(square)
        largest = max(largest, abs(sqrt(left) - end[i, 0]) / begin[i, 0])
        end[i, 0] = sqrt(left)
    return largest


class FreeSwing(NamedTuple):
    """Free swings from turning points at n amplitudes, arrays (n, nodes)."""

    phi_rad: Floats
    slope_rad: Floats
    """Derivative of the deflection with respect to the phase."""
    phase: Floats
    """``w0 t`` since the first turning point."""
    end: Floats
    """Phases (n,) at the last turning points."""


def free_swing(
    law: Law, values: Mapping[str, float], pendulum: PendulumOnBall, amplitudes_rad: Floats, half_cycles: int
) -> FreeSwing:
    """Free swings from turning points at positive `amplitudes_rad` (n,) over `half_cycles`.

    `values` are the law's parameters by key in SI units, and optionally ``drag_s`` and `BOUNDARY_LAYER_DRAG`.

    Raises DataError where the pendulum does not reach the last turning point, or its period is not positive.
    """
    if not values["period0_s"] > 0.0:
        raise DataError(f"the period is {values['period0_s']:g} s; it must be positive")
    edge = np.linspace(0.0, np.pi, _NODES + 1)
    theta = 0.5 * (edge[:-1] + edge[1:])
    cell, first_half = -np.diff(np.cos(edge)), np.cos(edge[:-1]) - np.cos(theta)
    cos, sin = np.cos(theta), np.sin(theta)
    weight, rate = weight_moment(pendulum), 2 * np.pi / values["period0_s"]
    drag, boundary_layer = values.get(DRAG.key, 0.0) * rate, values.get(BOUNDARY_LAYER_DRAG, 0.0) * rate**1.5
    a, begins, side = amplitudes_rad[:, None], np.zeros((len(amplitudes_rad), 1)), 1.0
    ratio, relative_speed = np.ones_like(a), sin
    downwards = np.full((len(a), _NODES), -1.0)
    pieces = []
    with np.errstate(all="ignore"):  # values of a law that does not fit may reverse a swing, or overflow
        for _ in range(half_cycles):
            # the last half-cycle is nearly this one
            next_a, speed = a * ratio, a * relative_speed
            for _ in range(_MAX_ITERATIONS):
                half = 0.5 * (a + next_a)
                phi = 0.5 * (a - next_a) + half * cos
                friction, elastic = law.branch_moments(phi, downwards, values, pendulum)
                moment = (friction + elastic) / weight
                change = _move(phi, moment, drag, boundary_layer, cell, first_half, a, next_a, speed)
                if not change < np.inf:
                    raise DataError("friction holds the pendulum before the end of the swing")
                if change < _TOLERANCE:
                    break
            step = (edge[1] - edge[0]) * half * sin / speed
            ends = begins + np.cumsum(step, axis=1)
            pieces.append((side * phi, -side * speed, ends - 0.5 * step))
            ratio, relative_speed = next_a / a, speed / a
            a, begins, side = next_a, ends[:, -1:], -side
        phi, slope, phase = (np.concatenate(arrays, axis=1) for arrays in zip(*pieces, strict=True))
    return FreeSwing(phi, slope, phase, begins[:, 0])


def law_harmonics(
    law: Law, values: Mapping[str, float], pendulum: PendulumOnBall, amplitudes_rad: Floats
) -> Complexes:
    """Harmonics (rad) of `ORDERS`, shape (n, orders), of free swings of amplitudes (n,) in their middle.

    They are fitted with the terms with which `HarmonicsMeasurement` measures pieces of `PIECE_HALF_CYCLES`,
    at a few amplitudes, and interpolated.

    Raises DataError where the pendulum does not swing for so long, or large swings fall below small ones.
    """
    # here, because it would slow down every command
    from scipy.interpolate import CubicSpline

    # swings begin above the amplitude of their middle
    first = np.geomspace(amplitudes_rad.min(), _HIGHEST_RATIO * amplitudes_rad.max(), _AMPLITUDES)
    swing = free_swing(law, values, pendulum, first, PIECE_HALF_CYCLES)
    phases = swing.end[:, None] * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    middle, harmonics = HarmonicTerms.harmonics(_interpolate(swing, phases) @ _projection())
    if not (middle[0] > 0 and np.all(np.diff(middle) > 0)):
        raise DataError("larger swings would end below smaller ones: this is no free decay")
    relative = CubicSpline(np.log(middle), harmonics / middle[:, None])(np.log(amplitudes_rad))
    return np.asarray(relative * amplitudes_rad[:, None], dtype=np.complex128)


def _interpolate(swing: FreeSwing, phases: Floats) -> Floats:
    """Deflections of every swing at its own rising phases (amplitudes, m), by Hermite's cubics: as splines of
    scipy they cost as much as the swings themselves."""
    width = np.diff(swing.phase, axis=1)
    rise = np.diff(swing.phi_rad, axis=1) / width
    begin = swing.slope_rad[:, :-1]
    curvature = (begin + swing.slope_rad[:, 1:] - 2 * rise) / width
    cells = [np.searchsorted(row, x, side="right") for row, x in zip(swing.phase, phases, strict=True)]
    cell = np.clip(np.array(cells) - 1, 0, width.shape[1] - 1)

    def in_cell(values: Floats) -> Floats:
        return np.take_along_axis(values, cell, axis=1)

    d = phases - in_cell(swing.phase)
    cubic, square = in_cell(curvature / width), in_cell((rise - begin) / width - curvature)
    deflections = ((cubic * d + square) * d + in_cell(begin)) * d + in_cell(swing.phi_rad)
    return np.asarray(deflections, dtype=np.float64)


@lru_cache(maxsize=1)
def _projection() -> Floats:
    x = 2 * (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 1
    return np.asarray(np.linalg.pinv(HarmonicTerms.evaluate(x)).T, dtype=np.float64)


class UniformBar(NamedTuple):
    """A bar that swings about its middle, across its length."""

    length_m: float
    width_m: float


def bar_of(
    pendulum: PendulumOnBall, period_s: float, length_m: float | None = None, width_m: float | None = None
) -> UniformBar:
    """The pendulum as a uniform bar of stated sizes.

    An unstated length follows from the moment of inertia, ``m L^2/12 = m g R T^2/(4 pi^2)``, an unstated
    width from `_PERIOD_RATIO`.
    """
    inertia = weight_moment(pendulum) * (period_s / (2 * pi)) ** 2
    length = length_m or sqrt(12 * inertia / pendulum.mass_kg)
    return UniformBar(length, width_m or length / _PERIOD_RATIO)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedDrag:
    """Order of magnitude of the air's drag on a bar of the pendulum's size."""

    drag_s: float
    air_density_kg_per_m3: float
    air_viscosity_pa_s: float
    length_m: float
    width_m: float
    assumed: tuple[str, ...] = ()
    """Names of the quantities that were neither measured nor stated: usual air (20 degrees Celsius, 50 %,
    101325 Pa), and a bar that follows from the pendulum's inertia."""


def expected_drag_s(air: Air, bar: UniformBar, pendulum: PendulumOnBall, period_s: float) -> float:
    """The drag (`ContactParameters.drag_s`) of air on a bar."""
    # here, because it would slow down every command
    from scipy.special import kve

    omega, radius = 2 * pi / period_s, 0.5 * bar.width_m
    root = np.sqrt(1j * air.density_kg_per_m3 * omega * radius**2 / air.viscosity_pa_s)
    # the exponential by which kve scales the Bessel functions cancels
    gamma = 1 + 4j * kve(1, -1j * root) / (root * kve(0, -1j * root))
    per_length = pi * air.density_kg_per_m3 * omega * radius**2 * gamma.imag
    return float(per_length * bar.length_m**3 / 12 / weight_moment(pendulum))
