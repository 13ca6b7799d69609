"""Numbers of blocks, in whose gaps losses are seen."""

from typing import Final

NO_BLOCK: Final = 2**64 - 1
"""A block whose number pylon does not know."""
_GIGE_BLOCKS: Final = 65535
_MOST_MISSING: Final = 1000


def missing_blocks(last: int, block: int) -> int:
    """Number of blocks between two numbers; GigE cameras count from 65535 to 1, USB cameras on.

    0 for numbers that pylon does not know, and after a counter that began anew.
    """
    if NO_BLOCK in (last, block):
        return 0
    if block > last:
        return block - last - 1
    past_end = block + _GIGE_BLOCKS - last
    return past_end - 1 if 0 < past_end <= _MOST_MISSING else 0
