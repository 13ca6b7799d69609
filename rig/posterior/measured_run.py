"""Half-cycles of a run that goes on, with the deflections on which they are measured again."""

from collections.abc import Sequence

from processing.deflections import Deflections
from processing.fit import FitOfSwings, FitResult, fitted_twice, with_misfit
from processing.swing import Swing

MOST_SAMPLES = 1 << 22
"""Deflections that are kept, 160 MB: 2.3 hours of 500 frames/s."""
_BEFORE = 4
"""Half-cycles before the first one of which deflections are kept: so many are found together."""


class MeasuredRun:
    """All half-cycles so far; fitted, measured again and fitted as the final analysis does.

    Where there would be more than `most` deflections, the older half of the half-cycles stays as measured
    last: the motion is then known from thousands of them.
    """

    def __init__(self, most: int = MOST_SAMPLES) -> None:
        self._most = most
        self._stand: list[Swing] = []
        self._open: list[Swing] = []
        self._blocks: list[Deflections] = []
        self._near: FitResult | None = None

    @property
    def samples(self) -> int:
        """Deflections that are kept."""
        return sum(map(len, self._blocks))

    def take(self, swings: Sequence[Swing], deflections: Deflections) -> None:
        """Half-cycles and deflections that follow."""
        self._open += swings
        if len(deflections):
            self._blocks.append(deflections)

    def fitted(self, fit: FitOfSwings) -> tuple[Sequence[Swing], FitResult]:
        """All of them as they stand, and the fit to them; raises DataError where there is none."""
        found, self._near = fitted_twice(self._open, self._blocks, fit, self._near, self._stand)
        if found.exact is not None and self.samples > self._most:
            self._let_go(found.swings)
        return found.swings, with_misfit(fit.points(found.swings), fit.pendulum, self._near)

    def _let_go(self, swings: Sequence[Swing]) -> None:
        half = len(self._open) // 2
        if half < _BEFORE:
            return
        from_ns = self._open[half - _BEFORE].turn_time_ns
        self._stand = list(swings[: len(self._stand) + half])
        self._open = self._open[half:]
        self._blocks = [kept for block in self._blocks if len(kept := block.since(from_ns))]
