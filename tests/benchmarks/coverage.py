"""Tables of coverage: how often intervals hold the truth, and errors in units of what was claimed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.fit import FitResult

Floats = NDArray[np.float64]

COVERAGES = (0.6827, 0.95)
"""Of the intervals of a fit."""
TITLES = {
    "one_u": "within 1 u",
    "two_u": "within 2 u",
    "ninety_five": "within 95 %",
    "beyond_3u": "beyond 3 u",
    "rms_pull": "rms error/u",
    "median_pull": "median",
    "rms_to_bound": "rms/bound",
    "series_agree": "series agree",
}


def rms(rows: ArrayLike) -> Floats:
    """Root mean square over the seeds, the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def held(fit: FitResult, names: Sequence[str], truth: Sequence[float] | Floats) -> list[list[bool]]:
    """Whether each parameter's intervals of COVERAGES hold its true value."""
    rows = [[fit.interval(name, share) for share in COVERAGES] for name in names]
    return [[low <= true <= high for low, high in both] for both, true in zip(rows, truth, strict=True)]


def coverage(pulls: ArrayLike, inside: ArrayLike | None = None) -> dict[str, list[float]]:
    """Shares of seeds within 1 u and 95 %, and rms errors in units of u, by parameter.

    `pulls` (seeds, parameters) are errors over u, `inside` (seeds, parameters, 2) what `held` says of the
    intervals; without it they are those of a normal distribution.
    """
    z = np.asarray(pulls, dtype=np.float64)
    if inside is None:
        shares = [np.mean(np.abs(z) < 1.0, axis=0), np.mean(np.abs(z) < 1.96, axis=0)]
    else:
        shares = list(np.mean(np.asarray(inside, dtype=np.float64), axis=0).T)
    return {"one_u": shares[0].tolist(), "ninety_five": shares[1].tolist(), "rms_pull": rms(z).tolist()}


def named(names: Sequence[str], table: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """A table's rows by parameter."""
    return {key: dict(zip(names, values, strict=True)) for key, values in table.items()}


def lines(found: Mapping[str, Any]) -> list[str]:
    """The rows of coverage among what a case found, as text."""
    return [
        f"  {title:12}" + "".join(f" {name} {value:.2f}" for name, value in found[key].items())
        for key, title in TITLES.items()
        if isinstance(found.get(key), dict)
    ]
