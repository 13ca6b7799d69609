"""Fit of the spot in a frame, started from the position expected from the previous frames.

The fit of a clean spot is tried first because it is the fastest; the general fit (second spot, saturation) is
used where the spot needs it.
"""

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.clean_fit import TILT_EVIDENCE, fit_clean, moved
from processing.spot.fit_values import (
    AMPLITUDE,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    Fitted,
    Place,
    as_kind,
    nothing_hidden,
    workspace_of,
)
from processing.spot.general_fit import fit_general
from processing.spot.memory import LAST, TILT_HINTS, TILTED, TWO, expect
from processing.spot.outcome import Result, finish, significant, without_spot
from processing.spot.sensor_model import PixelNoise, pixel_noise_of
from processing.spot.spot import Image

SEARCH = -1
"""Returned in place of the flags if the spot was not found at the expected position."""


@kernel
def follow(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    memory: Floats,
    work_array: Floats,
    tables: Singles,
    noise_values: Floats,
) -> Result:
    """Fit the spot of one frame, starting from the spot of the previous frame.

    Parameters
    ----------
    image : (ny, nx)
        A frame or a window cut out of it.
    origin_x, origin_y, sensor_nx, sensor_ny
        Fields of `Place`.
    memory
        The tracker's state (see `memory`); updated.
    work_array
        Working memory of shape WORKSPACE_SHAPE.
    tables : (TABLE_ROWS, LARGEST_TABLE)
        Working memory of the upright fit.
    noise_values
        Fields of `PixelNoise`.

    Returns
    -------
    Result
        Fields of a `Spot`. If the spot is not at the expected position, the flags are `SEARCH`, every other
        field is NaN and it has to be searched for.
    """
    place = Place(origin_x, origin_y, sensor_nx, sensor_ny)
    work = workspace_of(work_array)
    noise = pixel_noise_of(noise_values)
    expect(memory, place, work.parameters)
    tilted = memory[TILTED] > 0.0
    two = memory[TWO] > 0.0
    if not two:
        clean = fit_clean(image, work, False, tilted, noise, tables)
        one = clean.fitted
        if one.done:
            # A tilt must be significant in three frames in a row before the spot is treated as tilted: the
            # fit with one parameter more takes longer.
            memory[TILT_HINTS] = memory[TILT_HINTS] + 1.0 if abs(clean.tilt) > TILT_EVIDENCE else 0.0
            tilted = tilted or memory[TILT_HINTS] >= 3.0
            return finish(
                image, place, memory, work, noise, as_kind(one, one.size, tilted, False), followed=True
            )
        if clean.far:
            return without_spot(SEARCH)
        # the failed fit has changed the parameters: restore the start values
        expect(memory, place, work.parameters)
    if moved(image, work.parameters, noise):
        return without_spot(SEARCH)
    fitted = fit_general(image, work, tilted, two, noise, REACH, nothing_hidden())
    if not fitted.done or not _plausible(work.parameters, memory, noise, fitted):
        return without_spot(SEARCH)
    return finish(image, place, memory, work, noise, fitted, followed=True)


@kernel
def _plausible(p: Floats, memory: Floats, noise: PixelNoise, fitted: Fitted) -> bool:
    """Whether the fitted spot resembles that of the previous frame; if not, the whole frame is searched.

    Size within a factor of two, amplitude above 5 % of the previous one, and significant against the noise.
    Otherwise the fit may have followed a reflection or a hot pixel instead of the laser spot.
    """
    ratio_x = p[SIGMA_X] / memory[LAST + SIGMA_X]
    ratio_y = p[SIGMA_Y] / memory[LAST + SIGMA_Y]
    return (
        significant(p, noise, fitted)
        and 0.5 < ratio_x < 2.0
        and 0.5 < ratio_y < 2.0
        and p[AMPLITUDE] > 0.05 * memory[LAST + AMPLITUDE]
    )
