"""The compressed likelihood of a run, for a series, and the effects of covariates on runs.

Coordinates are those in which a decay's likelihood is nearly a parabola: logarithms, with b and gamma at one
amplitude.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf, log
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError

POSITIVE: Final = ("b", "c", "gamma_pa")
"""Parameters of which the coordinate is the logarithm: changes of it are relative changes."""
EXPONENT_OF: Final[Mapping[str, tuple[str, float]]] = {"b": ("p", 1.0), "gamma_pa": ("n", 0.0)}
"""Parameters whose unit contains an exponent, with this exponent and the number that is subtracted from it:
ln b + (p - 1) ln A and ln gamma + n ln A are nearly independent of it."""
FRICTION: Final = "friction"
"""Parameter of an effect on b and c alike, which also shows within each run (`CompressedRun.by_growth`)."""
ORDER: Final = "order"
"""The covariate that every run has: its number in the series, from 0; runs that are left out count, too."""
_MAX_LOGARITHM = 200.0
"""Largest logarithm that is converted: that of a parameter which is not determined may overflow."""


def to_coordinates(names: Sequence[str], values: Floats, reference_rad: float) -> tuple[Floats, Floats]:
    """Coordinates (k,) of parameters at the reference amplitude, and their derivatives (k, k) by the
    parameters; those of `POSITIVE` must be above 0."""
    by_exponents, shift = _by_exponents(names, reference_rad)
    positive = np.isin(names, POSITIVE)
    own = np.log(values, where=positive, out=values.astype(np.float64))
    slopes = np.diag(1 / np.where(positive, values, 1.0)) + by_exponents
    return own + by_exponents @ own - shift, slopes


def parameters(names: Sequence[str], coordinates: Floats, reference_rad: float) -> Floats:
    """The parameters by their coordinates, along the last axis."""
    by_exponents, shift = _by_exponents(names, reference_rad)
    own = coordinates - coordinates @ by_exponents.T + shift
    positive = np.isin(names, POSITIVE)
    return np.asarray(np.exp(np.minimum(own, _MAX_LOGARITHM), where=positive, out=own))


def at_own_exponent(names: Sequence[str], reference_rad: float) -> Floats:
    """Derivatives (k, k) of the parameters, of the logarithms of those of `POSITIVE`, by the coordinates."""
    return np.eye(len(names)) - _by_exponents(names, reference_rad)[0]


def _by_exponents(names: Sequence[str], reference_rad: float) -> tuple[Floats, Floats]:
    """Derivatives (k, k) of the coordinates by exponents of others, and what is subtracted (k,)."""
    by_exponents, shift = np.zeros((len(names), len(names))), np.zeros(len(names))
    for place, name in enumerate(names):
        exponent, offset = EXPONENT_OF.get(name, ("", 0.0))
        if exponent in names:
            by_exponents[place, list(names).index(exponent)] = log(reference_rad)
            shift[place] = offset * log(reference_rad)
    return by_exponents, shift


class EndSide(StrEnum):
    """Side on which a censored value is bounded."""

    UPPER = "upper"
    LOWER = "lower"


class Bound(NamedTuple):
    """A value that a run only bounds, in coordinates."""

    limit: float
    side: EndSide
    softness: float
    """Standard deviation of the limit."""


@dataclass(frozen=True, kw_only=True)
class CompressedRun:
    """The likelihood of one run, in coordinates, with its covariates."""

    label: str
    contact: str
    names: tuple[str, ...]
    values: Floats
    """Maximum of the likelihood by the run's own data alone."""
    covariance: Floats
    """Inverse of its curvature there."""
    shared: Mapping[str, Floats] = field(default_factory=dict)
    """Changes of the values by one standard uncertainty of an input that runs have in common, by its name.
    They are no part of `covariance`."""
    bounds: Mapping[str, Bound] = field(default_factory=dict)
    """Values that the run only bounds, by name; they are none of `names`."""
    covariates: Mapping[str, float] = field(default_factory=dict)
    """Conditions of the run by name; unknown ones are left out."""
    by_growth: Floats | None = None
    """Changes of the values by a relative growth of the friction over the run by 1; None: not known."""
    duration_s: float = 0.0
    """Time from the first turning point to the last."""

    def __post_init__(self) -> None:
        size = len(self.names)
        if self.values.shape != (size,) or self.covariance.shape != (size, size):
            raise DataError(f"{self.label}: {size} names, values {self.values.shape}: they must agree")
        finite = np.all(np.isfinite(self.values)) and np.all(np.isfinite(self.covariance))
        if not finite or (size and np.linalg.eigvalsh(self.covariance)[0] <= 0):
            raise DataError(
                f"{self.label}: its likelihood has no finite width in {', '.join(self.names)}; leave out "
                "what it does not determine"
            )

    def u(self, name: str) -> float:
        """Standard uncertainty of a coordinate by the run alone; infinite where it has none."""
        if name not in self.names:
            return inf
        place = self.names.index(name)
        return float(np.sqrt(self.covariance[place, place]))


