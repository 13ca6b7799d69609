"""Stated forms in which a parameter of the contact may depend on what a run was measured under."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import log
from typing import Final

import numpy as np
from scipy.special import ndtr

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.errors import DataError

FRICTION: Final = "friction"
"""Of an effect on b and c alike, which also shows within each run (`CompressedRun.by_growth`)."""
ORDER: Final = "order"
"""The covariate that every run has: its place in the campaign, from 0."""
_MOVES: Final = {FRICTION: ("b", "c")}


class Form(StrEnum):
    """How a parameter depends on a covariate x."""

    LINEAR = "linear"
    """Slope times (x - reference)."""
    LOGARITHM = "logarithm"
    """Slope times ln(x / reference): ageing of contacts."""
    STEP = "step"
    """One value below the reference, another from there on: a cleaning."""
    DURING = "during"
    """Friction that grows within every run alike, per second, and is back at its next beginning."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """A parameter that depends on a covariate; several of them add up.

    `reference` is where the effect is nought (`Form.LINEAR`, `Form.LOGARITHM`) or where the step stands.
    `contact` restrains it to one contact; empty: all have it alike.
    """

    parameter: str
    covariate: str
    form: Form
    reference: float = 0.0
    contact: str = ""

    @property
    def label(self) -> str:
        of = f" of {self.contact}" if self.contact else ""
        where = f" at {self.reference:g}" if self.form is Form.STEP else ""
        over = "" if self.form is Form.DURING else f" over {self.covariate}"
        return f"{self.parameter}{of}: {self.form}{over}{where}"

    @property
    def bends_decays(self) -> bool:
        """Whether friction grows within each run by it."""
        in_time = self.form is Form.DURING or self.covariate.endswith("_s")
        return self.parameter == FRICTION and in_time

    def moves(self) -> tuple[str, ...]:
        """The coordinates that it moves."""
        return _MOVES.get(self.parameter, (self.parameter,))

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
        """Derivative of the form by x."""
        if self.form is Form.LINEAR:
            return np.ones_like(x)
        if self.form is Form.LOGARITHM:
            return 1 / x
        return np.ones_like(x) if self.form is Form.DURING else np.zeros_like(x)

    def seen(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """The form with slope 1 of values that are uncertain by `u`, and its own standard uncertainty.

        An uncertain value lies on the far side of a step with a probability: the form is its mean there.
        """
        value = self.value(x)
        if self.form is not Form.STEP:
            return value, np.abs(self.slope(x)) * u
        uncertain = u > 0
        beyond = ndtr((x[uncertain] - self.reference) / u[uncertain])
        value[uncertain] = beyond
        left = np.zeros_like(value)
        left[uncertain] = np.sqrt(beyond * (1 - beyond))
        return value, left

    def span(self, x: Floats) -> float:
        """How far the form moves over the campaign with slope 1."""
        if self.form in (Form.STEP, Form.DURING):
            return 1.0
        low, high = float(np.min(x)), float(np.max(x))
        width = log(high / low) if self.form is Form.LOGARITHM else high - low
        if not width > 0:
            raise DataError(f"{self.label}: {self.covariate} is {low:g} in all runs; there is nothing to see")
        return width


def covariate_of(runs: Sequence[CompressedRun], name: str) -> tuple[Floats, Floats]:
    """A covariate of every run and its standard uncertainty.

    Where it is missing it is as likely to be as in the runs in which it is known: their mean, their scatter.

    Raises
    ------
    DataError
        It is known of fewer than two runs.
    """
    if name == ORDER:
        return np.arange(len(runs), dtype=np.float64), np.zeros(len(runs))
    known = [run.covariates[name].value for run in runs if name in run.covariates]
    if len(known) < 2:
        raise DataError(
            f"{name}: known of {len(known)} of {len(runs)} runs, two are needed: leave the effect out, or "
            "state it"
        )
    usual, spread = float(np.mean(known)), float(np.std(known, ddof=1))
    found = [tuple(run.covariates[name]) if name in run.covariates else (usual, spread) for run in runs]
    x, u = np.array(found, dtype=np.float64).T
    return x, np.where(np.isfinite(u), u, 0.0)
