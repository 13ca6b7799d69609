"""Positions against time, of a table or a film, in one unit."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

ANGLES: Final = ("rad", "mrad", "urad", "nrad", "arcsec", "arcmin", "deg")
NOT_STATED: Final = "unit"
"""Stands for the unit of positions where none is stated."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Time in integer ns from the first sample, positions in the user's unit.

    `scale_rad` is the unit in rad, None where the unit is no angle (volts, px, mm): decay and
    period can then be had, contact parameters not. `time_unit` is that of the table's times, which nothing
    stated if `time_is_assumed`, `time_name` their column, `first_ns` the first of them as it stands there.
    `understood` says in lines what the file was taken for, and which rows were left out. `u_common_in_noises`
    is the standard uncertainty of an error that all amplitudes share, as a multiple of the noise of one
    position. `run` is the name of the run, where the file holds several. `remedy` is what to say where there
    is no decay.
    """

    times_ns: NDArray[np.int64]
    positions: tuple[NDArray[np.float64], ...]
    names: tuple[str, ...]
    unit: str
    scale_rad: float | None
    time_unit: str = "s"
    time_name: str = ""
    time_is_assumed: bool = False
    understood: tuple[str, ...] = ()
    first_ns: int = 0
    u_common_in_noises: float = 0.0
    remedy: str = ""
    run: str = ""
