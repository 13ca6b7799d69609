"""Normal equations of splines of place and of what all cycles share, summed over cycles."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.position_map.position_map import Splines
from processing.swing import SHARED, CycleResiduals

_AT_ONCE = 8
"""Cycles whose columns are multiplied together."""


class NormalEquations(NamedTuple):
    """Information ``J^T W J`` and score ``J^T W r`` of the splines, followed by the SHARED common columns."""

    information: Floats
    score: Floats

    @property
    def splines(self) -> int:
        """Number of splines."""
        return len(self.score) - SHARED

    def of_splines(self, scale: float = 1.0) -> "NormalEquations":
        """Those of the splines alone, the common columns free; `scale` is the variance of the residuals."""
        count = self.splines
        gain = self.by_common()
        return NormalEquations(
            (self.information[:count, :count] - gain @ self.information[count:, :count]) / scale,
            (self.score[:count] - gain @ self.score[count:]) / scale,
        )

    def by_common(self) -> Floats:
        """What the splines take from a score of the common columns that are left free, (splines, SHARED)."""
        return np.asarray(
            self.information[: self.splines, self.splines :] @ self._inverse(), dtype=np.float64
        )

    def with_common(self, coefficients: Floats) -> Floats:
        """Coefficients of the splines, and those of the common columns that are likeliest with them."""
        left = self.score[self.splines :] - self.information[self.splines :, : self.splines] @ coefficients
        return np.concatenate([coefficients, self._inverse() @ left])

    def explained(self, everything: Floats) -> float:
        """By how much chi-square falls with all the coefficients."""
        return float(2.0 * everything @ self.score - everything @ self.information @ everything)

    def _inverse(self) -> Floats:
        common = self.information[self.splines :, self.splines :]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(common), 1e-300))
        inverse = np.linalg.pinv(common * np.outer(scale, scale), rcond=1e-10, hermitian=True)
        return np.asarray(inverse * np.outer(scale, scale), dtype=np.float64)


def all_of(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Sum of one or more."""
    return NormalEquations(
        np.asarray(sum(part.information for part in parts)), np.asarray(sum(part.score for part in parts))
    )


class Accumulator:
    """Sum over cycles; what each cycle has for itself is left free.

    The splines' own products are a band, and what a cycle takes of them a few columns: the large matrix is
    not made for every cycle.

    Attributes
    ----------
    cycles
        How many there are so far.
    """

    def __init__(self, splines: Splines) -> None:
        self.cycles = 0
        self._splines = splines
        self._band = np.zeros((4, splines.count))
        self._crossed = np.zeros((splines.count, SHARED))
        self._common = np.zeros((SHARED, SHARED))
        self._taken: list[Floats] = []
        self._together: Floats | None = None
        self._score = np.zeros(splines.count + SHARED)

    def add(self, cycle: CycleResiduals) -> Floats:
        """Add one cycle and return its score."""
        from scipy.sparse import csr_array

        self.cycles += 1
        root = np.sqrt(cycle.weight)
        own = cycle.own * root[:, None]
        own /= np.maximum(np.sqrt(np.sum(own**2, axis=0)), 1e-300)
        directions, size, _ = np.linalg.svd(own, full_matrices=False)
        directions = directions[:, size > 1e-6 * size[0]]
        columns = np.column_stack([cycle.shared, cycle.residual]) * root[:, None]
        columns -= directions @ (directions.T @ columns)
        first, values = self._splines.at(cycle.place)
        values *= root[:, None]
        count, splines = len(root), self._splines.count
        of_place = csr_array(
            (values.ravel(), (first[:, None] + np.arange(4)).ravel(), np.arange(0, 4 * count + 1, 4)),
            shape=(count, splines),
        )
        crossed = of_place.T @ np.column_stack([directions, columns])
        for apart in range(4):
            for j in range(4 - apart):
                products = values[:, j] * values[:, j + apart]
                self._band[apart] += np.bincount(first + j, products, minlength=splines)
        own_count = directions.shape[1]
        self._taken.append(crossed[:, :own_count])
        self._crossed += crossed[:, own_count:-1]
        self._common += columns[:, :-1].T @ columns[:, :-1]
        score = np.concatenate([crossed[:, -1], columns[:, :-1].T @ columns[:, -1]])
        self._score += score
        if len(self._taken) == _AT_ONCE:
            self._put_together()
        return score

    def sums(self) -> NormalEquations:
        """All cycles so far."""
        splines = self._splines.count
        information = np.zeros((splines + SHARED, splines + SHARED))
        for apart in range(4):
            rows = np.arange(splines - apart)
            information[rows, rows + apart] = information[rows + apart, rows] = self._band[
                apart, : splines - apart
            ]
        self._put_together()
        if self._together is not None:
            information[:splines, :splines] -= self._together
        information[:splines, splines:] = self._crossed
        information[splines:, :splines] = self._crossed.T
        information[splines:, splines:] = self._common
        return NormalEquations(information, self._score)

    def _put_together(self) -> None:
        if self._taken:
            taken = np.column_stack(self._taken)
            self._taken.clear()
            products = taken @ taken.T
            self._together = products if self._together is None else self._together + products
