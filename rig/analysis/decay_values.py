"""Values of any decay, with or without a law: period, decrement, damping, in the amplitude's own unit."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from math import hypot, isfinite, nan, pi
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from processing.damping import PARTS, DampingTerms, fit_damping
from processing.decay_summary import summarise_decay
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.instruments import Check, MeanOverPlaces
from processing.number_text import with_uncertainty
from processing.quantity import OWN, PART, PER, Quantity
from processing.swing import TurningPoints
from rig.analysis.encoding import Floats
from rig.analysis.result_rows import ResultRow, plain_row

_STORED_AMPLITUDES = 9
"""Number of amplitudes at which the smooth curve of the damping is stored."""
_MIN_NEGATIVE_U, _MIN_NEGATIVE_PROBABILITY = 2.0, 0.95
"""Distance below zero, in standard uncertainties, and probability that the decay needs it, above which a part
is surely negative. Noise alone reaches that probability at some 3.4 standard uncertainties, which also cover
the misfit of all three parts together."""
_NEGATIVE_PARTS: Final = {
    "constant": "no force: the loss grows faster than the amplitude, as that of rolling with an exponent "
    "above 1; or something changes during the decay, or noise lifts the last amplitudes",
    "linear": "no force: something changes during the decay",
    "quadratic": "no force: the loss grows more slowly than the amplitude, as that of rolling with an "
    "exponent below 1; or something changes during the decay",
}
"""Explanations of a part of the damping that is surely negative; the three together fit any smooth loss."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingAt:
    """Time constant and quality factor at an amplitude, in the decay's unit."""

    amplitude: Annotated[float, PART]
    time_constant_s: Estimate = NOT_DETERMINED
    quality_factor: Estimate = NOT_DETERMINED


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeDamping:
    """dA/dt = -(constant + linear A + quadratic A^2) in the amplitude's unit; see `processing.damping`."""

    constant: Annotated[Estimate, Quantity("", "friction", unit=OWN + PER + "s")] = NOT_DETERMINED
    linear: Annotated[Estimate, Quantity("", "viscous damping", unit="1/s")] = NOT_DETERMINED
    quadratic: Annotated[Estimate, Quantity("", "quadratic drag", unit="1/s" + PER + OWN)] = NOT_DETERMINED
    probabilities: tuple[float, ...] = ()
    """Probability of each of the three parts, in this order, that the decay needs it."""
    needed: tuple[str, ...] = ()
    """Parts with a probability of more than 95 %."""
    chi2_per_dof: float = nan
    curve: Annotated[tuple[DampingAt, ...], PART] = ()
    """Damping from the first amplitude to the last."""

    def lines(self, unit: str) -> list[str]:
        """Lines on the parts and on the time constants at both ends; `unit` is that of the amplitude."""
        units = {"constant": f" {unit}/s", "linear": " /s", "quadratic": f" /({unit} s)"}
        lines = []
        for name, probability in zip(PARTS, self.probabilities, strict=True):
            value, u = getattr(self, name)
            part = f"{with_uncertainty(value, u)}{units[name]}"
            lines.append(f"damping, {name} part {part}, needed with probability {probability:.2g}")
            if value < -_MIN_NEGATIVE_U * u and probability > _MIN_NEGATIVE_PROBABILITY:
                lines.append(f"a negative {name} part is {_NEGATIVE_PARTS[name]}")
        for point in (self.curve[0], self.curve[-1]) if self.curve else ():
            tau, quality = with_uncertainty(*point.time_constant_s), with_uncertainty(*point.quality_factor)
            lines.append(f"time constant {tau} s at {point.amplitude:.4g} {unit}, quality factor {quality}")
        return lines


def amplitude_damping(
    damping: DampingTerms, frequency_hz: float, *, u_frequency: float = 0.0
) -> AmplitudeDamping:
    """Parts and curve of a damping; `u_frequency` is the relative u of the frequency at an amplitude."""
    amplitudes = damping.amplitudes(_STORED_AMPLITUDES)
    tau_s, u_tau_s = damping.time_constant_s(amplitudes)
    parts = {name: Estimate(*getattr(damping, name)[:2]) for name in PARTS}
    curve = []
    for amplitude, tau, u in np.stack([amplitudes, tau_s, u_tau_s]).T.tolist():
        if isfinite(tau) and tau > 0:
            quality = Estimate(pi * frequency_hz * tau, pi * frequency_hz * hypot(u, u_frequency * tau))
            tau_estimate = Estimate(tau, u)
            curve.append(DampingAt(amplitude=amplitude, time_constant_s=tau_estimate, quality_factor=quality))
    return AmplitudeDamping(
        **parts,
        probabilities=tuple(float(getattr(damping, name).probability) for name in PARTS),
        needed=damping.needed,
        chi2_per_dof=damping.chi2_per_dof,
        curve=tuple(curve),
    )


