"""Plane of swing that turns during a decay, and the deflections along axes that turn with it.

A pendulum on one ball can turn about the vertical. By an angle theta of the turn, the slow mode has the
amplitude A cos(theta) along the original axis Y, and fast mode and rest position get components along Y.
Every two slow periods give a direction of the line on which the spot moves; a smooth curve through these
directions turns the deflections back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from processing.arrays import Floats, Ints
from processing.balance.balance import Balance
from processing.deflections import Deflections
from processing.noise_models import robust_scatter
from processing.units import seconds

_MIN_DIRECTIONS = 6
"""Smallest number of directions of a curve: a line leaves four degrees of freedom to show the scatter."""
_INTERVALS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of intervals of a cubic spline that are tried, after a line and a parabola."""
_MIN_DIRECTIONS_PER_TERM = 3
_OVERLAP_VARIANCE = 2.0
"""Variance of a mean of directions whose windows overlap by half, relative to independent ones."""
_OUTLIER_U = 4.0
"""Standard uncertainties beyond which a direction counts by its sign alone."""
_ITERATIONS = 3
_BISECTIONS = 40
_MAX_DISTANCE_PERIODS = 2.0
"""Distance from the nearest direction, in periods, up to which the plane counts as known."""
_MAX_UNKNOWN_FRACTION = 0.05
"""Largest fraction of the turning points at which the plane is not known."""
_MAX_ROTATION_RAD = 0.1
"""Largest rotation in a period: beyond it the path is curved within a window of two periods."""
_MAX_SCATTER_RAD = 0.03
"""Largest scatter about the curve: amplitudes then have errors of up to 5e-4."""
_START_BALANCES = 5
"""Number of balances at the beginning that show the transverse motion from the start."""


@dataclass(frozen=True)
class PlaneOfSwing:
    """Direction of the slow mode as a function of time: a spline, from Y towards X, in rad."""

    first_ns: int
    """Time of the first direction, where the spline's argument is 0."""
    last_ns: int
    """Time of the last direction, where the argument is 1."""
    knots: Floats
    degree: int
    coefficients: Floats
    """(terms,) coefficients of the spline's basis, in rad."""
    covariance: Floats
    """(terms, terms) covariance of the coefficients."""
    directions: int
    """Number of directions to which the spline is fitted."""
    chi2_per_dof: float
    """Scatter of the directions about the spline, in their uncertainties."""
    scatter_rad: float
    """Rms scatter of the directions about the spline, weighted by the squared amplitudes."""
    start_ns: int
    """Time from which the turn of the plane is counted."""
    period_s: float
    doubt: str = ""
    """Reason why the spline does not describe the plane; empty if it does."""

    def direction_rad(self, times_ns: Ints) -> Floats:
        """Direction at these times (n,); more than a period outside the decay it is constant."""
        return np.asarray(self._basis(times_ns) @ self.coefficients)

    def turned_rad(self, times_ns: Ints) -> Floats:
        """Angle by which the plane has turned since the start, at these times (n,)."""
        return np.asarray(self._since_start(times_ns) @ self.coefficients)

    def u_turned_rad(self, times_ns: Ints) -> Floats:
        """Independent errors (n, terms) of `turned_rad`, each for one standard uncertainty, in rad."""
        return self._errors(self._since_start(times_ns))

    def u_direction_rad(self, times_ns: Ints) -> Floats:
        """Independent errors (n, terms) of `direction_rad`, each for one standard uncertainty, in rad."""
        return self._errors(self._basis(times_ns))

    def rate_rad_per_s(self, times_ns: Ints) -> Floats:
        """Rate of rotation at these times (n,)."""
        # imported here: the import takes a fifth of a second, and a live run does not need it
        from scipy.interpolate import BSpline

        slope = BSpline(self.knots, self.coefficients, self.degree).derivative()
        span_s = float(seconds(self.last_ns - self.first_ns))
        return np.asarray(slope(self._spline_argument(times_ns))) / span_s

    def u_mean_rate(self) -> float:
        """Standard uncertainty of the mean rate of rotation, in rad/s."""
        ends = np.array([self.first_ns, self.last_ns], dtype=np.int64)
        first, last = self._errors(self._basis(ends))
        return float(np.linalg.norm(last - first)) / float(seconds(self.last_ns - self.first_ns))

    def mean_rate(self) -> float:
        """Mean rate of rotation from the first direction to the last, in rad/s."""
        first, last = self.direction_rad(np.array([self.first_ns, self.last_ns], dtype=np.int64))
        return float(last - first) / float(seconds(self.last_ns - self.first_ns))

    def _since_start(self, times_ns: Ints) -> Floats:
        return np.asarray(self._basis(times_ns) - self._basis(np.array([self.start_ns], dtype=np.int64)))

    def _errors(self, basis: Floats) -> Floats:
        values, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(basis @ (vectors * np.sqrt(np.maximum(values, 0.0))))

    def _spline_argument(self, times_ns: Ints) -> Floats:
        """Arguments of the spline at these times; the ends of the decay lie a period outside its range."""
        span_s = float(seconds(self.last_ns - self.first_ns))
        beyond = 1.5 * self.period_s / span_s
        return np.clip(seconds(times_ns - self.first_ns) / span_s, -beyond, 1.0 + beyond)

    def _basis(self, times_ns: Ints) -> Floats:
        return _design(self._spline_argument(times_ns), self.knots, self.degree)


