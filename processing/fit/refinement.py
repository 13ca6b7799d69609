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

from processing.contact import ContactParameters, PendulumOnBall, scaled_contact
from processing.deflections import Deflections
from processing.errors import DataError
from processing.fit.changes import fit_with_knocks
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact_result import FEWEST_HALF_CYCLES
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
"""Largest step of the rest position, as a share of the last amplitude, across which a decay is fitted: a rest
position beside the middle of the contact changes the losses by the square of this share."""
_MAX_COVERED_SHARE = 0.05
"""Largest step of the rest position, as such a share, after which a decay is fitted. After a larger one the
second measurement may be refused, and its enlarged uncertainties hide that turning times alternate."""
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
    half_cycles: Sequence[HalfCycle], blocks: Iterable[Deflections], motion: KnownMotion
) -> list[HalfCycle]:
    """Second measurement of half-cycles from their samples, with a known waveform.

    Parameters
    ----------
    half_cycles
        Half-cycles from the detector, in order. Flagged ones are returned unchanged; one that the second
        measurement does not find, or finds disturbed, is flagged.
    blocks
        The deflections in rad in which they were detected, along the slow axis, in order. Blocks may have any
        length, so that they need not be in memory together.

    Returns
    -------
    The half-cycles, the first ones with uncertainties from the noise that the later ones show.
    """
    candidates = half_cycles_of_blocks(blocks, motion)
    times_ns = np.array([candidate.turn_time_ns for candidate in candidates], dtype=np.int64)
    near_ns = 0.25e9 * math.pi / motion.rate_rad_per_s
    refined: list[HalfCycle] = []
    for half_cycle in half_cycles:
        if half_cycle.flags == 0:
            off_ns = np.abs(times_ns - half_cycle.turn_time_ns)
            if not np.any(off_ns <= near_ns):
                half_cycle = replace(half_cycle, flags=int(HalfCycleFlag.GAP))
            else:
                same = replace(candidates[int(np.argmin(off_ns))], index=half_cycle.index)
                half_cycle = same.since(refined[-1] if refined else None)
        refined.append(half_cycle)
    return with_learned_weights(refined)


class MeasurementShift(NamedTuple):
    """Shift of a second measurement from the first: rms over half-cycles, in standard uncertainties."""

    share_found: float
    """Share of the half-cycles that the second measurement found."""
    time: float
    """Without the shift that all half-cycles share, which only moves the start of the motion; NaN if none was
    found."""
    amplitude: float
    """NaN if none was found."""

    @property
    def complete(self) -> bool:
        return self.share_found >= _MIN_REFINED_SHARE


def measurement_shift(detected: Sequence[HalfCycle], refined: Sequence[HalfCycle]) -> MeasurementShift:
    """The shift of the unflagged half-cycles.

    It is normally 0.1 to 0.5. With few or noisy samples in a half-cycle the first measurement, which knows
    the waveform only from earlier half-cycles, is off by more; the second may be right all the same.
    """
    pairs = [(a, b) for a, b in zip(detected, refined, strict=True) if a.flags == 0]
    good_pairs = [(a, b) for a, b in pairs if b.flags == 0]
    if not good_pairs:
        return MeasurementShift(0.0, math.nan, math.nan)
    later_s = np.array([seconds(b.turn_time_ns - a.turn_time_ns) for a, b in good_pairs])
    time = (later_s - np.median(later_s)) / [a.u_turn_time_s for a, _ in good_pairs]
    amplitude = np.array([(b.amplitude - a.amplitude) / a.u_amplitude for a, b in good_pairs])
    rms = (math.sqrt(float(np.mean(np.square(shift)))) for shift in (time, amplitude))
    return MeasurementShift(len(good_pairs) / len(pairs), *rms)


