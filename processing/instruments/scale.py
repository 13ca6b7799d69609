"""Effect of the angular scale's uncertainty on quantities evaluated from turning points."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints

Found = TypeVar("Found", bound=NamedTuple)


def with_scale(
    reduce: Callable[[TurningPoints], Found],
    points: TurningPoints,
    u_relative: float,
    found: Found | None = None,
) -> Found:
    """Evaluate turning points and include the scale's uncertainty in every estimate.

    An error of the scale is common to all amplitudes of a record and does not show in their scatter. The
    evaluation is repeated with all amplitudes larger by one relative standard uncertainty, and the change
    of each estimate is added in quadrature (JCGM 100, 5.1.3, note 2).

    Parameters
    ----------
    reduce
        The evaluation; it returns a named tuple, of which the fields of type `Estimate` (or None in both
        evaluations) are modified and the others kept.
    u_relative
        Relative standard uncertainty of the scale; 0 if none is stated.
    found
        The evaluation of the points as given, if its uncertainties are to be enlarged and not those that
        `reduce` states.

    Raises
    ------
    DataError
        Errors of `reduce` for the points as given. If it fails only for the enlarged amplitudes, it is
        repeated with amplitudes smaller by as much; if that fails too, the estimates are not modified.
    """
    plain = reduce(points)
    found = plain if found is None else found
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
        widened = [_widened(*three) for three in zip(found, plain, shifted, strict=True)]
        return found._replace(**dict(zip(found._fields, widened, strict=True)))
    return found


def _widened(value: object, plain: object, shifted: object) -> object:
    if isinstance(value, Estimate) and isinstance(plain, Estimate) and isinstance(shifted, Estimate):
        return Estimate(value.value, math.hypot(value.standard_uncertainty, shifted.value - plain.value))
    return value
