"""What the tracker remembers from one frame to the next."""

import numpy as np
from numba import njit

from processing.spot.fit_values import (
    PARAMETERS,
    SECOND_X,
    SECOND_Y,
    Fitted,
    Floats,
    Place,
    X,
    Y,
)

FOLLOWS = 0
"""1.0 while a spot is followed. The other entries are not read before a search has set them."""
LAST = 1
"""First of the PARAMETERS of the last frame's spot, positions in sensor coordinates."""
STEP_X, STEP_Y = LAST + PARAMETERS, LAST + PARAMETERS + 1
"""How far the spot moved from the last frame but one to the last, px."""
TILTED, TWO = LAST + PARAMETERS + 2, LAST + PARAMETERS + 3
"""1.0 where the last spot was fitted as tilted, or with a second one."""
TILT_HINTS = LAST + PARAMETERS + 4
"""Frames in a row in which an upright fit gave evidence of a tilt."""
_SIZE = LAST + PARAMETERS + 5


def empty_memory() -> Floats:
    """Memory that knows of no spot."""
    return np.zeros(_SIZE)


@njit(cache=True, nogil=True, error_model="numpy")
def forget(memory: Floats) -> None:
    """No spot is followed any more."""
    memory[FOLLOWS] = 0.0
    memory[STEP_X] = 0.0
    memory[STEP_Y] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def expect(memory: Floats, place: Place, p: Floats) -> None:
    """Parameters expected in the next image: the last spot, moved by its last step once more."""
    for k in range(PARAMETERS):
        p[k] = memory[LAST + k]
    p[X] += memory[STEP_X] - place.origin_x
    p[Y] += memory[STEP_Y] - place.origin_y
    p[SECOND_X] += memory[STEP_X] - place.origin_x
    p[SECOND_Y] += memory[STEP_Y] - place.origin_y


@njit(cache=True, nogil=True, error_model="numpy")
def remember(memory: Floats, place: Place, p: Floats, fitted: Fitted, followed: bool) -> None:
    """Keep what was fitted. A spot that was searched for has no step: nobody saw it move."""
    x = p[X] + place.origin_x
    y = p[Y] + place.origin_y
    if followed:
        memory[STEP_X] = x - memory[LAST + X]
        memory[STEP_Y] = y - memory[LAST + Y]
    else:
        memory[STEP_X] = 0.0
        memory[STEP_Y] = 0.0
    for k in range(PARAMETERS):
        memory[LAST + k] = p[k]
    memory[LAST + X] = x
    memory[LAST + Y] = y
    memory[LAST + SECOND_X] = p[SECOND_X] + place.origin_x
    memory[LAST + SECOND_Y] = p[SECOND_Y] + place.origin_y
    memory[FOLLOWS] = 1.0
    memory[TILTED] = 1.0 if fitted.tilted else 0.0
    memory[TWO] = 1.0 if fitted.two else 0.0
