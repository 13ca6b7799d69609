"""Decays whose plane of swing turns: deflections are turned back, with the uncertainty of the angle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calibration import Axes
from processing.arrays import Floats, Ints
from processing.balance import Balance, BalanceEstimator, PlaneOfSwing, plane_of_swing, rotate, square_axes
from processing.decay_summary import mean_period
from processing.deflections import Deflections
from processing.instruments import DEGREE_RAD
from processing.swing import HalfCycle, TurningPoints, half_cycles_of_blocks, turning_points
from processing.units import seconds
from rig.analysis.passing_deflections import ChangedDeflections, PassingDeflections
from rig.terminal import with_uncertainty

_ORTHOGONAL_AXES: Final = Axes()
MAX_NEGLECTED_CHANGE_U: Final = 0.05
"""Largest change of any parameter of a fit, in standard uncertainties, by a rotation that is neglected."""
_FIRST_BALANCES: Final = 10
"""Number of balances at the beginning, where the fast mode is largest."""
_MIN_SAMPLES_PER_PERIOD: Final = 100
"""Fewest samples of a slow period that make its balance, where the period has as many."""
_MIN_BALANCED_FRACTION: Final = 0.9
"""Smallest fraction of a decay's periods with a balance for these balances to be taken over."""
_PER_MIN: Final = 60.0 / DEGREE_RAD


@dataclass(frozen=True)
class FollowedPlane:
    """Half-cycles and deflections of a decay in its plane of swing."""

    half_cycles: Sequence[HalfCycle]
    deflections: PassingDeflections
    balances: Sequence[Balance] = ()
    """Balances of the decay in the original deflections."""
    plane: PlaneOfSwing | None = None
    """The plane of swing; None where the decay shows none, being too short, or along one axis alone."""
    is_turned: bool = False
    """Whether half-cycles and deflections were turned."""
    along_line: bool = False
    """Whether they are turned onto the line of the motion, else by the angle of the plane since the start."""
    axes: Axes = _ORTHOGONAL_AXES
    problem: str = ""
    """The reason why nothing can be fitted; empty if there is none."""

    def amplitude_errors(self, points: TurningPoints) -> Floats | None:
        """Independent errors of the amplitudes (points, terms) by the uncertain plane; None if not turned."""
        if self.plane is None or not self.is_turned:
            return None
        turns_ns = {h.index: h.turn_time_ns for h in self.half_cycles}
        times_ns = np.array([turns_ns.get(int(index), 0) for index in points.index], dtype=np.int64)
        return self._errors(self.plane, times_ns, points.amplitude)

    @property
    def u_rad(self) -> float:
        """Standard uncertainty of the angle by which the last half-cycles were turned."""
        if self.plane is None or not self.is_turned:
            return 0.0
        last = self.plane.u_turned_rad(np.array([self.plane.last_ns], dtype=np.int64))
        return math.hypot(float(np.linalg.norm(last)), self.axes.u_non_orthogonality_rad)

    @property
    def text(self) -> str:
        """Note that the decay was turned back; empty if it was not."""
        if self.plane is None or not self.is_turned:
            return ""
        ends = np.array([self.plane.start_ns, self.plane.last_ns], dtype=np.int64)
        first, last = self.plane.direction_rad(ends) / DEGREE_RAD
        u = float(np.linalg.norm(self.plane.u_turned_rad(ends[1:]))) / DEGREE_RAD
        rate = f"({_rate_text(self.plane)} deg/min in the mean)"
        text = (
            f"the swing lies {first:+.2f} degrees from the direction of all positions at first, and "
            f"{last:+.2f} at last {rate}: amplitudes are those along the swing"
            if self.along_line
            else f"the plane of swing turned by {with_uncertainty(last - first, u, signed=True)} degrees "
            f"during the run {rate}: the deflections were turned back before the fit"
        )
        return text.replace("-", "−")

    def matters(self, plane: PlaneOfSwing) -> bool:
        """Whether the rotation into this plane changes a fit by more than `MAX_NEGLECTED_CHANGE_U`.

        If amplitudes change by e_i, no parameter of a least-squares fit changes by more than
        sqrt(sum (e_i/u_i)^2) of its standard uncertainties.
        """
        unflagged = [h for h in self.half_cycles if not h.flags]
        times_ns = np.array([h.turn_time_ns for h in unflagged], dtype=np.int64)
        amplitude, u = np.array([(h.amplitude, h.u_amplitude) for h in unflagged]).T
        angle = self.angle_rad(plane, times_ns)
        shifts = amplitude * (1.0 - np.cos(angle) + self._motion_across(plane) * np.abs(np.sin(angle)))
        shifts2 = shifts**2 + np.sum(self._errors(plane, times_ns, amplitude) ** 2, axis=1)
        return bool(math.sqrt(float(np.sum(shifts2 / u**2))) > MAX_NEGLECTED_CHANGE_U)

    def angle_rad(self, plane: PlaneOfSwing, times_ns: Ints) -> Floats:
        """Angles (n,) by which deflections in this plane are turned back."""
        return plane.direction_rad(times_ns) if self.along_line else plane.turned_rad(times_ns)

    def _errors(self, plane: PlaneOfSwing, times_ns: Ints, amplitude: Floats) -> Floats:
        """Errors of amplitudes (n, terms), each by one u of the plane's curve or of the axes."""
        # an angle wrong by d takes d^2/2 off an amplitude, and adds d times the motion across it; where the
        # angle between the axes is wrong by e, turning by theta adds e sin(theta) cos(theta)
        u_curve = plane.u_direction_rad(times_ns) if self.along_line else plane.u_turned_rad(times_ns)
        half_u = 0.5 * np.linalg.norm(u_curve, axis=1)
        angle = self.angle_rad(plane, times_ns)
        by_axes = self.axes.u_non_orthogonality_rad * np.sin(angle) * np.cos(angle)
        by_curve = u_curve * np.hypot(self._motion_across(plane), half_u)[:, None]
        return np.asarray(amplitude[:, None] * np.column_stack([by_curve, by_axes[:, None]]))

    def _motion_across(self, plane: PlaneOfSwing) -> float:
        """Motion across the target axis over that along it: by the tilt of the line, and by the fast mode."""
        start = np.array([plane.start_ns], dtype=np.int64)
        tilt = 0.0 if self.along_line else math.remainder(float(plane.direction_rad(start)[0]), math.pi)
        ratios = [balance.transverse_ratio for balance in self.balances if balance.time_ns >= plane.first_ns]
        fast = float(np.median(ratios[:_FIRST_BALANCES])) if ratios else 0.0
        return math.hypot(min(abs(tilt), 1.0), min(fast, 1.0))


