"""Second measurement of the turning points from the samples, with the waveform known from a fit.

The swing detector knows the waveform only from the half-cycles before. Its errors of friction and stiffness,
largest at the beginning, shift many turning times in common, each by a fraction of its uncertainty; a fit
does not average such shifts out. A fit to the whole decay determines the waveform better. After a second
measurement with this waveform the errors of the turning points are independent.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from processing.arrays import Ints
from processing.contact import ContactParameters, PendulumOnBall, scaled_contact
from processing.deflections import Deflections
from processing.errors import DataError
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact_result import FEWEST_HALF_CYCLES
from processing.fit.knocks import fit_with_knocks
from processing.fit.result import FitResult
from processing.least_squares import Loss
from processing.position_map import PositionMap
from processing.swing import (
    HalfCycle,
    HalfCycleFlag,
    KnownMotion,
    PieceHarmonics,
    TurningPoints,
    half_cycles_of_blocks,
    turning_points,
    with_learned_weights,
)
from processing.units import seconds

_REST_HALF_CYCLES = 6
"""Half-cycles on either side of a knock whose rest positions are compared."""
_MAX_LATE = 3
"""Most half-cycles by which a knock is dated late, where those before it were disturbed, too."""
_MAX_REST_SHARE = 0.01
"""Largest step of the rest position, as a share of the last amplitude, that a fit across it takes: friction
of the deflection itself changes the losses by its square."""
_MAX_COVERED_SHARE = 0.05
"""Largest such step behind which a decay is fitted: beyond, the second measurement may be refused, and its
enlarged uncertainties hide that turning times alternate."""
_MIN_REFINED_SHARE = 0.95
"""Share of the half-cycles that the second measurement must find."""


def known_motion(
    parameters: ContactParameters, pendulum: PendulumOnBall, reference_rad: float, clock: float = 1.0
) -> KnownMotion:
    """Frequency and waveform of the half-swing for contact parameters and deflections in rad.

    Parameters
    ----------
    reference_rad
        Reference amplitude of the waveform, anywhere within the decay.
    clock
        True seconds (the unit of the parameters) per second of the samples' clock.

    Raises
    ------
    DataError
        The pendulum would not swing at the reference amplitude, or a parameter is NaN.

    Notes
    -----
    Eq. 4 with Eqs. 1 and 3 and a drag, ``x = phi/reference`` and the terms of `scaled_contact`, is
    ``x'' = w0^2 (-x + kappa x (pi/2 |x|^n - rho |x|^(n+1)) - sign(x') (c + b |x|^p) - drag x'/w0)``. The
    waveform counts its frequency from the stiffness at the reference and its powers from 1 there.
    """
    contact = scaled_contact(parameters, pendulum, reference_rad)
    softening, hardening = 0.5 * math.pi * contact.kappa, contact.kappa * contact.rho
    stiffness = 1.0 - softening + hardening
    if not stiffness > 0.0:
        raise DataError(f"adhesion takes all of the stiffness at {reference_rad:.3g} rad: there is no swing")
    rate = 2.0 * math.pi / parameters.period0_s * math.sqrt(stiffness)
    of_n = contact.n * softening / stiffness
    of_next = -(1.0 + contact.n) * hardening / stiffness
    return KnownMotion(
        rate_rad_per_s=rate * clock,
        reference=reference_rad,
        damping=0.5 * contact.drag / math.sqrt(stiffness),
        dry=(contact.c + contact.b) / stiffness,
        rise=contact.p * contact.b / stiffness,
        p=contact.p,
        stiff=of_n + of_next,
        n=contact.n,
        bend=of_next + (of_n + of_next) * contact.n,
    )


def second_measurement(
    swings: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    motion: KnownMotion,
) -> list[HalfCycle]:
    """Second measurement of half-cycles from their samples, with a known waveform.

    Parameters
    ----------
    swings
        Half-cycles from the detector, in order. Flagged ones are returned unchanged; one that the second
        measurement does not find, or finds disturbed, is flagged.
    blocks
        The deflections in rad in which they were detected, along the slow axis, in order and in pieces of
        any length, so that they need not be in memory together.

    Returns
    -------
    The half-cycles, the first ones with uncertainties from the noise that the later ones show.
    """
    found = half_cycles_of_blocks(blocks, motion)
    found_ns = np.array([swing.turn_time_ns for swing in found], dtype=np.int64)
    near_ns = 0.25e9 * math.pi / motion.rate_rad_per_s
    again: list[HalfCycle] = []
    for swing in swings:
        if swing.flags == 0:
            twin = _nearest(found, found_ns, swing.turn_time_ns)
            if twin is None or abs(twin.turn_time_ns - swing.turn_time_ns) > near_ns:
                swing = replace(swing, flags=int(HalfCycleFlag.GAP))
            else:
                swing = replace(twin, index=swing.index).since(again[-1] if again else None)
        again.append(swing)
    return with_learned_weights(again)


def _nearest(swings: Sequence[HalfCycle], times_ns: Ints, time_ns: int) -> HalfCycle | None:
    if not len(times_ns):
        return None
    after = min(int(np.searchsorted(times_ns, time_ns)), len(times_ns) - 1)
    before = max(after - 1, 0)
    nearer = before if time_ns - times_ns[before] < times_ns[after] - time_ns else after
    return swings[nearer]


class MeasurementShift(NamedTuple):
    """Shift of a second measurement from the first: rms over half-cycles, in standard uncertainties.

    `time` is without the shift that all share, which only moves the start of the motion. `found` is the share
    of the half-cycles that the second measurement found. Both rms are NaN where it found none.
    """

    found: float
    time: float
    amplitude: float

    @property
    def complete(self) -> bool:
        return self.found >= _MIN_REFINED_SHARE


def measurement_shift(swings: Sequence[HalfCycle], again: Sequence[HalfCycle]) -> MeasurementShift:
    """The shift of the unflagged half-cycles.

    It is normally 0.1 to 0.5. With few or noisy samples in a half-cycle the first measurement, which knows
    the waveform only from earlier half-cycles, is off by more; the second may be right all the same.
    """
    pairs = [(a, b) for a, b in zip(swings, again, strict=True) if a.flags == 0]
    both = [(a, b) for a, b in pairs if b.flags == 0]
    if not both:
        return MeasurementShift(0.0, math.nan, math.nan)
    later_s = [seconds(b.turn_time_ns - a.turn_time_ns) for a, b in both]
    shared_s = float(np.median(later_s))
    time = [(later - shared_s) / a.u_turn_time_s for later, (a, _) in zip(later_s, both, strict=True)]
    amplitude = [(b.amplitude - a.amplitude) / a.u_amplitude for a, b in both]
    return MeasurementShift(
        len(both) / len(pairs), *(math.sqrt(float(np.mean(np.square(found)))) for found in (time, amplitude))
    )


def describes_as_well(second: FitResult, first: FitResult) -> bool:
    """Whether the law describes a second measurement as well as the first, by the likelihood of both.

    A wrong waveform shifts turning points in a way that the law does not follow. Errors that half-cycles of
    the first measurement share make its likelihood look better by chance; four standard deviations of chi2
    are allowed for that.
    """
    assert first.ground is not None
    assert second.ground is not None
    allowed = 4.0 * math.sqrt(2.0 * first.dof)
    return second.ground.deviance <= first.ground.deviance + allowed


def with_enlarged_u(swings: Sequence[HalfCycle], shift: MeasurementShift) -> list[HalfCycle]:
    """Half-cycles whose second measurement was refused, with uncertainties enlarged by its difference."""
    time, amplitude = (math.hypot(1.0, part) if part == part else 1.0 for part in shift[1:])
    return [
        replace(
            swing,
            u_turn_time_s=swing.u_turn_time_s * time,
            u_half_period_s=swing.u_half_period_s * time,
            u_amplitude=swing.u_amplitude * amplitude,
        )
        for swing in swings
    ]


def points_in_true_time(swings: Sequence[HalfCycle], clock_rate: float) -> TurningPoints:
    """Turning points of unflagged half-cycles in true time; `clock_rate` is true seconds per clock second."""
    found = turning_points(swings)
    return replace(found, time_s=found.time_s * clock_rate, u_time_s=found.u_time_s * clock_rate)


def up_to_rest_step(swings: Sequence[HalfCycle], knocks: Sequence[int]) -> tuple[Sequence[HalfCycle], str]:
    """Half-cycles, flagged from the first knock on that moved the rest position, and a line on that.

    Friction and elasticity are those of the angle from the middle of the contact, where the pendulum then
    rests no more. Those before it are flagged where they are too few for a fit, and fewer, and the step is
    small: what the place of rest changes is then in the uncertainties. The line is empty where no knock moved
    the rest position.
    """
    flag, lines = int(HalfCycleFlag.REST_MOVED), list[str]()
    for knock, late in product(knocks, range(_MAX_LATE + 1)):
        good, first = [swing for swing in swings if not swing.flags], knock - late
        before, after = ([one for one in good if (one.index >= first) is later] for later in (False, True))
        if not before or not after:
            continue
        centre_before = [swing.centre for swing in before[-_REST_HALF_CYCLES:]]
        centre_after = [swing.centre for swing in after[:_REST_HALF_CYCLES]]
        share = abs(float(np.median(centre_after) - np.median(centre_before))) / good[-1].amplitude
        apart = max(centre_before) < min(centre_after) or max(centre_after) < min(centre_before)
        if not apart or share <= _MAX_REST_SHARE:
            continue
        few = len(before) < min(FEWEST_HALF_CYCLES, len(after)) and share <= _MAX_COVERED_SHARE
        swings = [
            replace(swing, flags=swing.flags | flag) if (swing.index < first) is few else swing
            for swing in swings
        ]
        left_out = (
            "before it are left out, which are too few for a fit; those after it are fitted, though the "
            "pendulum may rest"
            if few
            else "from there on are left out, since the pendulum rests"
        )
        lines.append(
            f"at half-cycle {first} a knock moved the rest position by {100 * share:.2g} % of the last "
            f"amplitude: the half-cycles {left_out} beside the middle of its contact"
        )
        if not few:
            break
    return swings, "; ".join(lines)


class DecayFit(NamedTuple):
    """The exact fit of half-cycles, with its settings."""

    pendulum: PendulumOnBall
    clock_rate: float = 1.0
    drag: bool = True
    evidence: Evidence = NO_EVIDENCE
    loss: Loss = "linear"

    def points(self, swings: Sequence[HalfCycle]) -> TurningPoints:
        """Turning points of the unflagged half-cycles, in true time."""
        return points_in_true_time(swings, self.clock_rate)

    def of(self, swings: Sequence[HalfCycle], near: FitResult | None = None) -> FitResult:
        """The exact fit of half-cycles."""
        return fit_with_knocks(
            self.points(swings),
            self.pendulum,
            drag=self.drag,
            evidence=self.evidence,
            loss=self.loss,
            near=near,
        )

    def motion(self, fit: FitResult, swings: Sequence[HalfCycle]) -> KnownMotion:
        """The motion by a fit of half-cycles, its reference amplitude their first one."""
        reference_rad = next(swing.amplitude for swing in swings if not swing.flags)
        return known_motion(fit.parameters, self.pendulum, reference_rad, self.clock_rate)


class Refinement(NamedTuple):
    """Outcome of a second measurement: the half-cycles to use, and the motion that gave their waveform.

    `motion` is None where they stay as detected, with the reason in `doubt`; `exact` is the fit to the
    half-cycles of an accepted second measurement. `position_map` are the fixed-pattern position errors that
    were taken off the deflections before it, None where none were; the uncertainties of `exact` then contain
    the remaining errors. `harmonics` are those of the swing, None where they were not measured.
    """

    swings: Sequence[HalfCycle]
    motion: KnownMotion | None
    exact: FitResult | None = None
    doubt: str = ""
    position_map: PositionMap | None = None
    harmonics: PieceHarmonics | None = None


def judge_refinement(
    swings: Sequence[HalfCycle],
    again: Sequence[HalfCycle],
    motion: KnownMotion,
    first: FitResult,
    fit: DecayFit,
) -> Refinement:
    """The second measurement `again` if the laws describe it as well as the first `swings`.

    Both may begin with earlier half-cycles, which are fitted with them and not measured a second time.
    """
    shift = measurement_shift(swings, again)
    reason = f"only {100 * shift.found:.0f} % of the half-cycles were found again"
    if shift.complete:
        try:
            second = fit.of(again, first)
            if describes_as_well(second, first):
                return Refinement(again, motion, second)
            reason = "the laws would describe them worse"
        except DataError as error:
            reason = str(error)
    doubt = (
        f"the turning points stand as detected ({reason}): measured again on the fitted motion they would "
        f"move by {shift.time:.2g} standard uncertainties in time and {shift.amplitude:.2g} in amplitude; "
        "the uncertainties allow for it"
    )
    return Refinement(with_enlarged_u(swings, shift), None, None, doubt)


def fitted_twice(
    swings: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    fit: DecayFit,
    near: FitResult | None = None,
    before: Sequence[HalfCycle] = (),
) -> tuple[Refinement, FitResult]:
    """Half-cycles fitted as detected, measured a second time with that fit's waveform, and fitted again.

    Parameters
    ----------
    blocks
        The deflections in rad in which they were detected.
    near
        A fit of fewer of them.
    before
        Earlier half-cycles, which are fitted with `swings` and not measured a second time.

    Returns
    -------
    All half-cycles as they stand, and their fit.

    Raises
    ------
    DataError
        They cannot be fitted.
    """
    weighted = with_learned_weights([*before, *swings])
    first = fit.of(weighted, near)
    every, moved = up_to_rest_step(weighted, first.evidence.knocks)
    if moved:
        first = fit.of(every)
    try:
        motion = fit.motion(first, every)
    except DataError:
        return Refinement(every, None, doubt=moved), first
    again = second_measurement(every[len(before) :], blocks, motion)
    found = judge_refinement(every, [*every[: len(before)], *again], motion, first, fit)
    found = found._replace(doubt="; ".join(filter(None, [moved, found.doubt])))
    return found, found.exact or fit.of(found.swings, first)
