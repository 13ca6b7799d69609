"""What a campaign takes of one run: its likelihood, compressed, and what it was measured under."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.estimate import Estimate


class Side(StrEnum):
    """Which limit a censored value has."""

    UPPER = "upper"
    LOWER = "lower"


class Bound(NamedTuple):
    """A value of which a run says only where it ends: softly, over `softness`, in coordinates."""

    limit: float
    side: Side
    softness: float


@dataclass(frozen=True, kw_only=True)
class CompressedRun:
    """One run as a campaign sees it, in coordinates of `processing.campaign.coordinates`.

    Attributes
    ----------
    label, contact
        The run's name, and that of the contact whose values it measures.
    names, values, covariance
        Maximum of the likelihood and the inverse of its curvature, by the run's own data alone.
    shared
        Change of the values for one standard uncertainty of an input that runs have in common, by its name.
        It is no part of `covariance`.
    asymmetry
        By name, (upper - lower)/(upper + lower) of the half-widths of the profile's interval; 0 for a
        parabola.
    bounds
        Values that the run only bounds, by name; they are none of `names`.
    covariates
        What the run was measured under; a standard uncertainty is counted. One that is missing is not there.
    by_growth
        Change of the values for a relative growth of the friction over the run by 1; None: not known.
    duration_s
        From the first turning point to the last.
    """

    label: str
    contact: str
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    shared: Mapping[str, Floats] = field(default_factory=dict)
    asymmetry: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, Bound] = field(default_factory=dict)
    covariates: Mapping[str, Estimate] = field(default_factory=dict)
    by_growth: Floats | None = None
    duration_s: float = 0.0

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