def describes_as_well(second: FitResult, first: FitResult) -> bool:
    """Whether the law describes a second measurement as well as the first, by the likelihood of both.

    A wrong waveform shifts turning points in a way that the law does not follow. Errors that half-cycles of
    the first measurement share make its likelihood look better by chance; four standard deviations of chi2
    are allowed for that.
    """
    allowed = 4.0 * math.sqrt(2.0 * first.dof)
    return second.ground_fit.deviance <= first.ground_fit.deviance + allowed


def with_enlarged_u(half_cycles: Sequence[HalfCycle], shift: MeasurementShift) -> list[HalfCycle]:
    """Half-cycles whose second measurement was refused, with uncertainties enlarged by its difference."""
    time, amplitude = (
        1.0 if math.isnan(rms) else math.hypot(1.0, rms) for rms in (shift.time, shift.amplitude)
    )
    return [
        replace(
            half_cycle,
            u_turn_time_s=half_cycle.u_turn_time_s * time,
            u_half_period_s=half_cycle.u_half_period_s * time,
            u_amplitude=half_cycle.u_amplitude * amplitude,
        )
        for half_cycle in half_cycles
    ]


def points_in_true_time(half_cycles: Sequence[HalfCycle], clock_rate: float) -> TurningPoints:
    """Turning points of unflagged half-cycles in true time; `clock_rate` is true seconds per clock second."""
    points = turning_points(half_cycles)
    return replace(points, time_s=points.time_s * clock_rate, u_time_s=points.u_time_s * clock_rate)


def up_to_rest_step(
    half_cycles: Sequence[HalfCycle], knocks: Sequence[int]
) -> tuple[Sequence[HalfCycle], str]:
    """Half-cycles without those at another rest position, and a remark on them.

    Friction and elasticity are those of the angle from the middle of the contact. After a knock that moved
    the rest position, the pendulum no longer rests there: the half-cycles from that knock on are flagged.
    Where the earlier ones are too few for a fit, fewer than the later ones, and the step is small, the
    earlier ones are flagged instead: the uncertainties then hold the effect of the rest position. The remark
    is empty where no knock moved the rest position.
    """
    flag, remarks = int(HalfCycleFlag.REST_MOVED), list[str]()
    for knock, late in product(knocks, range(_MAX_LATE + 1)):
        good, first = [half_cycle for half_cycle in half_cycles if not half_cycle.flags], knock - late
        earlier = [half_cycle for half_cycle in good if half_cycle.index < first]
        later = good[len(earlier) :]
        if not earlier or not later:
            continue
        old_rest = [half_cycle.centre for half_cycle in earlier[-_REST_HALF_CYCLES:]]
        new_rest = [half_cycle.centre for half_cycle in later[:_REST_HALF_CYCLES]]
        share = abs(float(np.median(new_rest) - np.median(old_rest))) / good[-1].amplitude
        apart = max(old_rest) < min(new_rest) or max(new_rest) < min(old_rest)
        if not apart or share <= _MAX_REST_SHARE:
            continue
        few = len(earlier) < min(FEWEST_HALF_CYCLES, len(later)) and share <= _MAX_COVERED_SHARE
        half_cycles = [
            replace(half_cycle, flags=half_cycle.flags | flag)
            if (half_cycle.index < first) is few
            else half_cycle
            for half_cycle in half_cycles
        ]
        left_out = (
            "before it are left out, which are too few for a fit; those after it are fitted, though the "
            "pendulum may rest"
            if few
            else "from there on are left out, since the pendulum rests"
        )
        remarks.append(
            f"at half-cycle {first} a knock moved the rest position by {100 * share:.2g} % of the last "
            f"amplitude: the half-cycles {left_out} beside the middle of its contact"
        )
        if not few:
            break
    return half_cycles, "; ".join(remarks)


