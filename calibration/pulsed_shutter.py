"""Row time of a rolling shutter from the brightness of a spot that is lit by pulses timed to the exposures.

A row that opens after a pulse has begun, or closes before it ends, sees a part of it only. With a pulse as
long as the exposure each row loses what passes before it opens: the spot grows darker from row to row.
"""

from dataclasses import dataclass

import numpy as np

from calibration.shutter import path_across_rows_px
from processing.arrays import Floats
from processing.errors import DataError

_U_RESPONSE = 0.01
"""How much the sensor's response and the light may differ from one end of the spot's path to the other."""
_STEPS = 24
"""Into how many parts the row time at which the rows take a whole exposure is divided for a first look."""
_PARTS = 12
"""Into how many parts the path is divided to show what the fit leaves over."""
_LEAST_RAMP = 0.03
"""Smallest part of the light that has to be missing at one end; less could be dust."""


@dataclass(frozen=True, slots=True)
class PulsedShutterFit:
    """Row time found with pulses. It is negative if the bottom row is the first.

    `u_row_time_s` includes a response of the sensor that varies by one per cent along the path. `ramp` is the
    part of the light that the last row on the path misses compared with the first one, `scatter` the relative
    standard deviation of the brightness about the fit, `path_px` how many rows the spot crosses. Of parts of
    the path `rows_px` are the middles, `off` how much brighter than the fit the spot was there, relative, and
    `u_off` its standard uncertainty from the scatter.
    """

    row_time_s: float
    u_row_time_s: float
    path_px: float
    ramp: float
    scatter: float
    rows_px: tuple[float, ...]
    off: tuple[float, ...]
    u_off: tuple[float, ...]


def fit_row_time_of_pulses(
    times_s: Floats,
    y_px: Floats,
    light: Floats,
    rows: int,
    exposure_s: float,
    pulse_s: float,
    delay_s: float = 0.0,
) -> PulsedShutterFit:
    """Row time from the brightness of a spot that swings across the rows, lit by one pulse in each exposure.

    Parameters
    ----------
    times_s, y_px, light : (n,)
        Times of the frames, row of the spot, and its light in any unit; rows with NaN are left out.
    rows
        Rows of the image.
    exposure_s, pulse_s, delay_s
        Exposure of each row, length of the pulse, and its beginning after that of the first row's exposure.

    Raises
    ------
    DataError
        The spot moves over fewer than 20 rows, or the brightness does not depend on the row.
    """
    from scipy.optimize import minimize_scalar

    good = np.isfinite(y_px) & np.isfinite(light)
    times_s, y_px, light = times_s[good], y_px[good], light[good]
    path_px = path_across_rows_px(y_px)
    since = (times_s - times_s.mean()) / max(float(np.ptp(times_s)), 1e-9)
    drift = np.column_stack([np.ones_like(since), since, since**2])

    def seen(row_time_s: float) -> Floats:
        opens_s = row_time_s * (y_px if row_time_s >= 0 else y_px - (rows - 1))
        ends_s = np.minimum(delay_s + pulse_s, opens_s + exposure_s)
        part: Floats = np.maximum(ends_s - np.maximum(delay_s, opens_s), 0.0) / pulse_s
        return part

    def fitted(row_time_s: float) -> Floats:
        design = drift * seen(row_time_s)[:, None]
        values, *_ = np.linalg.lstsq(design, light, rcond=None)
        return np.asarray(design @ values, dtype=np.float64)

    def misfit(row_time_s: float) -> float:
        return float(np.mean((light - fitted(row_time_s)) ** 2))

    step_s = max(exposure_s, delay_s + pulse_s) / rows / _STEPS
    nearest_s = step_s * min(np.arange(-2 * _STEPS, 2 * _STEPS + 1), key=lambda step: misfit(step_s * step))
    best = minimize_scalar(
        misfit,
        bounds=(nearest_s - step_s, nearest_s + step_s),
        method="bounded",
        options={"xatol": 1e-6 * step_s},
    )
    row_time_s, least = float(best.x), float(best.fun)
    part = seen(row_time_s)
    ramp = 1.0 - float(part.min() / part.max())
    if ramp < _LEAST_RAMP:
        raise DataError(
            f"row time: the spot is equally bright in all rows (to {100 * ramp:.2g} %): the shutter is "
            "global, or the pulse lies where all rows are exposed; set laser.pulse_us to the exposure, "
            "laser.pulse_delay_us to 0"
        )
    near_s = 1e-3 * abs(row_time_s)
    curvature = (misfit(row_time_s + near_s) + misfit(row_time_s - near_s) - 2.0 * least) / near_s**2
    u_scatter_s = float(np.sqrt(2.0 * least / (len(light) * curvature)))
    rows_px, off, u_off = _along_path(y_px, light - fitted(row_time_s), float(np.mean(light)))
    return PulsedShutterFit(
        row_time_s=row_time_s,
        u_row_time_s=float(np.hypot(u_scatter_s, _U_RESPONSE * abs(row_time_s) / ramp)),
        path_px=path_px,
        ramp=ramp,
        scatter=float(np.sqrt(least)) / float(np.mean(light)),
        rows_px=rows_px,
        off=off,
        u_off=u_off,
    )


def _along_path(
    y_px: Floats, off: Floats, whole: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Means of `off` over `whole` in equal parts of the path, with their standard uncertainties."""
    edges = np.linspace(y_px.min(), y_px.max(), _PARTS + 1)
    part = np.clip(np.searchsorted(edges, y_px, side="right") - 1, 0, _PARTS - 1)
    rows = []
    for number, middle_px in enumerate(0.5 * (edges[:-1] + edges[1:])):
        inside = off[part == number] / whole
        if len(inside) > 1:
            u_mean = inside.std(ddof=1) / len(inside) ** 0.5
            rows.append((float(middle_px), float(inside.mean()), float(u_mean)))
    middles_px, means, u_means = zip(*rows, strict=True)
    return middles_px, means, u_means
