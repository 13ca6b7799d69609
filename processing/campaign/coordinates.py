"""Coordinates in which a decay's likelihood is nearly a parabola: logarithms, b, gamma at one amplitude."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Floats

POSITIVE: Final = ("b", "c", "gamma_pa")
"""Parameters of which the coordinate is the logarithm: changes of it are relative changes."""
EXPONENT_OF: Final[Mapping[str, tuple[str, float]]] = {"b": ("p", -1.0), "gamma_pa": ("n", 0.0)}
"""Their units hold an exponent: ln b + (p - 1) ln A and ln gamma + n ln A are nearly independent of it."""
USUAL_SIZE: Final[Mapping[str, float]] = {
    "b": 0.2, "p": 0.02, "c": 0.5, "n": 0.1, "period0_s": 0.01, "gamma_pa": 0.2, "drag_s": 5e-4,
}  # fmt: skip
"""By how much a parameter may be thought to change over a campaign, in its coordinate."""


class Coordinates(NamedTuple):
    """Values in coordinates, and their derivatives by the parameters."""

    values: Floats
    by_parameters: Floats


_LARGEST_EXPONENT = 200.0
"""Of what is not determined at all."""


def to_coordinates(names: Sequence[str], values: Floats, reference_rad: float) -> Coordinates:
    """Parameters in coordinates at the campaign's reference amplitude; positive ones must be above 0."""
    found, slopes = values.astype(np.float64), np.eye(len(names))
    for place, name in enumerate(names):
        if name in POSITIVE:
            found[place], slopes[place, place] = np.log(values[place]), 1 / values[place]
        exponent, less = EXPONENT_OF.get(name, ("", 0.0))
        if exponent in names:
            other = list(names).index(exponent)
            found[place] += (values[other] + less) * np.log(reference_rad)
            slopes[place, other] = np.log(reference_rad)
    return Coordinates(found, slopes)


def parameters(names: Sequence[str], found: Floats, reference_rad: float) -> Floats:
    """The parameters of coordinates, along the last axis."""
    values = np.array(found, dtype=np.float64)
    for place, name in enumerate(names):
        exponent, less = EXPONENT_OF.get(name, ("", 0.0))
        if exponent in names:
            other = list(names).index(exponent)
            values[..., place] -= (found[..., other] + less) * np.log(reference_rad)
        if name in POSITIVE:
            values[..., place] = np.exp(np.minimum(values[..., place], _LARGEST_EXPONENT))
    return values
