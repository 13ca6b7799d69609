"""How many frames a driver keeps for a reader that is late."""

import math

KEPT_S = 0.1
"""Python stands still for less: by a search for garbage, or a busy processor."""
_MOST_BYTES = 256 * 1024 * 1024


def kept_frames(asked: int | None, rate_hz: float | None, frame_bytes: int, least: int, most: int) -> int:
    """Number of buffers: what was `asked` for, else as many as hold `KEPT_S` at the stated rate.

    `least` are kept at any rate, also where the camera states none (None), at most `most`, and all together
    are no larger than 256 MiB.
    """
    wanted = asked or max(least, math.ceil(KEPT_S * (rate_hz or 0.0)) + 1)
    return max(2, min(wanted, most, _MOST_BYTES // max(frame_bytes, 1)))