def plane_of_swing(balances: Sequence[Balance], turns_ns: Ints) -> PlaneOfSwing | None:
    """Plane of swing of a decay, from the balances of its periods.

    Parameters
    ----------
    balances
        Balances in order of time. Those outside the decay are left out.
    turns_ns
        Times of the decay's turning points, in order.

    Returns
    -------
    PlaneOfSwing or None
        None if too few balances have a direction.
    """
    known = [
        balance
        for balance in balances
        if turns_ns[0] <= balance.time_ns <= turns_ns[-1]
        and math.isfinite(balance.line_angle_rad)
        and 0.0 < balance.u_line_angle_rad < math.inf
    ]
    if len(known) < _MIN_DIRECTIONS:
        return None
    times_ns = np.array([balance.time_ns for balance in known], dtype=np.int64)
    line_angle, u, amplitude, periods_s = np.array(
        [(b.line_angle_rad, b.u_line_angle_rad, b.amplitude, b.period_s) for b in known]
    ).T
    # the direction of a line is defined modulo pi
    angle = np.unwrap(line_angle, period=math.pi)
    length = np.hypot(amplitude, amplitude * np.tan(line_angle))
    x = seconds(times_ns - times_ns[0]) / float(seconds(times_ns[-1] - times_ns[0]))
    u = _with_motion_across(x, angle, u, length)
    knots, degree = _best_curve(x, angle, u)
    coefficients, covariance, residuals = _fit_curve(_design(x, knots, degree), angle, u)
    dof = len(angle) - len(coefficients)
    chi2_per_dof = float(residuals @ residuals) / dof
    plane = PlaneOfSwing(
        first_ns=int(times_ns[0]),
        last_ns=int(times_ns[-1]),
        knots=knots,
        degree=degree,
        coefficients=coefficients,
        covariance=_OVERLAP_VARIANCE * max(1.0, chi2_per_dof) * covariance,
        directions=len(angle),
        chi2_per_dof=chi2_per_dof,
        scatter_rad=float(np.sqrt(np.average((residuals * u) ** 2, weights=length**2))),
        start_ns=int(turns_ns[0]),
        period_s=float(np.median(periods_s)),
    )
    return replace(plane, doubt=_doubt(plane, times_ns, turns_ns))


def square_axes(deflections: Deflections, oblique_rad: float) -> Deflections:
    """Deflections along two axes at a right angle, of which the second is the slow mode's.

    `oblique_rad` is the angle from slow to fast axis minus a right angle, negated if the latter is mirrored.
    """
    if oblique_rad == 0.0:
        return deflections
    sine, cosine = math.sin(oblique_rad), math.cos(oblique_rad)
    return replace(
        deflections,
        x=cosine * deflections.x,
        u_x=cosine * deflections.u_x,
        y=deflections.y - sine * deflections.x,
        u_y=np.hypot(deflections.u_y, sine * deflections.u_x),
    )


