"""State of the tracker between frames: the last spot, its last displacement, and the kind of fit it needs."""

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import PARAMETERS, SECOND_X, SECOND_Y, Fitted, Place, X, Y

FOLLOWS = 0
"""1.0 while a spot is being followed, else 0.0. A search sets the other entries before they are read."""
LAST = 1
"""Index of the first of the PARAMETERS of the last frame's spot; positions are in sensor coordinates."""
STEP_X, STEP_Y = LAST + PARAMETERS, LAST + PARAMETERS + 1
"""Displacement of the spot between the last two frames, px."""
TILTED, TWO = LAST + PARAMETERS + 2, LAST + PARAMETERS + 3
"""1.0 if the last spot was fitted as tilted, and with a second spot, respectively."""
TILT_HINTS = LAST + PARAMETERS + 4
"""Number of consecutive frames in which the upright fit found a significant tilt."""
ALONE = LAST + PARAMETERS + 5
"""1.0 if a search does not look for a second spot."""
POOR_FRAMES = LAST + PARAMETERS + 6
"""Number of consecutive frames with the flag POOR_FIT."""
_SIZE = LAST + PARAMETERS + 7


def empty_memory() -> Floats:
    """Memory before the first frame."""
    return np.zeros(_SIZE)


@kernel
def forget(memory: Floats) -> None:
    """Stop following: the next frame is searched as a whole."""
    memory[FOLLOWS] = 0.0
    memory[STEP_X] = 0.0
    memory[STEP_Y] = 0.0


@kernel
def expect(memory: Floats, place: Place, p: Floats) -> None:
    """Write the parameters expected in the next image into `p`.

    The last spot is displaced once more by its last displacement. Positions in `p` are relative to the
    image's first pixel.
    """
    for k in range(PARAMETERS):
        p[k] = memory[LAST + k]
    p[X] += memory[STEP_X] - place.origin_x
    p[Y] += memory[STEP_Y] - place.origin_y
    p[SECOND_X] += memory[STEP_X] - place.origin_x
    p[SECOND_Y] += memory[STEP_Y] - place.origin_y


@kernel
def remember(memory: Floats, place: Place, p: Floats, fitted: Fitted, followed: bool) -> None:
    """Store the fitted spot. After a search the displacement is unknown and is set to zero."""
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
