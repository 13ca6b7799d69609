"""A moment that somebody states as a function, called so that what is wrong in it is said in one line."""

from collections.abc import Callable, Mapping

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.swing import TurningPoints

Moment = Callable[..., Floats]
"""Of |phi| in rad and of parameters by name, over m g R; their defaults are where a fit begins."""


def called(moment: Moment, name: str) -> Moment:
    """A stated moment that gives an array of floats, or DataError with what is wrong in it.

    It has angles of its own: what it writes into them reaches nobody else.
    """

    def result(phi_rad: Floats, **own: float) -> Floats:
        values = ", ".join(f"{key} = {value:.6g}" for key, value in own.items())
        try:
            found = np.asarray(moment(np.array(phi_rad), **own))
        except Exception as error:
            raise DataError(
                f"{name}: raises {type(error).__name__} ({error}) for an array of {phi_rad.size} angles and "
                f"{values}; a law has a value for each of them"
            ) from error
        if found.dtype.kind not in "fiu":
            raise DataError(
                f"{name}: returns {found.dtype} for {values}; one real number for each angle is needed"
            )
        return np.asarray(found, dtype=np.float64)

    return result


def refuse_odd(moment: Moment, start: Mapping[str, float], points: TurningPoints, name: str) -> None:
    """Raise DataError unless a moment has a finite value where a fit begins."""
    probe = np.geomspace(1e-3, 1, 9) * float(points.amplitude.max())
    found = moment(probe, **start)
    if found.shape not in ((), probe.shape) or not np.all(np.isfinite(found)):
        raise DataError(
            f"{name}: returns an array of shape {found.shape} for {len(probe)} angles, with "
            f"{int(np.isfinite(found).sum())} finite numbers; one for each angle is needed"
        )