def rotate(deflections: Deflections, angle_rad: Floats, oblique_rad: float = 0.0) -> Deflections:
    """Deflections along axes that have turned from Y towards X by `angle_rad` (n,).

    The axes are made square with `oblique_rad`, turned, and made oblique again by the same angle.
    """
    square = square_axes(deflections, oblique_rad)
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    x, u_x = square.x * cosine - square.y * sine, np.hypot(square.u_x * cosine, square.u_y * sine)
    y, u_y = square.y * cosine + square.x * sine, np.hypot(square.u_y * cosine, square.u_x * sine)
    if oblique_rad == 0.0:
        return replace(square, x=x, y=y, u_x=u_x, u_y=u_y)
    tangent = math.tan(oblique_rad)
    return replace(
        square,
        x=x / math.cos(oblique_rad),
        u_x=u_x / math.cos(oblique_rad),
        y=y + tangent * x,
        u_y=np.hypot(u_y, tangent * u_x),
    )


def _with_motion_across(x: Floats, angle: Floats, u: Floats, length: Floats) -> Floats:
    """Uncertainties enlarged by a motion across the line that does not decay, as the ground causes it, by the
    scatter about the most flexible curve; `x` is the time, 0 at the first direction, 1 at the last."""
    knots, degree = _candidates(len(angle))[-1]
    design = _design(x, knots, degree)
    dof = len(angle) - design.shape[1]
    enlarged = u
    for _ in range(_ITERATIONS):
        _, _, residuals = _fit_curve(design, angle, enlarged)
        scatter = max(1.0, robust_scatter(residuals, middle=0.0))
        outlier_factor = np.maximum(np.abs(residuals) / (_OUTLIER_U * scatter), 1.0)
        residuals2 = (residuals * enlarged / outlier_factor) ** 2
        low, high = 0.0, float(np.sum(residuals2 * length**2)) / dof
        if float(np.sum(residuals2 / u**2)) <= dof:
            high = 0.0
        for _ in range(_BISECTIONS if high > 0.0 else 0):
            across2 = 0.5 * (low + high)
            is_too_small = float(np.sum(residuals2 / (u**2 + across2 / length**2))) > dof
            low, high = (across2, high) if is_too_small else (low, across2)
        enlarged = outlier_factor * np.sqrt(u**2 + high / length**2)
    return enlarged