def _rate_text(plane: PlaneOfSwing) -> str:
    return with_uncertainty(plane.mean_rate() * _PER_MIN, plane.u_mean_rate() * _PER_MIN, signed=True)


class PlaneBalances:
    """Balances of deflections in blocks, along axes at a right angle, for the plane of swing.

    A balance is made of evenly spaced samples of a period: all samples would hardly reduce its noise.
    """

    def __init__(self, axes: Axes | None, period_s: float) -> None:
        self._oblique_rad = _oblique_rad(axes or _ORTHOGONAL_AXES)
        self._period_s = period_s
        self._estimator = BalanceEstimator()
        self._stride = self._passed = 0

    def of(self, block: Deflections) -> list[Balance]:
        """The balances that are complete with this block, which continues the last one."""
        if not self._stride and len(block) > 1:
            step_s = float(seconds(block.times_ns[-1] - block.times_ns[0])) / (len(block) - 1)
            self._stride = max(1, int(self._period_s / step_s / _MIN_SAMPLES_PER_PERIOD))
        stride = max(self._stride, 1)
        sampled = block[-self._passed % stride :: stride]
        self._passed += len(block)
        return list(self._estimator.update(square_axes(sampled, self._oblique_rad)))


def _oblique_rad(axes: Axes) -> float:
    return -axes.non_orthogonality_rad if axes.mirrored else axes.non_orthogonality_rad


def balances_for_plane(
    balances: Sequence[Balance], half_cycles: Sequence[HalfCycle], axes: Axes | None
) -> Sequence[Balance] | None:
    """The balances that a run made along its axes, as `follow_plane` takes them; None if it cannot.

    The axes have to be at a right angle, and nearly every period of the decay needs a balance: the estimate
    of a run may have failed while its detector went on.
    """
    unflagged = [h for h in half_cycles if not h.flags]
    if len(unflagged) < 2 or _oblique_rad(axes or _ORTHOGONAL_AXES):
        return None
    first, last = unflagged[0], unflagged[-1]
    made = [balance for balance in balances if first.turn_time_ns <= balance.time_ns <= last.turn_time_ns]
    is_whole = 2.0 * len(made) > _MIN_BALANCED_FRACTION * (last.index - first.index) - 2.0
    return made if made and is_whole else None


def follow_plane(
    half_cycles: Sequence[HalfCycle],
    deflections: PassingDeflections,
    axes: Axes | None,
    *,
    along_line: bool = False,
    balances: Sequence[Balance] | None = None,
) -> FollowedPlane:
    """Turn half-cycles and deflections into the plane of swing, where that changes anything.

    Half-cycles are as detected in the deflections, which pass once, or three times if they are turned. `axes`
    are the pendulum's, in which the deflections are; None: they are at a right angle. With `along_line` the
    decay is turned onto the line of the motion itself, else the axes count as calibrated at its beginning.
    `balances` are those of the whole decay along axes at a right angle; None: they are made of the
    deflections. A rotation that does not matter (`FollowedPlane.matters`) is neglected.
    """
    axes = axes or _ORTHOGONAL_AXES
    unflagged = [h for h in half_cycles if not h.flags]
    if len(unflagged) < 2:
        return FollowedPlane(half_cycles, deflections, along_line=along_line, axes=axes)
    if balances is None:
        estimator = PlaneBalances(axes, mean_period(turning_points(unflagged)))
        balances = [balance for block in deflections for balance in estimator.of(block)]
    turns_ns = np.array([h.turn_time_ns for h in unflagged], dtype=np.int64)
    balances = [balance for balance in balances if turns_ns[0] <= balance.time_ns <= turns_ns[-1]]
    plane = plane_of_swing(balances, turns_ns)
    followed = FollowedPlane(half_cycles, deflections, balances, plane, along_line=along_line, axes=axes)
    if plane is None or not followed.matters(plane):
        return followed
    if plane.doubt:
        problem = (
            f"withheld: the plane of swing turns ({_rate_text(plane)} deg/min in the mean) and "
            f"{plane.doubt}, so that amplitudes are not known; let the pendulum settle before the release "
            "(rig balance)"
        )
        return replace(followed, problem=problem.replace("-", "−"))

    def turn_back(block: Deflections) -> Deflections:
        return rotate(block, followed.angle_rad(plane, block.times_ns), _oblique_rad(axes))

    turned = PassingDeflections(ChangedDeflections(deflections, turn_back), deflections.unit)
    return replace(followed, half_cycles=half_cycles_of_blocks(turned), deflections=turned, is_turned=True)
