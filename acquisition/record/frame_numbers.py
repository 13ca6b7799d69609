"""Numbers of frames in the order in which they were recorded: where they do not rise, and what is missing."""

import numpy as np
from numpy.typing import NDArray

MOST_SHOWN = 10
_PAGE_BITS = 16


class FrameNumbers:
    """Frame numbers as they come, kept as a set of one byte a frame, in pages of 65,536 frames.

    Attributes
    ----------
    count
        How many there were, those that came twice counted twice.
    not_rising
        How often one was not larger than the one before.
    gaps, missing
        How often it was larger by more than one, and how many frames are missing in all.
    first_gaps
        First and last missing frame of the first few.
    """

    def __init__(self) -> None:
        self.count = 0
        self.not_rising = 0
        self.gaps = 0
        self.missing = 0
        self.first_gaps: list[tuple[int, int]] = []
        self._last: int | None = None
        self._pages: dict[int, NDArray[np.bool_]] = {}

    def add(self, numbers: NDArray[np.int64]) -> None:
        """The next frames, at least one."""
        before = int(numbers[0]) - 1 if self._last is None else self._last
        earlier = np.concatenate(([before], numbers[:-1]))
        steps = numbers - earlier
        gaps = np.flatnonzero(steps > 1)
        self.count += len(numbers)
        self.not_rising += int(np.count_nonzero(steps <= 0))
        self.gaps += len(gaps)
        self.missing += int((steps[gaps] - 1).sum())
        for at in gaps[: MOST_SHOWN - len(self.first_gaps)]:
            self.first_gaps.append((int(earlier[at]) + 1, int(numbers[at]) - 1))
        self._last = int(numbers[-1])
        pages = numbers >> _PAGE_BITS
        for page in set(pages.tolist()):
            held = self._pages.get(page)
            if held is None:
                held = self._pages[page] = np.zeros(1 << _PAGE_BITS, dtype=np.bool_)
            held[numbers[pages == page] & ((1 << _PAGE_BITS) - 1)] = True

    def not_in(self, others: "FrameNumbers") -> tuple[int, int]:
        """How many numbers are not among others, and the smallest of them; 0, 0 where there is none."""
        count = first = 0
        for page, held in sorted(self._pages.items()):
            known = others._pages.get(page)
            strange = np.flatnonzero(held if known is None else held & ~known)
            if len(strange) and not count:
                first = (page << _PAGE_BITS) + int(strange[0])
            count += len(strange)
        return count, first
