"""Deflections that pass more than once: a short run is read once, a long one every time."""

from collections.abc import Iterator

import numpy as np
import pytest

from processing.deflections import Deflections, DeflectionUnit, joined, slow_deflections
from rig.analysis import passing_deflections
from rig.analysis.passing_deflections import PassingDeflections


class _Record:
    """Three blocks of ten frames, the second one empty, and how often they were asked for."""

    def __init__(self) -> None:
        self.asked = 0

    def __iter__(self) -> Iterator[Deflections]:
        self.asked += 1
        for first, count in ((0, 10), (10, 0), (10, 10)):
            times_ns = np.arange(first, first + count, dtype=np.int64)
            yield slow_deflections(times_ns, np.zeros(count), 1e-9)


@pytest.mark.parametrize(("short", "asked"), [(20, 1), (19, 3)])
def test_every_pass_has_the_same_frames(short: int, asked: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passing_deflections, "_SHORT", short)
    record = _Record()
    passing = PassingDeflections(record, DeflectionUnit.RAD)
    for _ in range(3):
        assert joined(passing, passing.unit).times_ns.tolist() == list(range(20))
    assert passing.frames == 20
    assert record.asked == asked