class Form(StrEnum):
    """Form of a parameter's dependence on a covariate x."""

    LINEAR = "linear"
    """Slope times (x - reference)."""
    LOGARITHM = "logarithm"
    """Slope times ln(x / reference): ageing of contacts."""
    STEP = "step"
    """One value below the reference, another from there on: a cleaning."""
    DURING = "during"
    """Friction that grows within every run alike, per second, and begins the next run as it was."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """A parameter that depends on a covariate; several effects add up."""

    parameter: str
    covariate: str
    form: Form
    reference: float = 0.0
    """Covariate at which the effect is zero (`Form.LINEAR`, `Form.LOGARITHM`) or steps."""
    contact: str = ""
    """Contact to which the effect is restricted; empty for all contacts."""

    @property
    def label(self) -> str:
        contact = f" of {self.contact}" if self.contact else ""
        reference = f" at {self.reference:g}" if self.form is Form.STEP else ""
        covariate = "" if self.form is Form.DURING else f" over {self.covariate}"
        return f"{self.parameter}{contact}: {self.form}{covariate}{reference}"

    @property
    def bends_decays(self) -> bool:
        """Whether the effect makes friction grow within each run."""
        is_in_time = self.form is Form.DURING or self.covariate.endswith("_s")
        return self.parameter == FRICTION and is_in_time

    def moves(self) -> tuple[str, ...]:
        """The coordinates that the effect moves."""
        return ("b", "c") if self.parameter == FRICTION else (self.parameter,)

    def value(self, x: Floats) -> Floats:
        """The form with slope 1."""
        if self.form is Form.LINEAR:
            return x - self.reference
        if self.form is Form.STEP:
            return np.asarray(x >= self.reference, dtype=np.float64)
        if self.form is Form.DURING:
            return np.zeros_like(x)
        if not self.reference > 0 or not np.all(x > 0):
            raise DataError(
                f"{self.label}: a logarithm needs {self.covariate} and its reference above 0, got "
                f"{float(np.min(x)):g} and {self.reference:g}"
            )
        return np.log(x / self.reference)

    def slope(self, x: Floats) -> Floats:
        """Derivative of the form with respect to x."""
        if self.form is Form.LOGARITHM:
            return 1 / x
        return np.zeros_like(x) if self.form is Form.STEP else np.ones_like(x)

    def expected(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """The form with slope 1 for values x that are uncertain by `u`, and its standard uncertainty.

        An uncertain value lies beyond a step with a probability, which is then the mean of the form.
        """
        from scipy.special import ndtr

        value = self.value(x)
        if self.form is not Form.STEP:
            return value, np.abs(self.slope(x)) * u
        uncertain = u > 0
        value[uncertain] = ndtr((x[uncertain] - self.reference) / u[uncertain])
        return value, np.sqrt(value * (1 - value))

    def span(self, runs: Sequence[CompressedRun]) -> float:
        """Range of the form with slope 1 over the series; raises DataError where it is zero."""
        if self.form is Form.DURING:
            duration_s = max(run.duration_s for run in runs)
            if not duration_s > 0:
                raise DataError(f"{self.label}: the duration of no run is known; leave the effect out")
            return duration_s
        if self.form is Form.STEP:
            return 1.0
        x, _ = covariate_of(runs, self.covariate)
        if self.covariate != ORDER:
            x = _measured(runs, self.covariate)
        low, high = float(np.min(x)), float(np.max(x))
        width = log(high / low) if self.form is Form.LOGARITHM else high - low
        if not width > 0:
            raise DataError(f"{self.label}: {self.covariate} is {low:g} in all runs; there is nothing to see")
        return width


def only_bound(runs: Sequence[CompressedRun], contact: str, name: str) -> EndSide | None:
    """The side on which runs bound a contact's coordinate that none of them determines; else None."""
    own = [run for run in runs if run.contact == contact]
    sides = {run.bounds[name].side for run in own if name in run.bounds}
    return sides.pop() if len(sides) == 1 and not any(name in run.names for run in own) else None


def covariate_of(runs: Sequence[CompressedRun], name: str) -> tuple[Floats, Floats]:
    """A covariate of every run and its standard uncertainty.

    Where a value is missing, it is the mean of the others, with their scatter as its uncertainty. Raises
    DataError where it is known of fewer than two runs.
    """
    if name == ORDER:
        numbers = [run.covariates.get(ORDER, number) for number, run in enumerate(runs)]
        return np.array(numbers, dtype=np.float64), np.zeros(len(runs))
    known = _measured(runs, name)
    if len(known) < 2:
        raise DataError(
            f"{name}: known of {len(known)} of {len(runs)} runs, two are needed: leave the effect out, or "
            "state it"
        )
    x = np.array([run.covariates.get(name, known.mean()) for run in runs])
    return x, np.array([0.0 if name in run.covariates else known.std(ddof=1) for run in runs])


def _measured(runs: Sequence[CompressedRun], name: str) -> Floats:
    """Values of a covariate where it is known."""
    return np.array([run.covariates[name] for run in runs if name in run.covariates])
