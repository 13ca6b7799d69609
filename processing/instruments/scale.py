"""What the uncertainty of the angular scale does to a quantity reduced from turning points."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints

Found = TypeVar("Found", bound=NamedTuple)


def with_scale(reduce: Callable[[TurningPoints], Found], points: TurningPoints, u_relative: float) -> Found:
    """Reduce, with the scale's uncertainty in every estimate.

    One error of the scale is common to all amplitudes of a record, so that it hides in no scatter: the
    reduction is made again with all amplitudes larger by one relative standard uncertainty, and the
    change of each estimate is added in quadrature (JCGM 100, 5.1.3, note 2).

    Parameters
    ----------
    reduce
        Gives a named tuple; fields that are `Estimate` (or None in both) are widened, others kept.
    u_relative
        Relative standard uncertainty of the scale; 0 where none is stated.

    Raises
    ------
    DataError
        What `reduce` raises for the points as they are. Where only the enlarged amplitudes fall short of
        something, amplitudes made smaller by as much are tried, and then the estimates stay as they are.
    """
    found = reduce(points)
    if not u_relative > 0:
        return found
    for factor in (1 + u_relative, 1 - u_relative):
        try:
            shifted = reduce(
                replace(
                    points,
                    amplitude=points.amplitude * factor,
                    u_amplitude=points.u_amplitude * factor,
                )
            )
        except DataError:
            continue
        widened = [_widened(a, b) for a, b in zip(found, shifted, strict=True)]
        return found._replace(**dict(zip(found._fields, widened, strict=True)))
    return found


def _widened(value: object, shifted: object) -> object:
    if isinstance(value, Estimate) and isinstance(shifted, Estimate):
        change = shifted.value - value.value
        return Estimate(value.value, math.hypot(value.standard_uncertainty, change))
    return value
