"""Turning points as they stand once the motion is known: from few and noisy samples, too."""

from collections.abc import Iterator

import numpy as np
import pytest

from processing.deflections import Deflections, DeflectionUnit, joined, slow_deflections
from processing.swing import swings_of_blocks
from processing.units import ARCSEC_RAD
from rig.analysis import passing_deflections, refined_half_cycles
from rig.analysis.passing_deflections import PassingDeflections
from rig.settings import FitSettings
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path


@pytest.mark.slow
def test_few_noisy_samples_are_measured_again() -> None:
    """25 a second with 0.2 arcsec: the detector's shared errors moved n by 5 u, and were kept for that."""
    parameters, pendulum = paper_pair("glass_k8")
    _, _, path = driven_path(parameters, pendulum, q=0.0, seed=1, frames_per_s=25.0)
    noise = 0.2 * ARCSEC_RAD
    times_ns = np.arange(len(path), dtype=np.int64) * 40_000_000
    seen = path + noise * np.random.default_rng([0, 9]).standard_normal(len(path))
    blocks = [slow_deflections(times_ns, seen, noise)]
    swings = swings_of_blocks(blocks)
    refined = refined_half_cycles(swings, blocks, DeflectionUnit.RAD, pendulum, FitSettings())
    assert refined.motion is not None
    assert not refined.doubt
    assert refined.exact is not None
    for name in ("n", "period0_s", "gamma_pa"):
        value, u_value = refined.exact.estimate(name)
        assert abs(value - getattr(parameters, name)) < 3 * u_value, name


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
    monkeypatch.setattr(passing_deflections, "_MOST_IN_MEMORY", short)
    record = _Record()
    passing = PassingDeflections(record, DeflectionUnit.RAD)
    for _ in range(3):
        assert joined(passing, passing.unit).times_ns.tolist() == list(range(20))
    assert passing.frames == 20
    assert record.asked == asked
