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

_FEWEST_DIRECTIONS = 6
"""Fewest directions for a curve: with a line four degrees of freedom are left, which show the scatter."""
_INTERVALS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of intervals of a cubic spline that are tried, after a line and a parabola."""
_DIRECTIONS_PER_TERM = 3
"""Fewest directions per term of the curve."""
_OVERLAP_VARIANCE = 2.0
"""Variance of a mean of directions whose windows overlap by half, relative to independent ones."""
_OUTLIER_U = 4.0
"""Standard uncertainties beyond which a direction counts by its sign alone."""
_ITERATIONS = 3
_BISECTIONS = 40
_FARTHEST_PERIODS = 2.0
"""Distance from the nearest direction, in periods, up to which the plane counts as known."""
_LARGEST_UNKNOWN_PART = 0.05
"""Largest part of the turning points that lie farther off: where there are none, it need not be known."""
_LARGEST_ROTATION_RAD = 0.1
"""Largest rotation in a period, in rad: beyond it the path is curved within a window of two periods."""
_LARGEST_SCATTER_RAD = 0.03
"""Largest scatter about the curve, in rad: amplitudes then have errors of up to 5e-4."""


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
        None if fewer than six balances have a direction.
    """
    known = [
        one
        for one in balances
        if turns_ns[0] <= one.time_ns <= turns_ns[-1]
        and math.isfinite(one.line_angle_rad)
        and 0.0 < one.u_line_angle_rad < math.inf
    ]
    if len(known) < _FEWEST_DIRECTIONS:
        return None
    times_ns = np.array([one.time_ns for one in known], dtype=np.int64)
    # the direction of a line is defined modulo pi
    angle = np.unwrap(np.array([one.line_angle_rad for one in known]), period=math.pi)
    u = np.array([one.u_line_angle_rad for one in known])
    size = np.array(
        [math.hypot(one.amplitude, one.amplitude * math.tan(one.line_angle_rad)) for one in known]
    )
    part = seconds(times_ns - times_ns[0]) / float(seconds(times_ns[-1] - times_ns[0]))
    period_s = float(np.median([one.period_s for one in known]))
    u = _with_motion_across(part, angle, u, size)
    knots, degree = _best_curve(part, angle, u)
    coefficients, covariance, residuals = _fit_curve(_design(part, knots, degree), angle, u)
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
        scatter_rad=float(np.sqrt(np.average((residuals * u) ** 2, weights=size**2))),
        start_ns=int(turns_ns[0]),
        period_s=period_s,
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
    at = square_axes(deflections, oblique_rad)
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    x, u_x = at.x * cosine - at.y * sine, np.hypot(at.u_x * cosine, at.u_y * sine)
    y, u_y = at.y * cosine + at.x * sine, np.hypot(at.u_y * cosine, at.u_x * sine)
    if oblique_rad == 0.0:
        return replace(at, x=x, y=y, u_x=u_x, u_y=u_y)
    tangent = math.tan(oblique_rad)
    return replace(
        at,
        x=x / math.cos(oblique_rad),
        u_x=u_x / math.cos(oblique_rad),
        y=y + tangent * x,
        u_y=np.hypot(u_y, tangent * u_x),
    )


def _with_motion_across(part: Floats, angle: Floats, u: Floats, size: Floats) -> Floats:
    """Uncertainties enlarged by a motion across the line that does not decay, as the ground causes it.

    Its size and the outliers among the directions follow from the scatter about the most flexible curve.
    """
    knots, degree = _candidates(len(angle))[-1]
    design = _design(part, knots, degree)
    dof = len(angle) - design.shape[1]
    enlarged = u
    for _ in range(_ITERATIONS):
        _, _, residuals = _fit_curve(design, angle, enlarged)
        usual = max(1.0, robust_scatter(residuals, middle=0.0))
        outlier_factor = np.maximum(np.abs(residuals) / (_OUTLIER_U * usual), 1.0)
        residuals2 = (residuals * enlarged / outlier_factor) ** 2
        low, high = 0.0, float(np.sum(residuals2 * size**2)) / dof
        if float(np.sum(residuals2 / u**2)) <= dof:
            high = 0.0
        for _ in range(_BISECTIONS if high > 0.0 else 0):
            across2 = 0.5 * (low + high)
            too_little = float(np.sum(residuals2 / (u**2 + across2 / size**2))) > dof
            low, high = (across2, high) if too_little else (low, across2)
        enlarged = outlier_factor * np.sqrt(u**2 + high / size**2)
    return enlarged


