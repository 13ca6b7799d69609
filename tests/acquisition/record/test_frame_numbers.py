"""Frame numbers accumulated chunk by chunk against sets and differences of all of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from acquisition.record.frame_numbers import MOST_SHOWN, FrameNumbers

NUMBERS = st.lists(st.integers(0, 40) | st.integers(65_530, 65_560) | st.integers(0, 2**32 - 1), max_size=60)


def in_chunks(numbers: list[int], size: int) -> FrameNumbers:
    found = FrameNumbers()
    for first in range(0, len(numbers), size):
        found.add(np.array(numbers[first : first + size], dtype=np.int64))
    return found


@given(NUMBERS, NUMBERS, st.integers(1, 9), st.integers(1, 9))
def test_as_of_all_numbers_at_once(spots: list[int], windows: list[int], size: int, other: int) -> None:
    found = in_chunks(spots, size)
    steps = np.diff(spots)
    gaps = np.flatnonzero(steps > 1)
    assert found.count == len(spots)
    assert found.not_rising == np.count_nonzero(steps <= 0)
    assert (found.gaps, found.missing) == (len(gaps), (steps[gaps] - 1).sum())
    assert found.first_gaps == [(spots[i] + 1, spots[i + 1] - 1) for i in gaps[:MOST_SHOWN]]
    strange = sorted(set(windows) - set(spots))
    assert in_chunks(windows, other).not_in(found) == (len(strange), strange[0] if strange else 0)