class DecayFit(NamedTuple):
    """The exact fit of half-cycles, with its settings."""

    pendulum: PendulumOnBall
    clock_rate: float = 1.0
    drag: bool = True
    evidence: Evidence = NO_EVIDENCE
    loss: Loss = "linear"

    def points(self, half_cycles: Sequence[HalfCycle]) -> TurningPoints:
        """Turning points of the unflagged half-cycles, in true time."""
        return points_in_true_time(half_cycles, self.clock_rate)

    def of(self, half_cycles: Sequence[HalfCycle], near: FitResult | None = None) -> FitResult:
        """The exact fit of half-cycles; `near` is a fit of nearly the same ones."""
        return fit_with_knocks(
            self.points(half_cycles),
            self.pendulum,
            drag=self.drag,
            evidence=self.evidence,
            loss=self.loss,
            near=near,
        )

    def motion(self, fit: FitResult, half_cycles: Sequence[HalfCycle]) -> KnownMotion:
        """The motion by a fit of half-cycles, its reference amplitude their first one."""
        reference_rad = next(half_cycle.amplitude for half_cycle in half_cycles if not half_cycle.flags)
        return known_motion(fit.parameters, self.pendulum, reference_rad, self.clock_rate)


class Refinement(NamedTuple):
    """Outcome of a second measurement."""

    half_cycles: Sequence[HalfCycle]
    """Half-cycles to use."""
    motion: KnownMotion | None
    """Motion that gave their waveform; None where they stay as detected, with the reason in `doubt`."""
    exact: FitResult | None = None
    """Fit to the half-cycles of an accepted second measurement."""
    doubt: str = ""
    position_map: PositionMap | None = None
    """Fixed-pattern position errors that were taken off the deflections before it, None where none were; the
    uncertainties of `exact` contain the remaining errors."""
    harmonics: PieceHarmonics | None = None
    """Harmonics of the swing; None where they were not measured."""


def judge_refinement(
    detected: Sequence[HalfCycle],
    refined: Sequence[HalfCycle],
    motion: KnownMotion,
    first: FitResult,
    fit: DecayFit,
) -> Refinement:
    """The second measurement `refined` if the laws describe it as well as the first, `detected`.

    Both may begin with earlier half-cycles, which are fitted with them and not measured a second time.
    """
    shift = measurement_shift(detected, refined)
    if shift.share_found == 0.0:
        doubt = "the turning points stand as detected (none of the half-cycles was found again)"
        return Refinement(detected, None, None, doubt)
    reason = f"only {100 * shift.share_found:.0f} % of the half-cycles were found again"
    if shift.complete:
        try:
            second = fit.of(refined, first)
            if describes_as_well(second, first):
                return Refinement(refined, motion, second)
            reason = "the laws would describe them worse"
        except DataError as error:
            reason = str(error)
    doubt = (
        f"the turning points stand as detected ({reason}): measured again on the fitted motion they would "
        f"move by {shift.time:.2g} standard uncertainties in time and {shift.amplitude:.2g} in amplitude; "
        "the uncertainties allow for it"
    )
    return Refinement(with_enlarged_u(detected, shift), None, None, doubt)


def fitted_twice(
    half_cycles: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    fit: DecayFit,
    near: FitResult | None = None,
    earlier: Sequence[HalfCycle] = (),
) -> tuple[Refinement, FitResult]:
    """Half-cycles fitted as detected, measured a second time with that fit's waveform, and fitted again.

    Parameters
    ----------
    blocks
        The deflections in rad in which they were detected.
    near
        A fit of fewer of them.
    earlier
        Earlier half-cycles, which are fitted with the others and not measured a second time.
    """
    weighted = with_learned_weights([*earlier, *half_cycles])
    first = fit.of(weighted, near)
    detected, remark = up_to_rest_step(weighted, first.evidence.knocks)
    if remark:
        first = fit.of(detected)
    try:
        motion = fit.motion(first, detected)
    except DataError:
        return Refinement(detected, None, doubt=remark), first
    refined = second_measurement(detected[len(earlier) :], blocks, motion)
    outcome = judge_refinement(detected, [*detected[: len(earlier)], *refined], motion, first, fit)
    outcome = outcome._replace(doubt="; ".join(filter(None, [remark, outcome.doubt])))
    return outcome, outcome.exact or fit.of(outcome.half_cycles, first)