def _candidates(count: int) -> list[tuple[Floats, int]]:
    """Knots and degrees of the curves that `count` directions allow, from the stiffest to the most flexible.
    A line and not a constant is the stiffest: the rate's uncertainty counts for the plane."""
    curves = [(np.repeat([0.0, 1.0], degree + 1), degree) for degree in (1, 2)]
    for intervals in _INTERVALS:
        inner = np.linspace(0.0, 1.0, intervals + 1)[1:-1]
        curves.append((np.concatenate([np.zeros(4), inner, np.ones(4)]), 3))
    max_terms = max(count // _MIN_DIRECTIONS_PER_TERM, 2)
    return [(knots, degree) for knots, degree in curves if len(knots) - degree - 1 <= max_terms]


def _best_curve(x: Floats, angle: Floats, u: Floats) -> tuple[Floats, int]:
    """Knots and degree of the curve chosen by Bayes' criterion; the scatter of the most flexible is noise."""
    candidates = _candidates(len(angle))
    chi2, terms = [], []
    for knots, degree in candidates:
        design = _design(x, knots, degree)
        _, _, residuals = _fit_curve(design, angle, u)
        chi2.append(float(residuals @ residuals))
        terms.append(design.shape[1])
    noise2 = max(1.0, chi2[-1] / (len(angle) - terms[-1]))
    independent = len(angle) / _OVERLAP_VARIANCE
    criterion = [
        value / (_OVERLAP_VARIANCE * noise2) + count * math.log(independent)
        for value, count in zip(chi2, terms, strict=True)
    ]
    return candidates[int(np.argmin(criterion))]


def _fit_curve(design: Floats, angle: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Weighted least-squares fit: coefficients, their covariance, and residuals in uncertainties."""
    design = design / u[:, None]
    directions, singular_values, right = np.linalg.svd(design, full_matrices=False)
    inverse = np.where(
        singular_values > 1e-10 * singular_values[0], 1.0 / np.maximum(singular_values, 1e-300), 0.0
    )
    coefficients = right.T @ (inverse * (directions.T @ (angle / u)))
    covariance = (right.T * inverse**2) @ right
    return coefficients, covariance, angle / u - design @ coefficients


def _design(x: Floats, knots: Floats, degree: int) -> Floats:
    """Values (n, terms) of the spline's basis functions, continued beyond the ends as straight lines."""
    from scipy.interpolate import BSpline

    inside = np.clip(x, 0.0, 1.0)
    basis = BSpline(knots, np.eye(len(knots) - degree - 1), degree)
    values = np.asarray(basis(inside), dtype=np.float64)
    outside = np.flatnonzero(x - inside)
    if len(outside):
        slopes = np.asarray(basis.derivative()(inside[outside]), dtype=np.float64)
        values[outside] += slopes * (x - inside)[outside, None]
    return values


def _doubt(plane: PlaneOfSwing, times_ns: Ints, turns_ns: Ints) -> str:
    following = np.clip(np.searchsorted(times_ns, turns_ns), 1, len(times_ns) - 1)
    distance_ns = np.minimum(
        np.abs(turns_ns - times_ns[following - 1]), np.abs(turns_ns - times_ns[following])
    )
    unknown = float(np.mean(seconds(distance_ns) > _MAX_DISTANCE_PERIODS * plane.period_s))
    if unknown > _MAX_UNKNOWN_FRACTION:
        return f"its direction is not known in {100 * unknown:.0f} % of the half-cycles"
    rotation_rad = float(np.max(np.abs(plane.rate_rad_per_s(times_ns)))) * plane.period_s
    if rotation_rad > _MAX_ROTATION_RAD:
        return f"it turns by {math.degrees(rotation_rad):.0f} degrees in a period, too fast to be followed"
    if plane.scatter_rad > _MAX_SCATTER_RAD:
        return f"its direction scatters by {math.degrees(plane.scatter_rad):.1f} degrees about a smooth curve"
    return ""


def balance_of_run(balances: Sequence[Balance], plane: PlaneOfSwing | None) -> Balance | None:
    """Balance of a whole decay; None without balances.

    The transverse motion is the median of the first periods, ellipticity and rest position are means, the
    rotation is the fastest one of the `plane`, NaN without it. Other fields are those of the first period.
    """
    if not balances:
        return None
    start_balances = sorted(balances[:_START_BALANCES], key=lambda balance: balance.transverse_ratio)
    median = start_balances[len(start_balances) // 2]
    width_ratio, u_width_ratio = _mean(balances, "width_ratio")
    rest_x, u_rest_x = _mean(balances, "rest_x")
    rest_y, u_rest_y = _mean(balances, "rest_y")
    rotation, u_rotation = math.nan, math.nan
    if plane is not None:
        times_ns = np.linspace(plane.first_ns, plane.last_ns, plane.directions).astype(np.int64)
        rates = plane.rate_rad_per_s(times_ns)
        rotation, u_rotation = float(rates[int(np.argmax(np.abs(rates)))]), plane.u_mean_rate()
    return replace(
        balances[0],
        transverse=median.transverse,
        u_transverse=median.u_transverse,
        transverse_ratio=median.transverse_ratio,
        u_transverse_ratio=median.u_transverse_ratio,
        width_ratio=width_ratio,
        u_width_ratio=u_width_ratio,
        rest_x=rest_x,
        u_rest_x=u_rest_x,
        rest_y=rest_y,
        u_rest_y=u_rest_y,
        rotation_rad_per_s=rotation,
        u_rotation_rad_per_s=u_rotation,
    )


def _mean(balances: Sequence[Balance], name: str) -> tuple[float, float]:
    """Weighted mean of a quantity and its standard uncertainty; NaN if no period determines it."""
    rows = [(getattr(balance, name), getattr(balance, f"u_{name}")) for balance in balances]
    known = np.array([row for row in rows if math.isfinite(row[0]) and 0.0 < row[1] < math.inf])
    if not len(known):
        return math.nan, math.nan
    weights = known[:, 1] ** -2.0
    return float(np.average(known[:, 0], weights=weights)), float(np.sum(weights) ** -0.5)