class DecayValues(NamedTuple):
    """Period, decrement and quality factor of a decay, and its damping; None for too few half-cycles."""

    mean_period_s: Estimate
    log_decrement: Estimate
    quality_factor: Estimate | None
    damping: AmplitudeDamping | None


DECAY: Final = "decay"
"""Value of `ResultRow.fit` for a row without a law."""


def decay_rows(
    points: TurningPoints, values: DecayValues | None, unit: str, unit_size: float, run: str
) -> tuple[ResultRow, ...]:
    """The rows of period, decrement and quality factor, if known, and of first and last amplitude."""
    estimates = {} if values is None else values._asdict()
    estimates.pop("damping", None)
    rows = [plain_row(name, estimate, run, DECAY) for name, estimate in estimates.items() if estimate]
    ends = points.amplitude[[0, -1]] / unit_size if len(points) else np.full(2, np.nan)
    names = ("initial_amplitude", "final_amplitude")
    rows += [plain_row(name, float(end), run, DECAY, unit) for name, end in zip(names, ends, strict=True)]
    return tuple(rows)


def decay_values(
    points: TurningPoints, unit_size: float, *, u_clock: float = 0.0, u_common: float = 0.0
) -> DecayValues:
    """Period, decrement, damping; amplitudes in a unit that is `unit_size` in that of the points.

    `u_clock` is the relative standard uncertainty of the second of the times. `u_common`, in the unit of the
    points, is that of an error that all half-cycles share: of their amplitudes and, as a lag of the position
    at the turning points, of their times. Raises DataError for too few points.
    """
    values = _decay_values(points, unit_size)
    period_s, u_s = values.mean_period_s
    values = values._replace(mean_period_s=Estimate(period_s, hypot(u_s, u_clock * period_s)))
    if not u_common > 0:
        return values
    lag_s = u_common * period_s / (2.0 * pi * points.amplitude)
    shifted = replace(points, amplitude=points.amplitude + u_common, time_s=points.time_s + lag_s)
    return DecayValues(*map(_with_change, values, _decay_values(shifted, unit_size)))


def _decay_values(points: TurningPoints, unit_size: float) -> DecayValues:
    summary, damping = summarise_decay(points), None
    with suppress(DataError):
        terms = fit_damping(points.time_s, points.amplitude / unit_size, points.u_amplitude / unit_size)
        period = summary.period_s
        damping = amplitude_damping(terms, 1.0 / period.value, u_frequency=period.u / period.value)
    return DecayValues(
        Estimate(summary.period_s.value, summary.period_s.u),
        Estimate(summary.decrement.value, summary.decrement.u),
        summary.quality_factor,
        damping,
    )


def _with_change(value: Any, shifted: Any) -> Any:
    """An estimate, or a structure of estimates, whose u contain the difference from the `shifted` one."""
    if shifted is None:
        return value
    if isinstance(value, Estimate):
        return Estimate(value.value, hypot(value.standard_uncertainty, shifted.value - value.value))
    if isinstance(value, tuple) and len(value) == len(shifted):
        return tuple(map(_with_change, value, shifted))
    if is_dataclass(value) and not isinstance(value, type):
        names = [item.name for item in fields(value)]
        return replace(
            value, **{name: _with_change(getattr(value, name), getattr(shifted, name)) for name in names}
        )
    return value


INSTRUMENT: Final = "instrument"
"""Value of `ResultRow.fit` for a row of another kind of pendulum; a part of the decay may follow a comma."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentResults:
    """One run of another kind of pendulum, whose numbers are rows of the table of results."""

    kind: str
    curves: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    """Arrays of equal length by the name of the curve: `period` are full periods against amplitude, with the
    law of circular error and its first term, `decrement` is the log decrement of a whole swing against
    amplitude, `plane` the direction of the swing plane against time."""
    checks: tuple[Check, ...] = ()
    """Environment and apparatus, compared with the standard."""
    text: tuple[str, ...] = ()
    """Lines on what no number says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentSeries:
    """Comparison of places on a sample with the glass plate or reference sample of the same series."""

    kind: str
    time_s: MeanOverPlaces | None = None
    swings: MeanOverPlaces | None = None
    problem: str | None = None
    reference_time_s: Estimate | None = None
    acceptance: tuple[Check, ...] | None = None
    ratio: Estimate | None = None
    ratio_of_swings: Estimate | None = None
    text: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """The problem, and the lines on what no number says."""
        return [*filter(None, [self.problem]), *self.text]