def _candidates(count: int) -> list[tuple[Floats, int]]:
    """Knots and degrees of the curves that `count` directions allow, from the stiffest to the most flexible.

    The stiffest is a line and not a constant, so that the uncertainty of the rate counts for the plane.
    """
    found = [(np.repeat([0.0, 1.0], degree + 1), degree) for degree in (1, 2)]
    for intervals in _INTERVALS:
        inner = np.linspace(0.0, 1.0, intervals + 1)[1:-1]
        found.append((np.concatenate([np.zeros(4), inner, np.ones(4)]), 3))
    most = max(count // _DIRECTIONS_PER_TERM, 2)
    return [(knots, degree) for knots, degree in found if len(knots) - degree - 1 <= most]


def _best_curve(part: Floats, angle: Floats, u: Floats) -> tuple[Floats, int]:
    """Knots and degree of the curve chosen by Bayes' criterion; the scatter of the most flexible is noise."""
    candidates = _candidates(len(angle))
    chi2, terms = [], []
    for knots, degree in candidates:
        design = _design(part, knots, degree)
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


def _design(part: Floats, knots: Floats, degree: int) -> Floats:
    """Values (n, terms) of the spline's basis functions, continued beyond the ends as straight lines."""
    from scipy.interpolate import BSpline

    inside = np.clip(part, 0.0, 1.0)
    basis = BSpline(knots, np.eye(len(knots) - degree - 1), degree)
    values = np.asarray(basis(inside), dtype=np.float64)
    beyond = part - inside
    if np.any(beyond != 0.0):
        outside = np.flatnonzero(beyond)
        slopes = np.asarray(basis.derivative()(inside[outside]), dtype=np.float64)
        values[outside] += slopes * beyond[outside, None]
    return values


def _doubt(plane: PlaneOfSwing, times_ns: Ints, turns_ns: Ints) -> str:
    after = np.clip(np.searchsorted(times_ns, turns_ns), 1, len(times_ns) - 1)
    off_ns = np.minimum(np.abs(turns_ns - times_ns[after - 1]), np.abs(turns_ns - times_ns[after]))
    unknown = float(np.mean(seconds(off_ns) > _FARTHEST_PERIODS * plane.period_s))
    if unknown > _LARGEST_UNKNOWN_PART:
        return f"its direction is not known in {100 * unknown:.0f} % of the half-cycles"
    fastest = float(np.max(np.abs(plane.rate_rad_per_s(times_ns)))) * plane.period_s
    if fastest > _LARGEST_ROTATION_RAD:
        return f"it turns by {math.degrees(fastest):.0f} degrees in a period, too fast to be followed"
    if plane.scatter_rad > _LARGEST_SCATTER_RAD:
        return f"its direction scatters by {math.degrees(plane.scatter_rad):.1f} degrees about a smooth curve"
    return ""


_FIRST_BALANCES = 5
"""Number of balances at the beginning that show the transverse motion from the start."""


def balance_of_run(balances: Sequence[Balance], plane: PlaneOfSwing | None) -> Balance | None:
    """Balance of a whole decay; None without balances.

    The transverse motion is that of the first periods, ellipticity and rest position are means, the rotation
    is the fastest one of the `plane`, NaN without it. The other fields are those of the first period.
    """
    if not balances:
        return None
    first = sorted(balances[:_FIRST_BALANCES], key=lambda one: one.transverse_ratio)[
        len(balances[:_FIRST_BALANCES]) // 2
    ]
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
        transverse=first.transverse,
        u_transverse=first.u_transverse,
        transverse_ratio=first.transverse_ratio,
        u_transverse_ratio=first.u_transverse_ratio,
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
    rows = [(getattr(one, name), getattr(one, f"u_{name}")) for one in balances]
    known = np.array([row for row in rows if math.isfinite(row[0]) and 0.0 < row[1] < math.inf])
    if not len(known):
        return math.nan, math.nan
    weights = known[:, 1] ** -2.0
    return float(np.average(known[:, 0], weights=weights)), float(np.sum(weights) ** -0.5)
